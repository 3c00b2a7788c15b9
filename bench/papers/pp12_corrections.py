"""The first example of [PP12], correction by correction: e, eta, d and e_svd, sweeps, and two limits of the sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import ddic
from bench.papers.compared import UNREAD, Compared
from bench.support.error_maps import MapRow, draw_maps
from bench.support.separated_cases import (
    ELEMENT,
    KINDS,
    PUBLISHED,
    REGION,
    Pair,
    Plate,
    list_pixels,
    measure_pgd,
    measure_rms,
    render,
)
from ddic.errors import ConvergenceError
from ddic.parallel.team import require_held
from ddic.plots.canvas import save_figure
from ddic.separated.field import SeparatedField, factorize_grid

NAME = "pp12_corrections"

Array = NDArray[np.float64]

ETA = 1e-3
"""At which the corrections are counted."""

MOST = 12
"""Corrections to it."""

N_DRAWN, SMOKE_DRAWN = 20, 11
"""Corrections that the curves show."""

LIMITS = (6, 200)
"""k_max: most sweeps of a correction before the residual is computed anew."""

STAGNATION = 1e-3
"""e at which the fixed point ends earlier where its limits are compared; at a larger one it rarely meets them."""

SETTING = ("first example: 500 x 500 px gradient noise, plate of 304 x 304 px clamped on its left side, largest "
           "displacement 2 px, 16-px elements, from a rigid translation; published algorithm: no update, no stop at "
           "noise")


@dataclass(frozen=True, eq=False)
class Followed:
    """Corrections of the published algorithm, one after the other, beside Q4-DIC's field.

    Attributes
    ----------
    table : mapping
        ``Result.corrections``.
    distances : (n,) array
        d: RMS distance of the sum after each correction to Q4-DIC's field over the latter, both components together.
    truncations : (n,) array
        e_svd, Eq. (13): the same of as many modes of the field's singular value decomposition.
    """

    table: Mapping[str, NDArray[Any]]
    distances: Array
    truncations: Array

    @property
    def of_components(self) -> Array:
        """Corrections over the displacement, the larger of both components."""
        return np.maximum(self.table["relative_x"], self.table["relative_y"])

    @property
    def sum_of_components(self) -> Array:
        """The same of both components, added up."""
        return np.asarray(self.table["relative_x"] + self.table["relative_y"])

    @property
    def fluctuations(self) -> Array:
        """Corrections over the displacement without its mean, the larger of both components: those decide here."""
        return np.maximum(self.table["fluctuation_x"], self.table["fluctuation_y"])


def count_below(values: Array, bound: float = ETA) -> int | None:
    """Corrections after which a measure of them is below a bound; None where it never is."""
    below = np.flatnonzero(values < bound)
    return int(below[0]) + 1 if len(below) else None


def measure_q4(pair: Pair, element: float) -> ddic.Result:
    """Measure the region by Q4-DIC, from a rigid translation."""
    return ddic.measure(pair, ddic.structured_mesh(REGION, element), solver={"method": "assembled"},
                        start={"pyramid": False})


def sum_corrections(pair: Pair, n: int, **pgd: Any) -> ddic.Result:
    """Sum just so many corrections of the published algorithm."""
    try:
        return measure_pgd(pair, ELEMENT, {**PUBLISHED, "tolerance": 1e-12, "max_corrections": n, **pgd})
    except ConvergenceError as error:
        found: ddic.Result = error.result
        return found


def _separate(q4: ddic.Result, on: SeparatedField) -> SeparatedField:
    """Q4-DIC's field as products on the same lines, all of them, largest first."""
    x, y = np.meshgrid(on.along_x.nodes, on.along_y.nodes)
    values = q4.at(np.column_stack([x.ravel(), y.ravel()])).reshape(*x.shape, 2)
    return factorize_grid(on.along_x, on.along_y, values, 0.0).reduce_modes(0.0)


def follow(pair: Pair, q4: ddic.Result, n: int) -> Followed:
    """Follow corrections up to the n-th."""
    sums = [require_held(sum_corrections(pair, k).separated) for k in range(1, n + 1)]
    complete = _separate(q4, sums[-1])
    size = float(np.linalg.norm(complete.measure_rms()))
    distances = [float(np.linalg.norm(one.measure_difference(complete))) / size for one in sums]
    # Modes are orthogonal: what is left out is the root sum of squares of their sizes.
    left = np.sqrt(np.cumsum((complete.amplitudes**2).sum(axis=1)[::-1])[::-1]) / size
    padded = np.pad(left[1:], (0, max(0, n + 1 - len(left))))
    return Followed(sum_corrections(pair, n).corrections, np.array(distances), padded[:n])


def draw_followed(found: Followed) -> Figure:
    """Draw e, eta and e_svd, as Fig. 3 of [PP12], with d and what ends a measurement here."""
    figure = Figure(figsize=(7.0, 4.4), layout="tight")
    axes = figure.subplots()
    number = found.table["correction"]
    for values, style, colour, label in (
            (found.table["stagnation"], "^-", "tab:green", "e, last change of the fixed point"),
            (found.table["relative"], "o-", "tab:blue", "eta, both components together"),
            (found.of_components, "--", "tab:blue", "the larger component's"),
            (found.fluctuations, ":", "tab:blue", "the larger component's without its mean (ends here)"),
            (found.distances, "s-", "tab:orange", "d, distance to Q4-DIC"),
            (found.truncations, "v-", "tab:red", "e_svd, of as many modes of an SVD")):
        axes.semilogy(number, np.where(values > 0, values, np.nan), style, color=colour, markersize=4, linewidth=1.3,
                      label=label)
    axes.axhline(ETA, color="tab:grey", linewidth=0.8)
    axes.set(xlabel="correction [-]", ylabel="relative size [-]", xticks=number[::2])
    axes.grid(which="both", alpha=0.25)
    axes.legend(fontsize="x-small")
    return figure


def draw_sweeps(found: Mapping[int, Mapping[str, NDArray[Any]]]) -> Figure:
    """Draw eta and sweeps by correction for each limit of the sweeps, as Fig. 8 of [PP12]."""
    figure = Figure(figsize=(9.0, 3.8), layout="tight")
    sizes, sweeps = figure.subplots(1, 2)
    for (limit, table), style in zip(found.items(), ("o-", "s--"), strict=True):
        number = table["correction"]
        sizes.semilogy(number, table["relative"], style, markersize=4, label=f"k_max = {limit}")
        sweeps.plot(number, table["sweeps"], style, markersize=4, label=f"k_max = {limit}")
    sizes.axhline(ETA, color="tab:grey", linewidth=0.8)
    sizes.set_ylabel("eta [-]")
    sweeps.set_ylabel("sweeps of the fixed point [-]")
    for axes in (sizes, sweeps):
        axes.set_xlabel("correction [-]")
        axes.grid(which="both", alpha=0.25)
        axes.legend(fontsize="small")
    return figure


def draw_errors(fields: Mapping[str, Array], known: Array) -> Figure:
    """Draw what fields at the region's pixels (n, 2) err by, a row a component."""
    n = int(REGION[3] - REGION[1])
    rows = [MapRow(f"error of u_{component} [px]", {title: (u - known)[:, c].reshape(n, -1)
                                                    for title, u in fields.items()})
            for c, component in enumerate("xy")]
    return draw_maps(rows, REGION)


def describe_count(n: int | None) -> str:
    """Say a number of corrections."""
    return "never" if n is None else f"{n} corrections"


def compare_followed(found: Followed) -> list[Compared]:
    """Set counts to eta, printed and ours, and distances there beside the paper's curves."""
    place, n = "[PP12, Fig. 3]", count_below(found.table["relative"])
    rows = [Compared(place, f"corrections to eta < {ETA:g}, eta of both components together", SETTING,
                     UNREAD, describe_count(n),
                     "gradient noise like the paper's, not the same; eta is one norm over both components",
                     f"at most {MOST}", n is not None and n <= MOST, judged_small=True),
            Compared(place, f"the same with other readings of eta < {ETA:g}", SETTING, UNREAD,
                     f"{describe_count(count_below(found.of_components))} by component, the larger one; "
                     f"{describe_count(count_below(found.sum_of_components))}, both ratios added up; "
                     f"{describe_count(count_below(found.fluctuations))} by component without its mean",
                     "the last is what ends a measurement here")]
    if n is not None:
        rows.append(Compared(
            place, "e, d and e_svd at that correction", SETTING, UNREAD,
            f"e {found.table['stagnation'][n - 1]:.1e}; d {found.distances[n - 1]:.1e}; e_svd "
            f"{found.truncations[n - 1]:.1e}",
            "d is the distance to Q4-DIC's field over that field, both components together"))
    return rows


def compare_limits(found: Mapping[int, ddic.Result], known: Array) -> list[Compared]:
    """Set both limits of the sweeps beside each other."""
    rows = []
    for limit, result in found.items():
        n = count_below(result.corrections["relative"])
        sweeps = result.corrections["sweeps"][:n]
        rows.append(Compared(
            "[PP12, Fig. 8]", f"k_max = {limit}: corrections to eta < {ETA:g}, sweeps",
            f"{SETTING}; float images, stagnation e <= {STAGNATION:g}", UNREAD,
            f"{describe_count(n)}, {int(sweeps.sum())} sweeps, {int(sweeps.max())} at most; RMS error after "
            f"{len(result.corrections['sweeps'])} corrections "
            f"{measure_rms(result.at(list_pixels()) - known):.5f} px"))
    return rows


def compare_kinds(known: Array) -> list[Compared]:
    """Count corrections on images stored otherwise than as floats."""
    rows = []
    for kind in KINDS[1:]:
        pair = render(Plate(), kind)
        result = measure_pgd(pair, ELEMENT, PUBLISHED)
        error = measure_rms(result.at(list_pixels()) - known)
        of_q4 = measure_rms(measure_q4(pair, ELEMENT).at(list_pixels()) - known)
        rows.append(Compared("[PP12, Fig. 3]", f"corrections to eta < {ETA:g}, {kind}", SETTING, UNREAD,
                             f"{describe_count(count_below(result.corrections['relative']))}; RMS error {error:.4f} px "
                             f"(Q4-DIC {of_q4:.4f} px)"))
    return rows


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Follow corrections on float images, compare limits of the sweeps, and count on other kinds of images."""
    plate, points = Plate(), list_pixels()
    pair, known = render(plate, "float"), plate.displacement(points)
    q4 = measure_q4(pair, ELEMENT)
    n = SMOKE_DRAWN if smoke else N_DRAWN
    found = follow(pair, q4, n)
    save_figure(draw_followed(found), folder / f"{NAME}_fig3.png")
    limited = {limit: sum_corrections(pair, n, max_sweeps=limit, stagnation=STAGNATION) for limit in LIMITS}
    save_figure(draw_sweeps({limit: result.corrections for limit, result in limited.items()}),
                folder / f"{NAME}_fig8.png")
    fields = {f"PGD-DIC, eta < {ETA:g}": sum_corrections(pair, count_below(found.table["relative"]) or n).at(points),
              "PGD-DIC by default": measure_pgd(pair, ELEMENT, {}).at(points), "Q4-DIC": q4.at(points)}
    save_figure(draw_errors(fields, known), folder / f"{NAME}_errors.png")
    rows = [*compare_followed(found), *compare_limits(limited, known)]
    return rows if smoke else [*rows, *compare_kinds(known)]
