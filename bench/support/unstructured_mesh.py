"""An unstructured mesh of triangles and quadrangles of a plate with a circular hole, without a mesher."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

SHARE = 0.5
"""Share of the pairs of neighbouring triangles on offer that become quadrangles."""

SQUARE = 0.6
"""Least sine of a quadrangle's angles."""

Region = tuple[float, float, float, float]
Circle = tuple[tuple[float, float], float]


def write_unstructured_mesh(path: Path, region: Region, element_size: float, hole: Circle,
                            seed: int = 0) -> tuple[int, float]:
    """Write a mixed T3/Q4 mesh; returns its number of cells and its area, px^2.

    Delaunay triangles of points that lie on the boundary at equal distances and inside on a triangular lattice moved
    at random; then some pairs of triangles are joined.
    """
    rng = np.random.default_rng(seed)
    points = _points(region, element_size, hole, rng)
    triangles = Delaunay(points).simplices
    corners = points[triangles]
    (centre, radius) = hole
    # Chords cut the circle's boundary, hence the centroid tells outside from inside.
    triangles = triangles[np.linalg.norm(corners.mean(axis=1) - centre, axis=1) > radius]
    triangles = _anticlockwise(points, triangles)
    quads, rest = _joined(points, triangles, rng)
    area = float(np.abs(_twice_areas(points, triangles)).sum() / 2)
    cells = [("quad", quads), ("triangle", rest)]
    meshio.write(path, meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells), file_format="vtk")
    return len(quads) + len(rest), area


def _points(region: Region, size: float, hole: Circle, rng: np.random.Generator) -> NDArray[np.float64]:
    x0, y0, x1, y1 = region
    (centre, radius) = hole
    # As many triangles to the area as squares of this size would give once half of the pairs are joined.
    step = size * 1.22
    x = np.linspace(x0, x1, max(2, round((x1 - x0) / step) + 1))
    y = np.linspace(y0, y1, max(2, round((y1 - y0) / step) + 1))
    sides = [np.column_stack([x, np.full_like(x, y0)]), np.column_stack([x, np.full_like(x, y1)]),
             np.column_stack([np.full_like(y, x0), y])[1:-1], np.column_stack([np.full_like(y, x1), y])[1:-1]]
    angles = np.linspace(0, 2 * np.pi, max(8, round(2 * np.pi * radius / step)), endpoint=False)
    circle = np.asarray(centre) + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    rows = np.arange(y0 + 0.75 * step, y1 - 0.6 * step, step * np.sqrt(3) / 2)
    inner = np.concatenate([_row(x0 + (0.75 + 0.5 * (k % 2)) * step, x1 - 0.6 * step, step, height)
                            for k, height in enumerate(rows)])
    inner += rng.uniform(-0.2, 0.2, inner.shape) * step
    inner = inner[np.linalg.norm(inner - centre, axis=1) > radius + 0.6 * step]
    return np.concatenate([*sides, circle, inner])


def _row(begin: float, end: float, step: float, height: float) -> NDArray[np.float64]:
    x = np.arange(begin, end, step)
    return np.column_stack([x, np.full_like(x, height)])


def _twice_areas(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.asarray((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _anticlockwise(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    turned = _twice_areas(points, triangles) < 0
    triangles = triangles.astype(np.int64)
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles


def _joined(points: NDArray[np.float64], triangles: NDArray[np.int64],
            rng: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Quadrangles (n, 4) from pairs of neighbours, in random order, and the triangles left (m, 3)."""
    sides: dict[tuple[int, int], int] = {}
    pairs = []
    for number, (a, b, c) in enumerate(triangles.tolist()):
        for one, two in ((a, b), (b, c), (c, a)):
            other = sides.pop((two, one), None)
            if other is None:
                sides[one, two] = number
            else:
                pairs.append((number, other, one, two))
    free = np.ones(len(triangles), dtype=bool)
    quads = []
    for k in rng.permutation(len(pairs)):
        number, other, one, two = pairs[k]
        if not (free[number] and free[other]) or rng.random() > SHARE:
            continue
        quad = [one, _opposite(triangles[other], one, two), two, _opposite(triangles[number], one, two)]
        if _least_sine(points[quad]) > SQUARE:
            free[[number, other]] = False
            quads.append(quad)
    return np.array(quads, dtype=np.int64), triangles[free]


def _opposite(triangle: NDArray[np.int64], one: int, two: int) -> int:
    return int(triangle[(triangle != one) & (triangle != two)][0])


def _least_sine(corners: NDArray[np.float64]) -> float:
    ahead = np.roll(corners, -1, axis=0) - corners
    behind = np.roll(corners, 1, axis=0) - corners
    cross = ahead[:, 0] * behind[:, 1] - ahead[:, 1] * behind[:, 0]
    return float((cross / np.linalg.norm(ahead, axis=1) / np.linalg.norm(behind, axis=1)).min())
