"""A discontinuity found by itself: where strain stands out, refined, and kept where the images speak for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.detection.both_sides import compute_residuals
from ddic.detection.refine_line import CUT_OFF, REACH, TOLERANCES, RefinedLine, find_strip, refine_line
from ddic.detection.strain_band import compute_tresca_strain, find_band
from ddic.errors import ConvergenceError, FactorizationError, SingularSubdomainError
from ddic.functionals.line_band import list_pixels_outside
from ddic.kinematics.enriched import Discontinuities, Opening
from ddic.kinematics.strain import compute_strain
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_cell_size
from ddic.start.coarse_displacement import CutField, cut_level
from ddic.start.independent import Images, correlate_alone

Array = NDArray[np.float64]

LEAST_SCORE = 8.0
"""Score of a band of strain from which on a line is looked for there: noise alone reaches 5. A larger one misses small
jumps."""

LEAST_GAIN = 3.0
"""How often a line must lower the sum of squared residuals by what its unknowns would lower it by chance. A larger one
misses small jumps, a smaller one takes what elements do not resolve for a line."""

UNCERTAIN = 0.2
"""Standard deviation of the place of a band of strain, elements: of what a Radon transform may be off."""

SETTLED = 0.11
"""Pixels: a line that moves by no more has been found: two of the finer steps of its search, within which noise lets it
waver."""

OUTLIERS = 5.0
"""Standard deviations by which chance may exceed its mean."""


@dataclass(frozen=True, eq=False)
class Detection:
    """What a search for a discontinuity found.

    Attributes
    ----------
    line : (2, 2) array or None
        Across the region, pixels; None where nothing stands out.
    note : str
        What the user should know.
    """

    line: Array | None
    note: str


def find_line(images: Images, mesh: Mesh, displacement: Array, opening: Opening) -> Detection:
    """Find the straight line across which a displacement jumps.

    Parameters
    ----------
    images : Images
        The pair.
    mesh : Mesh
        The region, pixels.
    displacement : (n_nodes, 2) array
        Of a continuous field, pixels.
    opening : Opening
        In which directions the displacement may jump.

    Returns
    -------
    Detection
        The line, or why there is none.
    """
    strain = compute_strain(mesh, displacement.ravel()).infinitesimal
    band = find_band(mesh.centroids, compute_tresca_strain(strain), measure_cell_size(mesh))
    if band.score < LEAST_SCORE:
        return Detection(None, f"detection: no line; no band of strain stands out (score {band.score:.1f}, "
                               f"{LEAST_SCORE:g} asked for)")
    try:
        refined = refine_line(images, mesh, CutField(mesh, displacement), Discontinuities((band.line,), (opening,)), 0,
                              UNCERTAIN * measure_cell_size(mesh), SETTLED)
        before, after = _compare_residuals(images, mesh, displacement, refined)
    except (ConvergenceError, SingularSubdomainError, FactorizationError) as error:
        return Detection(None, f"detection: no line; where strain stands out (score {band.score:.1f}) no line could be "
                               f"measured: {error}")
    told = f"residual in the elements that it cuts {before.rms:.3g} grey levels without it, {after.rms:.3g} with it"
    if not _speaks_for_line(before, after):
        return Detection(None, f"detection: no line; where strain stands out (score {band.score:.1f}) a line explains "
                               f"no more than chance: {told}")
    line = _clip_to_region(mesh, refined.line)
    (x0, y0), (x1, y1) = line
    return Detection(line, f"detection: line from ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f}) px (score "
                           f"{band.score:.1f}, moved {refined.n_moves} times); {told}")


@dataclass(frozen=True)
class _Squares:
    """Sum of squared residuals of some pixels, and how many unknowns explain them."""

    total: float
    n_pixels: int
    n_unknowns: int

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.total / max(self.n_pixels, 1)))


def _speaks_for_line(before: _Squares, after: _Squares) -> bool:
    """Whether residuals fall by far more than by chance: noise lets each unknown explain its variance once."""
    n_more = after.n_unknowns - before.n_unknowns
    if n_more <= 0 or after.n_pixels <= n_more:
        return False
    variance = after.total / max(after.n_pixels - n_more, 1)
    by_chance = (n_more + OUTLIERS * np.sqrt(2 * n_more)) * variance
    return bool(before.total - after.total > LEAST_GAIN * by_chance)


def _compare_residuals(images: Images, mesh: Mesh, displacement: Array, refined: RefinedLine
                       ) -> tuple[_Squares, _Squares]:
    """Residuals in the cut cells, of a continuous field measured on the same strip alike, and with the line."""
    size = measure_cell_size(mesh)
    strip, nodes = mesh.create_submesh(find_strip(mesh, refined.line, REACH * size))
    whole = cut_level(strip, Discontinuities(), images.active, images.degree)
    continuous = correlate_alone(images, whole, CUT_OFF * size, TOLERANCES, [displacement[nodes].ravel()],
                                 "the strip along a line")
    cut = refined.cells.cut
    if cut.mesh.parts is None:
        raise ValueError("no line cuts the mesh")
    pixels, parts = list_pixels_outside(cut.mesh, cut.mesh.parts.cells, images.degree)
    found = []
    for cells, numbers, u in ((whole, cut.cell_of[parts], continuous), (refined.cells, parts, refined.displacement)):
        placed = place_in_cells(cells.mesh, numbers, pixels.astype(np.float64))
        there = interpolate_located(cells.mesh, u.reshape(cells.mesh.nodes.shape), placed)
        found.append(compute_residuals(images, pixels, there))
    counted = np.isfinite(found[0]) & np.isfinite(found[1])
    before, after = (_Squares(float((residuals[counted] ** 2).sum()), int(counted.sum()), cells.kinematics.n_unknowns)
                     for residuals, cells in zip(found, (whole, refined.cells), strict=True))
    return before, after


def _clip_to_region(mesh: Mesh, line: Array) -> Array:
    """The line from one side of the mesh's box to the other, a cell beyond."""
    size = measure_cell_size(mesh)
    low, high = mesh.nodes.min(axis=0) - size, mesh.nodes.max(axis=0) + size
    along = line[1] - line[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = (low - line[0]) / along, (high - line[0]) / along
    enter = float(np.nanmax(np.minimum(to_low, to_high)))
    leave = float(np.nanmin(np.maximum(to_low, to_high)))
    return np.stack([line[0] + enter * along, line[0] + leave * along])
