"""How far the sides of the discontinuities that a result was measured with have moved apart, along them."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.io.result_reader import Result
from ddic.io.result_schema import DOUBTFUL, EXCLUDED, EXCLUDED_STATES, REGULARIZATION_BIAS, get_case
from ddic.mesh.interpolation import CellSearch, interpolate_located, place_in_cells
from ddic.mesh.mesh import Mesh


def get_lines(result: Result) -> list[Array]:
    """Get the vertices, (n_vertices, 2), pixels, of each line that a result was measured with, as given or as found."""
    return [np.array(section["vertices"]) for section in get_case(result.attributes).get("discontinuity", ())]


def get_line(result: Result, number: int) -> Array:
    """Get the vertices, pixels, of a result's discontinuity, numbered from 1; raises InputError where there is none."""
    lines = get_lines(result)
    if not lines:
        raise InputError(f"{result.path}: was measured without discontinuities; give some in the case (where one was "
                         "to be found, the log says why none was)")
    if not 1 <= number <= len(lines):
        raise InputError(f"{result.path}: line {number}: there are {len(lines)}; give a number from 1 to {len(lines)}")
    return lines[number - 1]


BESIDE = 0.02
"""Pixels from the line at which its sides are looked up: beyond what keeps a line clear of nodes, and rounding."""

STEP = 1.0
"""Pixels between places along the line."""


@dataclass(frozen=True, eq=False)
class Opening:
    """Displacement of a line's left side less that of its right one; left is -y where the line runs along +x.

    In the other order of its vertices, a line has the same normal opening and the same tangential one: both the sides
    and the direction change.

    Attributes
    ----------
    distance : (n,) array
        Along the line from its first vertex, pixels.
    points : (n, 2) array
        Places on the line, pixels.
    tangential : (n,) array
        Slip along the line, pixels.
    normal : (n,) array
        How far the sides part, pixels; negative where they would overlap. Both are nan where the cell of either side is
        excluded: its displacement is that of its neighbours.
    excluded : (n,) uint8 array
        Why the cell of either side is, as the result's cell field says: 0 where neither is, or 4 where one is used
        though mechanics hold it off.
    doubtful : (n,) bool array
        Whether the cell of either side is marked doubtful.
    sigma_tangential, sigma_normal : (n,) array or None
        Standard deviations that the images' noise leaves in both, pixels: 0 in a direction in which the case lets
        nothing open. None where the result holds none.
    bias_tangential, bias_normal : (n,) array or None
        Estimated openings less the true ones, as far as regularization is the reason, pixels; None where the result
        holds none.
    """

    distance: Array
    points: Array
    tangential: Array
    normal: Array
    excluded: NDArray[np.uint8]
    doubtful: BoolArray
    sigma_tangential: Array | None = None
    sigma_normal: Array | None = None
    bias_tangential: Array | None = None
    bias_normal: Array | None = None


@dataclass(frozen=True, eq=False)
class Places:
    """Places along a line both sides of which lie in a mesh.

    Attributes
    ----------
    distance : (n,) array
        Along the line from its first vertex, pixels.
    points, tangent, to_left : (n, 2) array
        On the line, pixels, and unit vectors along it and to its left.
    cells : (2, n) int64 array
        That hold the left side and the right one.
    """

    distance: Array
    points: Array
    tangent: Array
    to_left: Array
    cells: IntArray

    @property
    def sides(self) -> tuple[Array, Array]:
        """Points beside the line, (n, 2) each, pixels: left and right."""
        return self.points + BESIDE * self.to_left, self.points - BESIDE * self.to_left

    def find_components(self, apart: Array) -> tuple[Array, Array]:
        """Components along the line and to its left of what is left less right, (n, 2)."""
        return (apart * self.tangent).sum(axis=1), (apart * self.to_left).sum(axis=1)


def find_places(mesh: Mesh, vertices: Array) -> Places:
    """Find the places on a polyline, (n_vertices, 2), pixels, a pixel apart, that have both sides in a mesh."""
    parts, begin = [], 0.0
    for start, end in pairwise(vertices):
        length = float(np.linalg.norm(end - start))
        along = np.arange(STEP / 2, length, STEP)
        tangent = (end - start) / length
        parts.append((begin + along, start + along[:, None] * tangent, np.broadcast_to(tangent, (len(along), 2))))
        begin += length
    distance, at, tangent = (np.concatenate(part) for part in zip(*parts, strict=True))
    places = Places(distance, at, tangent, np.column_stack([tangent[:, 1], -tangent[:, 0]]), np.zeros((2, 0), np.int64))
    search = CellSearch(mesh)
    cells = np.stack([search.locate(side).cells for side in places.sides])
    inside = (cells >= 0).all(axis=0) & ~_find_uncut_bends(mesh, vertices, at, cells)
    return Places(distance[inside], at[inside], tangent[inside], places.to_left[inside], cells[:, inside])


def measure_opening(result: Result, line: int = 1) -> Opening:
    """Measure how far the sides of a discontinuity have moved apart.

    Parameters
    ----------
    result : Result
        Measured with discontinuities.
    line : int
        Which of them, from 1.

    Returns
    -------
    Opening
        At every pixel of the line inside the mesh; but about bends, where the straight line that cuts an element
        leaves both sides of the polyline on one side of the cut.

    Raises
    ------
    InputError
        Where there is no such line.
    """
    places = find_places(result.mesh, get_line(result, line))
    excluded = _look_up(result, EXCLUDED, places.cells)
    is_known = ~np.isin(excluded, EXCLUDED_STATES)
    beside = [place_in_cells(result.mesh, cells, side) for cells, side in zip(places.cells, places.sides, strict=True)]

    def part(values: Array) -> tuple[Array, Array]:
        """Tangential and normal components of how far values at nodes, (n_nodes, 2), part; nan where excluded."""
        left, right = (interpolate_located(result.mesh, values, side) for side in beside)
        return places.find_components(np.where(is_known[:, None], left - right, np.nan))

    opening = Opening(places.distance, places.points, *part(result.displacement), excluded,
                      _look_up(result, DOUBTFUL, places.cells) > 0)
    table = result.opening_deviations
    if table:
        of_line = np.flatnonzero(table["line"] == line)
        # A short line may have no place of its own.
        sigmas = [np.interp(places.distance, table["distance_px"][of_line], table[name][of_line], np.nan, np.nan)
                  if len(of_line) else np.full(len(places.distance), np.nan)
                  for name in ("sigma_tangential_px", "sigma_normal_px")]
        tangential, normal = (np.where(is_known, sigma, np.nan) for sigma in sigmas)
        opening = replace(opening, sigma_tangential=tangential, sigma_normal=normal)
    if REGULARIZATION_BIAS in result.point_data:
        tangential, normal = part(result.point_data[REGULARIZATION_BIAS][:, :2])
        opening = replace(opening, bias_tangential=tangential, bias_normal=normal)
    return opening


def measure_openings(result: Result) -> list[Opening]:
    """Measure the openings of all discontinuities, in the order of the case; raises InputError where there are none."""
    n_lines = max(len(get_lines(result)), 1)
    return [measure_opening(result, number) for number in range(1, n_lines + 1)]


def _look_up(result: Result, name: str, cells: IntArray) -> NDArray[np.uint8]:
    """State of the cells of both sides, (2, n), by a cell field; of either where the other is as it should be, (n,)."""
    if name not in result.cell_data:
        return np.zeros(cells.shape[1], dtype=np.uint8)
    left, right = np.asarray(result.cell_data[name], dtype=np.uint8)[cells]
    # Excluded cells have the smaller numbers of those that are not 0.
    return np.where((left == 0) | ((right > 0) & (right < left)), right, left)


def _find_uncut_bends(mesh: Mesh, vertices: Array, at: Array, cells: IntArray) -> BoolArray:
    """Whether a place near a bend of the line has both its sides, in cells (2, n), in parts that hang together."""
    bends = vertices[1:-1]
    if not len(bends):
        return np.zeros(len(at), dtype=bool)
    largest = float(np.ptp(mesh.nodes[mesh.cells[:, :3]], axis=1).max())
    near = np.linalg.norm(at[:, None] - bends, axis=2).min(axis=1) <= 2 * largest
    left, right = mesh.cells[cells]
    shared = (left[:, :, None] == right[:, None, :]) & (left >= 0)[:, :, None]
    return np.asarray(near & shared.any(axis=(1, 2)))
