"""Errors by the size of the elements, without noise: ten translations as in Fig. 4 of [PP12], and the plate's maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bench.papers.compared import UNREAD, Compared
from bench.papers.pp12_corrections import ETA, measure_q4
from bench.support.error_maps import MapRow, draw_maps
from bench.support.separated_cases import (
    OCTAVES,
    PUBLISHED,
    REGION,
    Pair,
    Plate,
    Uniform,
    list_pixels,
    measure_pgd,
    measure_rms,
    render,
)
from ddic.plots.canvas import save_figure

NAME = "pp12_elements"

Array = NDArray[np.float64]

SHIFTS = tuple(round(0.05 + 0.1 * k, 2) for k in range(10))
"""Translations along x, pixels."""

SIZES, SMOKE_SIZES, SMOKE_SHIFTS = (4, 8, 16, 19, 38, 76), (8, 16, 38), (0.25, 0.55, 0.85)
"""Sides of elements that divide the region, pixels."""

LARGEST_OF_SLOPE = 19
"""Side of the elements up to which slopes are judged, pixels: on larger ones the error tends to its constant mean."""

SLOPES = {"mean error": -1.49, "standard deviation": -1.70}
"""The paper's, of log-log curves."""

FEWER = slice(2, None, 3)
"""Of the translations, those by which what is only reported is measured."""

FINE = (12,)
"""Octaves of a texture of one grain, pixels: what the slopes depend on."""

OF_ETA = 0.7
"""RMS of each component at which corrections end, relative to ETA times the translation: eta is below ETA then."""

MAPPED = (8, 16, 38)
"""Sides of the elements whose errors of the plate are drawn, pixels."""

SETTING = ("500 x 500 px gradient noise (cells of 24, 12 and 6 px), region of 304 x 304 px, ten translations along x "
           "of 0.05 to 0.95 px, 8 bit, no noise added")

OF_TEXTURE = ("the error of independent pixels falls with -1, and faster where elements are as small as the texture's "
              "grain: the slope is that of the texture and of the sizes, and the paper's texture is another one")

WHY = {"mean error": f"{OF_TEXTURE}; the mean error falls more slowly where interpolation errs alike everywhere",
       "standard deviation": OF_TEXTURE}
"""What differs from the paper; an error that is the same everywhere changes no standard deviation."""


@dataclass(frozen=True, eq=False)
class ErrorsBySize:
    """Errors of u_x, means over translations.

    Attributes
    ----------
    sizes : (n,) array
        Sides of the elements, pixels.
    values : mapping of (n,) array
        Mean absolute error and standard deviation of the error over the pixels, pixels.
    """

    sizes: Array
    values: Mapping[str, Array]

    def find_slope(self, what: str, largest: float) -> float:
        """Slope of the log-log curve up to a size."""
        used = self.sizes <= largest
        return float(np.polyfit(np.log(self.sizes[used]), np.log(self.values[what][used]), 1)[0])


Measured = Mapping[float, Pair]
"""Pairs by their translation, pixels."""


def render_translations(shifts: Sequence[float], kind: str, octaves: Sequence[int] = OCTAVES) -> Measured:
    """Draw a pair of each translation along x."""
    return {shift: render(Uniform((shift, 0.0)), kind, octaves=octaves) for shift in shifts}


def measure_sizes(pairs: Measured, sizes: Sequence[int], method: str) -> ErrorsBySize:
    """Measure translations with elements of several sizes, by Q4-DIC or by PGD-DIC up to eta < 1e-3."""
    points = list_pixels()
    found = []
    for size in sizes:
        of_size = []
        for shift, pair in pairs.items():
            if method == "Q4-DIC":
                result = measure_q4(pair, size)
            else:
                rules = {"rms_tolerance": OF_ETA * ETA * shift, "max_corrections": 1000}
                result = measure_pgd(pair, size, {**PUBLISHED, **rules})
            error = result.at(points)[:, 0] - shift
            of_size.append((np.abs(error).mean(), error.std()))
        found.append(np.mean(of_size, axis=0))
    values = np.array(found)
    return ErrorsBySize(np.array(sizes, dtype=float), dict(zip(SLOPES, values.T, strict=True)))


def draw_sizes(found: Mapping[str, ErrorsBySize]) -> Figure:
    """Draw errors against the size of the elements, as Fig. 4 of [PP12], with lines of the paper's slopes."""
    figure = Figure(figsize=(10.0, 4.2), layout="tight")
    for axes, (what, slope) in zip(figure.subplots(1, 2), SLOPES.items(), strict=True):
        for (name, of_name), style in zip(found.items(), ("o-", "s-", "^--", "v:"), strict=False):
            axes.loglog(of_name.sizes, of_name.values[what], style, markersize=4, linewidth=1.3, label=name)
        first = next(iter(found.values()))
        guide = first.values[what][0] * (first.sizes / first.sizes[0]) ** slope
        axes.loglog(first.sizes, guide, color="black", linewidth=0.8, label=f"slope {slope:.2f}, the paper's")
        axes.set(xlabel="element size [px]", ylabel=f"{what} of u_x [px]")
        axes.set_xticks(first.sizes, [f"{size:g}" for size in first.sizes])
        axes.set_xticks([], minor=True)
        axes.grid(which="both", alpha=0.25)
        axes.legend(fontsize="x-small")
    return figure


def map_plate(sizes: Sequence[int], kind: str = "8 bit") -> tuple[Figure, dict[int, tuple[float, float]]]:
    """Draw errors of the plate's u_x by size of the elements; RMS errors of PGD-DIC and Q4-DIC, pixels."""
    plate, points = Plate(), list_pixels()
    pair, known = render(plate, kind), plate.displacement(points)
    n = int(REGION[3] - REGION[1])
    maps: dict[str, dict[str, Array]] = {"PGD-DIC": {}, "Q4-DIC": {}}
    errors = {}
    for size in sizes:
        fields = {"PGD-DIC": measure_pgd(pair, size, PUBLISHED), "Q4-DIC": measure_q4(pair, size)}
        of_pixels = {name: result.at(points) - known for name, result in fields.items()}
        for name, error in of_pixels.items():
            maps[name][f"{name}, {size}-px elements"] = error[:, 0].reshape(n, n)
        errors[size] = (measure_rms(of_pixels["PGD-DIC"]), measure_rms(of_pixels["Q4-DIC"]))
    rows = [MapRow("error of u_x [px]", of_name) for of_name in maps.values()]
    return draw_maps(rows, REGION), errors


def judge_slopes(found: ErrorsBySize, others: Mapping[str, ErrorsBySize]) -> list[Compared]:
    """Set slopes of Q4-DIC, which the complete sum is, and of others beside the paper's."""
    rows = []
    for what, of_paper in SLOPES.items():
        slope = found.find_slope(what, LARGEST_OF_SLOPE)
        sizes, values = found.sizes, found.values[what]
        local = [np.log(b / a) / np.log(q / p)
                 for p, q, a, b in zip(sizes, sizes[1:], values, values[1:], strict=False)]
        rows.append(Compared(
            "[PP12, Fig. 4]", f"slope of the {what}, Q4-DIC (which the complete sum is)", SETTING, f"{of_paper:.2f}",
            f"{slope:.2f} on elements of {sizes[0]:g} to {LARGEST_OF_SLOPE} px, "
            f"{found.find_slope(what, np.inf):.2f} up to {sizes[-1]:g} px; from size to size "
            f"{', '.join(f'{one:.2f}' for one in local)}",
            WHY[what], f"at most {of_paper:.2f}", slope <= of_paper))
        listed = "; ".join(f"{name} {one.find_slope(what, LARGEST_OF_SLOPE):.2f} (from {one.sizes[0]:g} px)"
                           for name, one in others.items())
        rows.append(Compared("[PP12, Fig. 4]", f"slope of the {what} found otherwise, up to {LARGEST_OF_SLOPE} px",
                             SETTING, f"{of_paper:.2f}", listed, "by three of the translations"))
    return rows


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Measure translations by size of the elements, and map the plate's errors."""
    shifts, sizes = (SMOKE_SHIFTS, SMOKE_SIZES) if smoke else (SHIFTS, SIZES)
    pairs = render_translations(shifts, "8 bit")
    q4 = measure_sizes(pairs, sizes, "Q4-DIC")
    fewer = shifts[FEWER]
    others = {f"PGD-DIC, eta < {ETA:g}": measure_sizes({shift: pairs[shift] for shift in fewer}, sizes, "PGD-DIC")}
    if not smoke:
        others["Q4-DIC, float images"] = measure_sizes(render_translations(fewer, "float"), sizes, "Q4-DIC")
        of_one_grain = render_translations(fewer, "8 bit", FINE)
        # Some of the smallest elements have no texture there.
        others[f"Q4-DIC, texture of {FINE[0]}-px cells"] = measure_sizes(of_one_grain, sizes[1:], "Q4-DIC")
    drawn = {f"{name} ({len(fewer)} translations)": one for name, one in others.items()}
    save_figure(draw_sizes({f"Q4-DIC ({len(shifts)} translations)": q4, **drawn}), folder / f"{NAME}_fig4.png")
    figure, errors = map_plate(sizes[:2] if smoke else MAPPED)
    save_figure(figure, folder / f"{NAME}_errors.png")
    listed = "; ".join(f"{size} px {pgd:.4f} px (Q4-DIC {of_q4:.4f} px)" for size, (pgd, of_q4) in errors.items())
    plate = Compared("[PP12, Fig. 5, 7]", "RMS error of PGD-DIC by size of the elements",
                     "the plate clamped on its left side, 8 bit, published algorithm", UNREAD, listed)
    return [*judge_slopes(q4, others), plate]
