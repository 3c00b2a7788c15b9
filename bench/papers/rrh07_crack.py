"""A crack in mode I: continuous elements, elements that a line cuts (H), and these with tip functions (H and C_j)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import ddic
from bench.papers.compared import Compared
from bench.support.line_panels import (
    OpeningCurve,
    compare_opening,
    describe_noise,
    draw_residuals,
    measure_residual,
)
from bench.support.opened_pair import Crack, mesh_inside, render_crack, scatter_points
from ddic.plots.canvas import COLOURS, save_figure

NAME = "rrh07_crack"

SIZE, SMOKE_SIZE, ELEMENT, NOISE = 1024, 400, 16, 2.0
"""Sides of the images and of the elements, pixels; grey levels of 256."""

NEAR_TIP, BESIDE = 32.0, 2.5
"""Pixels from the tip within which its field is judged, and from the line and its continuation beyond which."""

TIMES_LESS = 2.0
"""Error about the tip without tip functions over that with them."""

CLEAR = 3.0 * ELEMENT
"""Pixels behind the tip up to which elements may not hold the root of the distance."""

DETAIL = 64.0
"""Half side of the maps about the tip, pixels."""

CONTINUOUS, CUT, WITH_TIP = "continuous", "H", "H and C_j"

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measured:
    """A crack with its pair, and what each kind of elements makes of it."""

    crack: Crack
    pair: tuple[NDArray[Any], NDArray[Any]]
    results: Mapping[str, ddic.Result]

    def find_error(self, kind: str, points: Array) -> Array:
        """Displacement at points less the known one, (n, 2), pixels."""
        return np.asarray(self.results[kind].at(points) - self.crack.displacement(points))

    def describe_errors(self, points: Array) -> str:
        """RMS errors at points, a component, of all kinds."""
        errors = {kind: float(np.sqrt(np.nanmean(self.find_error(kind, points) ** 2))) for kind in self.results}
        return ", ".join(f"{kind} {error:.4f} px" for kind, error in errors.items())


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Measure a crack whose line and tip are known with each kind of elements."""
    measured = _measure_crack(SMOKE_SIZE if smoke else SIZE)
    curves = {kind: _compare_opening(measured, kind) for kind in (CUT, WITH_TIP)}
    save_figure(draw_residuals(measured.results, measured.pair[0]), folder / f"{NAME}_residual.png")
    save_figure(_draw_errors(measured), folder / f"{NAME}_errors.png")
    save_figure(_draw_openings(curves), folder / f"{NAME}_opening.png")
    return _compare(measured, curves)


def _measure_crack(size: int) -> Measured:
    crack = Crack(tip=np.array([size / 2 - 11.7, size / 2 + 8.7]))
    pair = render_crack(crack, size, NOISE)
    # The line lies as it is given, up to the tip.
    line: dict[str, Any] = {"vertices": [(crack.tip - 2 * size * crack.along).tolist(), crack.tip.tolist()],
                            "uncertainty": 0}
    # All pixels count for all kinds of elements, as in the paper.
    options: dict[str, Any] = {"solver": {"method": "monolithic"}, "correlation": {"spoilt_pixels": "keep"},
                               "gauss_newton": {"max_iterations": 500}}
    known = {"output": {"uncertainty": True}}
    kinds: dict[str, dict[str, Any]] = {
        CONTINUOUS: {}, CUT: {"discontinuity": [line], **known},
        WITH_TIP: {"discontinuity": [{**line, "tip_functions": True}], **known}}
    mesh = mesh_inside(size, ELEMENT)
    return Measured(crack, pair, {kind: ddic.measure(pair, mesh, **options, **more) for kind, more in kinds.items()})


def _compare_opening(measured: Measured, kind: str) -> dict[str, OpeningCurve]:
    """Openings along the line beside the known ones, by the distance behind the tip."""
    crack, opening = measured.crack, ddic.measure_opening(measured.results[kind])
    behind = (crack.tip - opening.points) @ crack.along
    to_left = np.array([crack.along[1], -crack.along[0]])
    on_crack = crack.tip - behind[:, None] * crack.along
    apart = crack.displacement(on_crack + 1e-6 * to_left) - crack.displacement(on_crack - 1e-6 * to_left)
    return compare_opening(opening, np.column_stack([apart @ crack.along, apart @ to_left]), behind)


def _place_points(measured: Measured, about_tip: bool) -> Array:
    """Place points at random, all over the mesh or about the tip, but not in the band along the line, also ahead."""
    crack = measured.crack
    from_tip = scatter_points(measured.results[CONTINUOUS].mesh) - crack.tip
    if about_tip:
        from_tip = np.random.default_rng(0).uniform(-NEAR_TIP, NEAR_TIP, (8000, 2))
        from_tip = from_tip[np.linalg.norm(from_tip, axis=1) <= NEAR_TIP]
    height = from_tip @ np.array([-crack.along[1], crack.along[0]])
    return np.asarray(crack.tip + from_tip[np.abs(height) > BESIDE])


def _draw_errors(measured: Measured) -> Figure:
    """Maps of the error's length about the tip, with the same colours."""
    offsets = np.arange(-DETAIL, DETAIL + 0.5)
    x, y = (axis.ravel() for axis in np.meshgrid(offsets, offsets))
    points = measured.crack.tip + np.column_stack([x, y])
    figure = Figure(figsize=(4.2 * len(measured.results), 4.0), layout="constrained")
    lengths = {kind: np.linalg.norm(measured.find_error(kind, points), axis=1).reshape(len(offsets), -1)
               for kind in measured.results}
    # Continuous elements would hide all that the others differ in.
    largest = float(np.nanpercentile(lengths[CUT], 99.5))
    begin = measured.crack.tip - 2 * DETAIL * measured.crack.along
    (x0, y0), tip = measured.crack.tip - DETAIL - 0.5, measured.crack.tip
    for axes, (kind, values) in zip(figure.subplots(1, len(lengths)), lengths.items(), strict=True):
        shown = axes.imshow(values, cmap=COLOURS, vmin=0.0, vmax=largest,
                            extent=(x0, x0 + len(offsets), y0 + len(offsets), y0))
        axes.plot([begin[0], tip[0]], [begin[1], tip[1]], "w--", linewidth=1.0)
        axes.set(title=f"{kind} elements", xlabel="x [px]", ylabel="y [px]", xlim=(x0, x0 + len(offsets)),
                 ylim=(y0 + len(offsets), y0))
    figure.colorbar(shown, ax=figure.axes, label="length of the displacement's error [px]", extend="max")
    return figure


def _draw_openings(curves: Mapping[str, Mapping[str, OpeningCurve]]) -> Figure:
    """Draw the normal opening of both kinds, the whole crack beside the surroundings of its tip."""
    figure = Figure(figsize=(9.6, 4.0), layout="constrained")
    for axes, end in zip(figure.subplots(1, 2), (None, DETAIL), strict=True):
        for kind, colour in ((CUT, "tab:orange"), (WITH_TIP, "tab:blue")):
            curves[kind]["across"].draw(axes, colour, f"{kind}, with 2 standard deviations")
        axes.set(xlabel="distance behind the tip [px]", ylabel="normal opening [px]")
        if end is not None:
            curve = curves[WITH_TIP]["across"]
            axes.set(xlim=(0.0, end), ylim=(-0.1, 1.1 * float(np.nanmax(curve.known[curve.distance <= end]))))
        else:
            axes.set_xlim(left=0.0)
    return figure


def _compare(measured: Measured, curves: Mapping[str, Mapping[str, OpeningCurve]]) -> list[Compared]:
    setting = (f"crack in mode I at {np.rad2deg(measured.crack.angle):.0f} degrees, K_I / mu = "
               f"{measured.crack.opening_factor:g} px^(1/2), {len(measured.pair[0])} x {len(measured.pair[0])} px, 16 "
               f"bit, noise of {NOISE:g} grey levels of 256, {ELEMENT}-px elements, line and tip given "
               "(discontinuity.uncertainty = 0; for C_j discontinuity.tip_functions = true), solver.method = "
               '"monolithic", correlation.spoilt_pixels = "keep", gauss_newton.max_iterations = 500')
    beside = f"but for {BESIDE:g} px beside the line and its continuation"
    place, real = "[RRH07, crack]", "the images are synthetic, so that the field is known"
    residuals = {kind: measure_residual(result, measured.pair[0]) for kind, result in measured.results.items()}
    about_tip = _place_points(measured, about_tip=True)
    without, with_tip = (float(np.sqrt(np.mean(measured.find_error(kind, about_tip) ** 2))) for kind in (CUT, WITH_TIP))
    away = {kind: curve["across"].keep(curve["across"].distance > CLEAR) for kind, curve in curves.items()}
    near = {kind: curve["across"].keep((curve["across"].distance > 0) & (curve["across"].distance <= CLEAR))
            for kind, curve in curves.items()}
    return [
        Compared(place, "residual in per cent of the dynamic range", setting, "less with enriched elements",
                 ", ".join(f"{kind} {residual:.2f} %" for kind, residual in residuals.items()),
                 f"{real}; {describe_noise(NOISE, measured.pair[0])}",
                 "less with enriched elements", residuals[WITH_TIP] < residuals[CONTINUOUS], judged_small=True),
        Compared(place, "Gauss-Newton iterations on the images as they are", setting, "not compared",
                 ", ".join(f"{kind} {len(result.gauss_newton['iteration'])}"
                           for kind, result in measured.results.items())),
        Compared(place, f"RMS error of the displacement all over the mesh, {beside}", setting,
                 "not known of real images", measured.describe_errors(_place_points(measured, about_tip=False)), real),
        Compared(place, f"RMS error of the displacement within {NEAR_TIP:g} px of the tip, {beside}", setting,
                 "not known of real images", measured.describe_errors(about_tip), real,
                 f"H and C_j: {TIMES_LESS:g} times less than H alone", without >= TIMES_LESS * with_tip,
                 judged_small=True),
        *(Compared(place, f"normal opening more than {CLEAR:g} px behind the tip, {kind}", setting,
                   "no standard deviation of it", curve.describe(), real) for kind, curve in away.items()),
        *(Compared(place, f"normal opening up to {CLEAR:g} px behind the tip, {kind}", setting,
                   "no standard deviation of it", curve.describe(),
                   "what these elements cannot follow is no noise" if kind == CUT else real)
          for kind, curve in near.items()),
    ]
