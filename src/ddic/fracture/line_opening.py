"""How far the sides of a discontinuity have moved apart, along it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.fracture.lines_of_result import get_line
from ddic.io.result_reader import Result

Array = NDArray[np.float64]

BESIDE = 0.02
"""Pixels from the line at which its sides are looked up: beyond what keeps a line clear of nodes, and rounding."""

STEP = 1.0
"""Pixels between places along the line."""


@dataclass(frozen=True, eq=False)
class Opening:
    """Displacement of a line's left side less that of its right one; left is -y where the line runs along +x.

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
        At every pixel of the line inside the mesh.

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
    inside = np.isfinite(apart).all(axis=1)
    return Opening(np.concatenate(distances)[inside], at[inside], (apart * tangent).sum(axis=1)[inside],
                   (apart * to_left).sum(axis=1)[inside])
