"""How far the sides of a discontinuity have moved apart, along it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.fracture.lines_of_result import get_line, get_lines
from ddic.io.result_reader import Result
from ddic.mesh.interpolation import locate

Array = NDArray[np.float64]

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
        How far the sides part, pixels; negative where they would overlap.
    """

    distance: Array
    points: Array
    tangential: Array
    normal: Array


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
    distances, points, tangents = [], [], []
    begin = 0.0
    for start, end in pairwise(vertices):
        length = float(np.linalg.norm(end - start))
        along = np.arange(STEP / 2, length, STEP)
        tangent = (end - start) / length
        distances.append(begin + along)
        points.append(start + along[:, None] * tangent)
        tangents.append(np.broadcast_to(tangent, (len(along), 2)))
        begin += length
    at, tangent = np.concatenate(points), np.concatenate(tangents)
    to_left = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    apart = result.at(at + BESIDE * to_left) - result.at(at - BESIDE * to_left)
    inside = np.isfinite(apart).all(axis=1) & ~_find_uncut_bends(result, vertices, at, to_left)
    return Opening(np.concatenate(distances)[inside], at[inside], (apart * tangent).sum(axis=1)[inside],
                   (apart * to_left).sum(axis=1)[inside])


def measure_openings(result: Result) -> list[Opening]:
    """Measure the openings of all discontinuities.

    Parameters
    ----------
    result : Result
        Measured with discontinuities.

    Returns
    -------
    list of Opening
        In the order of the case.

    Raises
    ------
    InputError
        Where there are none.
    """
    n_lines = max(len(get_lines(result)), 1)
    return [measure_opening(result, number) for number in range(1, n_lines + 1)]


def _find_uncut_bends(result: Result, vertices: Array, at: Array, to_left: Array) -> NDArray[np.bool_]:
    """Whether a place near a bend of the line has both its sides in parts of cells that hang together."""
    bends = vertices[1:-1]
    if not len(bends):
        return np.zeros(len(at), dtype=bool)
    mesh = result.mesh
    largest = float(np.ptp(mesh.nodes[mesh.cells[:, :3]], axis=1).max())
    near = np.linalg.norm(at[:, None] - bends, axis=2).min(axis=1) <= 2 * largest
    left, right = (mesh.cells[locate(mesh, at + side * BESIDE * to_left).cells] for side in (1, -1))
    shared = (left[:, :, None] == right[:, None, :]) & (left >= 0)[:, :, None]
    return np.asarray(near & shared.any(axis=(1, 2)))
