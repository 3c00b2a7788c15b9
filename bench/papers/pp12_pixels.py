"""Elements of a pixel with a series of weights of the Tikhonov term of [PP12]; what the noise stop gains at 8 px."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import ddic
from bench.papers.compared import Compared
from bench.papers.pp12_corrections import draw_errors, measure_q4
from bench.support.error_maps import MapRow, draw_maps
from bench.support.separated_cases import (
    KINDS,
    PUBLISHED,
    Pair,
    Plate,
    find_region,
    list_pixels,
    measure_pgd,
    measure_pixels,
    measure_rms,
    render,
    render_reference,
)
from ddic.parallel.team import require_held
from ddic.plots.canvas import save_figure
from ddic.synth.fields import Sinusoidal

NAME = "pp12_pixels"

Array = NDArray[np.float64]

SIZE, SIDE, SMOKE_SIZE, SMOKE_SIDE = 1024, 710, 256, 120
"""Sides of the images and of the region in their middle, pixels."""

WAVELENGTHS, SMOKE_WAVELENGTHS = (16, 32, 64, 128, 256), (16, 32, 64)
"""Cut-off, pixels: each stands for a weight of the Tikhonov term."""

LONGEST_MAPPED = 64
"""Cut-off, pixels, up to which errors are mapped: larger ones would hide theirs."""

NOISY = "8 bit, noise of 2"

PAPER_RESIDUAL = 0.59
"""Percent of the range of the grey levels, on the paper's own images."""

ELEMENT = 8
"""Side of the elements on which the noise stop is compared with Q4-DIC, pixels."""


@dataclass(frozen=True, eq=False)
class Weighted:
    """A measurement with one weight of the regularisation.

    Attributes
    ----------
    weight : float
        eta of the regularisation.
    n_corrections : int
        Until it ended by itself.
    residual : float
        Standard deviation, percent of the reference image's range.
    error : (n, 2) array
        At the region's pixels, pixels.
    """

    weight: float
    n_corrections: int
    residual: float
    error: Array

    @property
    def rms(self) -> float:
        """RMS error per component, pixels."""
        return measure_rms(self.error)


Series = Mapping[float, Weighted]
"""By cut-off wavelength, pixels."""


def measure_weight(pair: Pair, side: int, operator: str, wavelength: float) -> Weighted:
    """Measure the reference field with one cut-off wavelength."""
    result = measure_pixels(pair, side, {"operator": operator, "cut_off_wavelength": wavelength})
    points = list_pixels(find_region(len(pair[0]), side))
    spread = float(np.nanstd(require_held(result.residual_image)))
    return Weighted(float(result.attributes["case"]["eta"]), len(result.corrections["correction"]),
                    100 * spread / float(np.ptp(pair[0].astype(float))),
                    result.at(points) - Sinusoidal().displacement(points))


def draw_series(found: Mapping[str, Series]) -> Figure:
    """Draw errors and residuals against the cut-off wavelength."""
    figure = Figure(figsize=(9.5, 4.0), layout="tight")
    errors, residuals = figure.subplots(1, 2)
    for (name, series), style in zip(found.items(), ("o-", "s-", "o--", "s--"), strict=True):
        wavelengths = list(series)
        errors.loglog(wavelengths, [one.rms for one in series.values()], style, markersize=4, label=name)
        residuals.semilogx(wavelengths, [one.residual for one in series.values()], style, markersize=4, label=name)
    errors.set_ylabel("RMS error of the displacement [px]")
    residuals.set_ylabel("residual [% of the range]")
    residuals.set_ylim(bottom=0.0)
    for axes in (errors, residuals):
        axes.set_xlabel("cut-off wavelength [px]")
        axes.set_xticks(wavelengths, [f"{one:g}" for one in wavelengths])
        axes.set_xticks([], minor=True)
        axes.grid(which="both", alpha=0.25)
        axes.legend(fontsize="x-small")
    return figure


def draw_weights(series: Mapping[str, Series], region: tuple[float, float, float, float]) -> Figure:
    """Draw the errors of u_x by cut-off wavelength up to LONGEST_MAPPED, a row a kind of images."""
    n = int(region[3] - region[1])
    return draw_maps([MapRow(f"error of u_x [px], {kind}", {f"cut-off {wavelength:g} px": one.error[:, 0].reshape(n, n)
                                                           for wavelength, one in of_kind.items()
                                                           if wavelength <= LONGEST_MAPPED})
                      for kind, of_kind in series.items()], region)


def compare_series(kind: str, tikhonov: Series, gap: Series, side: int) -> Compared:
    """List errors, residuals and corrections of a series of weights."""
    best, best_gap = (min(series, key=lambda wavelength: series[wavelength].rms) for series in (tikhonov, gap))
    listed = "; ".join(f"{wavelength:g} px (weight {one.weight:.1e}): {one.n_corrections} corrections, residual "
                       f"{one.residual:.2f} %, error {one.rms:.4f} px" for wavelength, one in tikhonov.items())
    return Compared(
        "[PP12, Fig. 15]", f"Tikhonov's term by cut-off wavelength, {kind}",
        f"reference texture and field, {side} x {side} px, 1-px elements ({2 * (side + 1)**2} unknowns), default "
        "settings, operator tikhonov", f"residual {PAPER_RESIDUAL} % on its own images",
        f"{listed}; least error at {best:g} px",
        "the images and the field are other ones, so that the error is known; with the equilibrium gap the least error "
        f"is {gap[best_gap].rms:.4f} px, at {best_gap:g} px")


def compare_noise_stop(kinds: Sequence[str], folder: Path) -> list[Compared]:
    """Set the default's error on the plate with 8-px elements beside Q4-DIC's, and draw it for the last kind."""
    plate, points, rows = Plate(), list_pixels(), []
    known = plate.displacement(points)
    for kind in kinds:
        pair = render(plate, kind)
        runs: dict[str, ddic.Result] = {"PGD-DIC, published": measure_pgd(pair, ELEMENT, PUBLISHED),
                                        "PGD-DIC by default": measure_pgd(pair, ELEMENT, {}),
                                        "Q4-DIC": measure_q4(pair, ELEMENT)}
        fields = {name: result.at(points) for name, result in runs.items()}
        published, default, of_q4 = (measure_rms(u - known) for u in fields.values())
        is_judged = kind.startswith("8 bit")
        rows.append(Compared(
            "[PP12, open hole]", f"RMS error of the default settings, which stop at noise, {kind}",
            f"plate clamped on its left side, 304 x 304 px, {ELEMENT}-px elements",
            "0.09 and 0.12 %, its two differences to Q4-DIC",
            f"{default:.4f} px beside Q4-DIC's {of_q4:.4f} px (published algorithm {published:.4f} px)",
            "judged by the known displacement: the distance to Q4-DIC counts its noise as right",
            "less than Q4-DIC's" if is_judged else "", default < of_q4 or not is_judged, judged_small=True))
    save_figure(draw_errors(fields, known), folder / f"{NAME}_noise_stop.png")
    return rows


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Measure the series of weights on float and noisy images, and what the noise stop gains."""
    size, side = (SMOKE_SIZE, SMOKE_SIDE) if smoke else (SIZE, SIDE)
    wavelengths = SMOKE_WAVELENGTHS if smoke else WAVELENGTHS
    series: dict[tuple[str, str], Series] = {}
    for kind in ("float", NOISY):
        pair = render_reference(size, kind)
        for operator in ("tikhonov", "equilibrium_gap"):
            series[operator, kind] = {wavelength: measure_weight(pair, side, operator, wavelength)
                                      for wavelength in wavelengths}
    names = {"tikhonov": "Tikhonov", "equilibrium_gap": "equilibrium gap"}
    save_figure(draw_series({f"{names[operator]}, {kind}": one for (operator, kind), one in series.items()}),
                folder / f"{NAME}_fig15.png")
    by_kind = {kind: series["tikhonov", kind] for kind in ("float", NOISY)}
    save_figure(draw_weights(by_kind, find_region(size, side)), folder / f"{NAME}_errors.png")
    rows = [compare_series(kind, of_kind, series["equilibrium_gap", kind], side) for kind, of_kind in by_kind.items()]
    return [*rows, *compare_noise_stop(KINDS[-1:] if smoke else KINDS, folder)]
