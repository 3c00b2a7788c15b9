"""A discontinuity found by itself: where strain stands out, refined, and kept where the images speak for it.

The strain of a continuous field stands out in a straight band, found by a Radon transform over cells [RHR08].
"""

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array
from ddic.detection.refine_line import (
    CUT_OFF,
    REACH,
    TOLERANCES,
    RefinedLine,
    UncertainLine,
    compute_residuals,
    find_strip,
    refine_line,
)
from ddic.errors import ConvergenceError, FactorizationError, SingularSubdomainError
from ddic.functionals.line_band import list_pixels_outside
from ddic.kinematics.enriched import Discontinuities, Opening
from ddic.kinematics.strain import compute_strain
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.quality import measure_cell_size
from ddic.start.coarse_displacement import CutField, cut_level
from ddic.start.independent import Images, correlate_alone

NEIGHBOURHOOD = 3.6
"""Radius, elements, of the cells with whose plane of least squares a cell's strain is compared. A larger one takes
smooth fields for bands, in a smaller one the plane follows the band."""

FEWEST_CELLS = 6
"""Cells that a band must have. Fewer stand out by chance."""

OF_NORMAL = 1.4826
"""Standard deviation of normal numbers over the median of their absolute values."""

FLAT = 1e-6
"""Weight of a slope of 0, which decides where a few points leave it open."""

TINY = 1e-300
"""A spread below any that is not 0."""


@dataclass(frozen=True, eq=False)
class StrainBand:
    """A straight band.

    Attributes
    ----------
    line : (2, 2) array
        Its middle from one side of all points to the other, pixels.
    score : float
        Sum of what stands out in it, in standard deviations of such sums where nothing does.
    """

    line: Array
    score: float


def compute_tresca_strain(strain: Array) -> Array:
    """Compute the equivalent strain |e1 - e2| / 2 of plane tensors exx, eyy, exy, (n, 3).

    That is half of the difference of the principal strains, (n,).
    """
    exx, eyy, exy = strain.T
    return np.asarray(np.hypot((exx - eyy) / 2, exy))


def find_band(points: Array, strain: Array, size: float) -> StrainBand:
    """Find the straight band in which an equivalent strain exceeds that of its surroundings most.

    ``points`` are cells' centres, (n, 2), pixels, ``strain`` their equivalent strain, (n,), ``size`` theirs, pixels.
    """
    excess = strain - _fit_planes(points, strain, NEIGHBOURHOOD * size)
    spread = OF_NORMAL * float(np.median(np.abs(excess - np.median(excess))))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    length = float(np.linalg.norm(np.ptp(points, axis=0))) + size
    n_bands = int(np.ceil(length / size)) + 1
    best = StrainBand(np.stack([middle, middle]), 0.0)
    for angle in np.arange(0.0, np.pi, size / length / 2):
        along = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-along[1], along[0]])
        places = ((points - middle) @ normal + length / 2) / size
        # Bands lie half a cell apart: two sets of bands, a cell apart each.
        for shift in (0.0, 0.5):
            scores = _sum_bands(places + shift, excess, n_bands + 1) / max(spread, TINY)
            # A line through the mesh alone: bands at its edge reach half a cell beyond the last centres.
            at = np.arange(n_bands + 1) - shift
            scores[(at < places.min()) | (at > places.max())] = 0.0
            k = int(scores.argmax())
            if scores[k] > best.score:
                foot = middle + ((k - shift) * size - length / 2) * normal
                best = StrainBand(np.stack([foot - length * along, foot + length * along]), float(scores[k]))
    return best


def _fit_planes(points: Array, values: Array, radius: float) -> Array:
    """Value at each point of the plane that fits the values about it: edges of a smooth field do not stand out."""
    pairs = build_tree(points).query_pairs(radius, output_type="ndarray")
    one, other = np.concatenate([pairs, pairs[:, ::-1], np.arange(len(points))[:, None].repeat(2, axis=1)]).T
    away = (points[other] - points[one]) / radius
    basis = np.column_stack([np.ones(len(away)), away])
    normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(normal, one, basis[:, :, None] * basis[:, None, :])
    np.add.at(right, one, basis * values[other][:, None])
    # Points in a row do not tell the slope across it.
    normal += FLAT * np.diag([0.0, 1.0, 1.0])
    return np.asarray(np.linalg.solve(normal, right[..., None])[:, 0, 0])


def _sum_bands(places: Array, excess: Array, n_bands: int) -> Array:
    """Sums over bands at 0, 1, ..., by the root of the sum of the weights' squares; 0 where a band has few cells.

    Weights fall linearly to 0 at a distance of 1: a jump is smeared over two cells.
    """
    low = np.floor(places).astype(np.int64)
    bands = np.concatenate([low, low + 1])
    weights = np.concatenate([low + 1 - places, places - low])
    total = np.bincount(bands, weights * np.tile(excess, 2), n_bands)
    norm = np.sqrt(np.bincount(bands, weights**2, n_bands))
    is_long = np.bincount(bands, weights, n_bands) >= FEWEST_CELLS
    return np.asarray(np.where(is_long, total / np.maximum(norm, TINY), 0.0))


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


def find_line(images: Images, mesh: Mesh, displacement: Array, opening: Opening) -> tuple[Array | None, str]:
    """Find the straight line across which a displacement jumps, across the region, (2, 2), pixels; or None and why.

    ``displacement`` is that of a continuous field, (n_nodes, 2), pixels; ``opening`` says in which directions it may
    jump. The text says what the user should know.
    """
    strain = compute_strain(mesh, displacement.ravel()).infinitesimal
    size = measure_cell_size(mesh)
    band = find_band(mesh.centroids, compute_tresca_strain(strain), size)
    if band.score < LEAST_SCORE:
        return None, (f"detection: no line; no band of strain stands out (score {band.score:.1f}, {LEAST_SCORE:g} "
                      "asked for)")
    given = UncertainLine(Discontinuities((band.line,), (opening,)), 0, UNCERTAIN * size)
    try:
        refined = refine_line(images, mesh, CutField(mesh, displacement), given, SETTLED)
        before, after = _compare_residuals(images, mesh, displacement, refined)
    except (ConvergenceError, SingularSubdomainError, FactorizationError) as error:
        return None, (f"detection: no line; where strain stands out (score {band.score:.1f}) no line could be "
                      f"measured: {error}")
    told = f"residual in the elements that it cuts {before.rms:.3g} grey levels without it, {after.rms:.3g} with it"
    if not _speaks_for_line(before, after):
        return None, (f"detection: no line; where strain stands out (score {band.score:.1f}) a line explains no more "
                      f"than chance: {told}")
    line = _clip_to_region(mesh, refined.line)
    (x0, y0), (x1, y1) = line
    return line, (f"detection: line from ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f}) px (score {band.score:.1f}, "
                  f"moved {refined.n_moves} times); {told}")


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
