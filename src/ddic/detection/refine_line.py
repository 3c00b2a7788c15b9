"""A straight line moved and turned until its sides' pixels fit the images best [RHR08]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.detection.both_sides import compute_residuals, evaluate_both_sides
from ddic.errors import ConvergenceError
from ddic.functionals.line_band import BAND
from ddic.kinematics.discontinuities import Discontinuities, Opening
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across
from ddic.mesh.polyline import measure_distance
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.raster import list_pixels, rasterize
from ddic.solvers.correction_size import Tolerances
from ddic.start.coarse_displacement import LevelMesh, cut_level
from ddic.start.independent import Images, correlate_alone

Array = NDArray[np.float64]

REACH = 3.5
"""Distance from the line, elements, up to which cells are measured with it. A larger one costs more."""

SEARCHED = 0.6
"""Distance, elements, by which a line's ends may move at a time: of what a Radon transform may be off."""

STEPS = (0.5, 0.05)
"""Steps of the search for a line's ends, pixels, one after the other."""

CUT_OFF = 4.0
"""Cut-off wavelength along the strip, elements."""

N_BINS = 256
"""Pieces along the line in which pixels are sorted by their height: a line that turns by a pixel from end to end is
off by 1/512 px in them."""

MOVED = 0.11
"""Pixels: a line whose ends move by no more has been found: two of the search's finer steps, within which noise lets it
waver."""

MOST_MOVES = 8
"""Times that a line is moved; three or four are usual."""

TOLERANCES = Tolerances(relative=1e-12, rms=0.003, max_iterations=50, largest=np.inf)
"""Of Gauss-Newton for a line that is still moved: a hundredth of the jumps that can be found."""


@dataclass(frozen=True, eq=False)
class RefinedLine:
    """A line with the displacement on both sides.

    Attributes
    ----------
    line : (2, 2) array
        Pixels.
    cells : LevelMesh
        The cells about it, cut.
    displacement : (n_dofs,) array
        Of their nodes, pixels.
    n_moves : int
        How often it was moved.
    """

    line: Array
    cells: LevelMesh
    displacement: Array
    n_moves: int


def refine_line(images: Images, mesh: Mesh, displacement: Array, line: Array, opening: Opening) -> RefinedLine:
    """Move a line until its sides' pixels fit best, each side's displacement being measured with the line where it is.

    Parameters
    ----------
    images : Images
        The pair.
    mesh : Mesh
        The region, pixels.
    displacement : (n_nodes, 2) array
        Of a continuous field, from which sides start, pixels.
    line : (2, 2) array
        Where it may be, pixels.
    opening : Opening
        In which directions the displacement may jump.

    Returns
    -------
    RefinedLine
        Where it does not move any more.

    Raises
    ------
    ConvergenceError
        Where the line or the displacement does not converge.
    SingularSubdomainError
        Where the pixels do not determine the displacement.
    """
    size = measure_cell_size(mesh)
    for n_moves in range(MOST_MOVES):
        strip, nodes = mesh.create_submesh(find_strip(mesh, line, REACH * size))
        cells = cut_level(strip, Discontinuities((line,), (opening,)), images.active, images.degree)
        if cells.mesh.parts is None:
            raise ConvergenceError("the line left the mesh")
        start = displacement[nodes][cells.cut.node_of]
        u = correlate_alone(images, cells, CUT_OFF * size, TOLERANCES, [start.ravel()], "the strip along a line")
        moved, distance = _move_line(images, cells, u, line, SEARCHED * size)
        if distance <= MOVED:
            return RefinedLine(line, cells, u, n_moves)
        line = moved
    raise ConvergenceError(f"the line was still moving after {MOST_MOVES} rounds")


def find_strip(mesh: Mesh, line: Array, reach: float) -> NDArray[np.int64]:
    """Find the cells about a line.

    Parameters
    ----------
    mesh : Mesh
        Pixels.
    line : (2, 2) array
        Pixels.
    reach : float
        Distance of their centres, pixels.

    Returns
    -------
    (n,) array of int64
        Their sorted numbers.
    """
    return np.flatnonzero(measure_distance(mesh.centroids, line) <= reach).astype(np.int64)


def _move_line(images: Images, cells: LevelMesh, displacement: Array, line: Array, reach: float) -> tuple[Array, float]:
    """The line by which the pixels within reach are told best to which side they belong, and how far its ends moved."""
    pixels, _ = list_pixels(rasterize(cells.mesh), np.arange(cells.mesh.n_cells))
    points = pixels.astype(np.float64)
    near = measure_distance(points, line) <= reach + BAND[images.degree]
    pixels, points = pixels[near], points[near]
    u = displacement.reshape(cells.mesh.nodes.shape)
    is_left = multiply_across(line[1] - line[0], points - line[0]) > 0
    on_left, on_right = evaluate_both_sides(cells.cut, u, line, points)
    left = compute_residuals(images, pixels, on_left, is_left)
    right = compute_residuals(images, pixels, on_right, ~is_left)
    # What a pixel costs on the left beyond what it costs on the right.
    cost = left**2 - right**2
    counted = np.isfinite(cost)
    if not counted.any():
        raise ConvergenceError("no pixel about the line counts")
    along = line[1] - line[0]
    length = float(np.linalg.norm(along))
    shares = ((points[counted] - line[0]) @ along) / length**2
    heights = multiply_across(along, points[counted] - line[0]) / length
    first, last = float(shares.min()), float(shares.max())
    costs = _tabulate(cost[counted], (shares - first) / (last - first), heights, reach)
    ends = _search_on_grids(costs, reach)
    normal = np.array([-along[1], along[0]]) / length
    at_line_ends = ends[0] + (ends[1] - ends[0]) * (np.array([0.0, 1.0]) - first) / (last - first)
    return line + at_line_ends[:, None] * normal, float(np.abs(ends).max())


def _tabulate(cost: Array, places: Array, heights: Array, reach: float) -> Array:
    """Costs of the pixels above a height, (N_BINS along the line, n_heights), which are STEPS[-1] apart from -reach."""
    n_heights = int(np.ceil(2 * reach / STEPS[-1])) + 1
    within, _, _ = np.histogram2d(places, heights, bins=(N_BINS, n_heights), weights=cost,
                                  range=((0.0, 1.0), (-reach, -reach + n_heights * STEPS[-1])))
    above = heights >= -reach + n_heights * STEPS[-1]
    beyond = np.histogram(places[above], N_BINS, (0.0, 1.0), weights=cost[above])[0]
    return np.asarray(np.cumsum(within[:, ::-1], axis=1)[:, ::-1] + beyond[:, None])


def _search_on_grids(costs: Array, reach: float) -> Array:
    """Heights of both ends at which the line costs least, on a coarse grid and then on a fine one about it."""
    places = (np.arange(N_BINS) + 0.5) / N_BINS
    best, around = np.zeros(2), reach
    for step in STEPS:
        heights = np.arange(-around, around + step / 2, step)
        one, other = (axis.ravel() for axis in np.meshgrid(best[0] + heights, best[1] + heights, indexing="ij"))
        total = np.zeros(len(one))
        for k, place in enumerate(places):
            at = np.rint((one + (other - one) * place + reach) / STEPS[-1]).astype(np.int64)
            total += costs[k, np.clip(at, 0, costs.shape[1] - 1)]
        least = int(total.argmin())
        best, around = np.array([one[least], other[least]]), 2 * step
    return best
