"""How far the sides of the discontinuities that a result was measured with have moved apart, along them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.io.result_reader import Result
from ddic.io.result_schema import DOUBTFUL, EXCLUDED, EXCLUDED_STATES, get_case
from ddic.mesh.interpolation import locate
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
    """

    distance: Array
    points: Array
    tangential: Array
    normal: Array
    excluded: NDArray[np.uint8]
    doubtful: BoolArray


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
    vertices = get_line(result, line)
    parts, begin = [], 0.0
    for start, end in pairwise(vertices):
        length = float(np.linalg.norm(end - start))
        along = np.arange(STEP / 2, length, STEP)
        tangent = (end - start) / length
        parts.append((begin + along, start + along[:, None] * tangent, np.broadcast_to(tangent, (len(along), 2))))
        begin += length
    distance, at, tangent = (np.concatenate(part) for part in zip(*parts, strict=True))
    to_left = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    sides = at + BESIDE * to_left, at - BESIDE * to_left
    cells = np.stack([locate(result.mesh, side).cells for side in sides])
    apart = result.at(sides[0]) - result.at(sides[1])
    inside = (cells >= 0).all(axis=0) & ~_find_uncut_bends(result.mesh, vertices, at, cells)
    cells, apart, tangent, to_left = cells[:, inside], apart[inside], tangent[inside], to_left[inside]
    excluded = _look_up(result, EXCLUDED, cells)
    apart[np.isin(excluded, EXCLUDED_STATES)] = np.nan
    return Opening(distance[inside], at[inside], (apart * tangent).sum(axis=1),
                   (apart * to_left).sum(axis=1), excluded, _look_up(result, DOUBTFUL, cells) > 0)


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
