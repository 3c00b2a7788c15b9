"""A band like those of Lueders, found by itself: Tresca strain, its Radon transform, and the jump along the line.

Nobody tells where the band lies. Its sides slide, and part, by more and more along it, over a few pixels of width.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from bench.papers.compared import UNREAD, Compared
from bench.support.line_panels import (
    BAND,
    OpeningCurve,
    compare_opening,
    describe_noise,
    draw_openings,
    draw_residuals,
    measure_residual,
)
from bench.support.opened_pair import mesh_inside, scatter_points
from ddic.fracture.opening import get_lines
from ddic.plots.canvas import save_figure
from ddic.plots.curves import draw_detection

NAME = "rhr08_bands"

SIZE, SMOKE_SIZE, ELEMENT, NOISE = 1024, 384, 16, 2.0
"""Sides of the images and of the elements, pixels; grey levels of 256."""

ANGLE = float(np.deg2rad(35.0))
"""Of the band from +x: 55 degrees from y, along which the specimen is drawn."""

STRAIN = (-0.6e-3, 2.0e-3)
"""Of the specimen beside the band, along x and y."""

SLIP, PART, GROWTH, WIDTH = 0.9, 0.3, 0.3, 1.0
"""Jump along the band and across it in its middle, pixels; the share by which it grows over half the image's side; and
the length in which the jump grows as tanh of the distance from the band's middle, pixels: nine tenths within 2.9 px."""

DISTANCE_PX, ANGLE_DEGREES = 0.3, 0.2
"""Farthest that the line may be from its place at the middle of the image, and be turned."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Band:
    """A straight band through the middle of a square image with a side of ``size`` pixels."""

    size: int

    @property
    def middle(self) -> Array:
        """A point on it, pixels."""
        return np.array([self.size / 2 + 5.37, self.size / 2 - 8.21])

    @property
    def axes(self) -> Array:
        """Unit vectors along it and to its left, as rows."""
        along = np.array([np.cos(ANGLE), np.sin(ANGLE)])
        return np.stack([along, [along[1], -along[0]]])

    def find_jump(self, points: Array) -> Array:
        """The jump, left side less right side, along the band and across it, (n, 2), pixels."""
        along = (points - self.middle) @ self.axes[0]
        return np.outer(1.0 + GROWTH * along / (self.size / 2), [SLIP, PART])

    def displacement(self, points: Array) -> Array:
        """Displacement at points (n, 2), pixels."""
        to_left = (points - self.middle) @ self.axes[1]
        opened = 0.5 * np.tanh(to_left / WIDTH)[:, None] * self.find_jump(points)
        return np.asarray(opened @ self.axes + (points - self.middle) * STRAIN)

    def measure_distance(self, line: Array) -> tuple[float, float]:
        """Distance of the band's middle from a line, pixels, and the angle between both, degrees."""
        along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
        turned = float(along @ self.axes[1])
        normal = np.array([along[1], -along[0]])
        return float(abs((self.middle - line[0]) @ normal)), float(np.rad2deg(abs(np.arcsin(turned))))


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Find the band, measure with its line, and without any."""
    band = Band(SMOKE_SIZE if smoke else SIZE)
    pair = ddic.make_synthetic_pair(band.displacement, (band.size, band.size), noise=NOISE, seed=3)
    mesh = mesh_inside(band.size, ELEMENT)
    options: dict[str, Any] = {"solver": {"method": "monolithic"}, "correlation": {"spoilt_pixels": "keep"}}
    continuous = ddic.measure(pair, mesh, **options)
    found = ddic.measure(pair, mesh, **options, discontinuity="detect", output={"uncertainty": True})
    lines = get_lines(found)
    save_figure(draw_detection(found), folder / f"{NAME}_detection.png")
    save_figure(draw_residuals({"continuous elements": continuous, "with the line that is found": found}, pair[0]),
                folder / f"{NAME}_residual.png")
    setting = (f"band at {np.rad2deg(ANGLE):.0f} degrees, jump of {SLIP:g} px along it and {PART:g} px across it that "
               f"changes by {GROWTH:.0%} over half the image, {band.size} x {band.size} px, 8 bit, noise of {NOISE:g} "
               f'grey levels, {ELEMENT}-px elements, discontinuity = "detect", solver.method = "monolithic", '
               'correlation.spoilt_pixels = "keep"')
    scores = found.detection["radon_scores"]
    rows = [_compare_place(setting, band, lines, float(scores.max()), float(np.median(scores[scores > 0]))),
            *_compare_fields(setting, band, {"continuous": continuous, "with the line": found}, pair)]
    if not lines:
        return rows
    curves = _compare_jump(band, found)
    save_figure(draw_openings(curves, "jump"), folder / f"{NAME}_fig24_25.png")
    return [*rows, *_describe_jump(setting, curves)]


def _compare_jump(band: Band, found: ddic.Result) -> dict[str, OpeningCurve]:
    """The jump along the line that was found, in the band's direction whatever the line's is."""
    opening = ddic.measure_opening(found)
    # In the other order of its vertices a line has the same openings.
    return compare_opening(opening, band.find_jump(opening.points), (opening.points - band.middle) @ band.axes[0])


def _compare_place(setting: str, band: Band, lines: list[Array], score: float, typical: float) -> Compared:
    what, wanted = "line found: distance from its place, angle", f"within {DISTANCE_PX} px and {ANGLE_DEGREES} degrees"
    if not lines:
        return Compared("[RHR08, sections 5.1-5.2]", what, setting, UNREAD, f"none; largest score {score:.1f}", "",
                        wanted, holds=False, judged_small=True)
    away, turned = band.measure_distance(lines[0])
    return Compared("[RHR08, sections 5.1-5.2]", what, setting, UNREAD,
                    f"{len(lines)} line, {away:.3f} px and {turned:.4f} degrees off; its band has a score of "
                    f"{score:.1f} standard deviations, the median of all bands above 0 is {typical:.1f}",
                    "the Radon transform sums over elements, not pixels; residuals place the line within the band",
                    wanted, len(lines) == 1 and away <= DISTANCE_PX and turned <= ANGLE_DEGREES, judged_small=True)


def _compare_fields(setting: str, band: Band, results: dict[str, ddic.Result],
                    pair: tuple[NDArray[Any], NDArray[Any]]) -> list[Compared]:
    residuals = {name: measure_residual(result, pair[0]) for name, result in results.items()}
    points = scatter_points(results["continuous"].mesh)
    errors = {name: float(np.sqrt(np.nanmean((result.at(points) - band.displacement(points)) ** 2)))
              for name, result in results.items()}
    without, with_line = residuals.values()
    return [
        Compared("[RHR08, section 6.2]", "residual in per cent of the dynamic range", setting, "less with the line",
                 ", ".join(f"{name} {residual:.3f} %" for name, residual in residuals.items()),
                 f"synthetic images; {describe_noise(NOISE, pair[0])}; the band is a small share of the image",
                 "less with the line", with_line < without, judged_small=True),
        Compared("[RHR08, section 6.2]", "RMS error of the displacement all over the mesh", setting,
                 "not known of real images",
                 ", ".join(f"{name} {error:.4f} px" for name, error in errors.items()),
                 "with the jump in a line, whose band has a width")]


def _describe_jump(setting: str, curves: dict[str, OpeningCurve]) -> list[Compared]:
    return [Compared(f"[RHR08, {figure}]", f"jump {name} the line, {BAND:g} standard deviations", setting, UNREAD,
                     f"{float(np.nanmin(curves[name].values)):.2f} to {float(np.nanmax(curves[name].values)):.2f} px, "
                     f"known {curves[name].known.min():.2f} to {curves[name].known.max():.2f} px; "
                     f"{curves[name].describe()}", "the paper's band is real, and its jump not known; standard "
                     "deviations are those of noise, and know nothing of the band's width")
            for figure, name in (("Fig. 24", "along"), ("Fig. 25", "across"))]
