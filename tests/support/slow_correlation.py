"""A correlation by the readable kernels, and the pixels of its cells from its mesh alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import PIXEL_KERNELS, Correlation
from ddic.mesh.cell_type import Q4
from support.readable_kernels import READABLE


@contextmanager
def readable_kernels_instead() -> Iterator[None]:
    """Within it, correlations call the readable kernels where they call compiled ones."""
    with mock.patch.dict(PIXEL_KERNELS, bilinear=READABLE, trilinear=READABLE):
        yield


@dataclass(frozen=True)
class CellPixels:
    """Pixels of one cell.

    x, y: (n,); shapes: (n, nodes) values of the shape functions; nodes: (nodes,) node numbers;
    f, gradient: (n,), (n, 2) of the reference image.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    shapes: NDArray[np.float64]
    nodes: NDArray[np.int64]
    f: NDArray[np.float64]
    gradient: NDArray[np.float64]


def shape_functions(kind: int, local: NDArray[np.float64]) -> NDArray[np.float64]:
    xi, eta = local.T
    if kind == Q4.vtk:
        return np.stack([(1 - xi) * (1 - eta), (1 + xi) * (1 - eta), (1 + xi) * (1 + eta), (1 - xi) * (1 + eta)],
                        axis=1) / 4
    return np.stack([1 - xi - eta, xi, eta], axis=1)


def local_points(kind: int, corners: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert x = sum_a N_a x_a at points (n, 2) by Newton's method with differences for derivatives."""
    local = np.full(points.shape, 0.0 if kind == Q4.vtk else 1 / 3)
    step = 1e-4  # exact but for rounding: N is linear in each coordinate
    for _ in range(60):
        gap = points - shape_functions(kind, local) @ corners
        columns = [(shape_functions(kind, local + step * d) - shape_functions(kind, local - step * d)) @ corners
                   / (2 * step) for d in np.eye(2)]
        local += np.linalg.solve(np.stack(columns, axis=2), gap[..., None])[..., 0]
    return local


def cell_pixels(part: Correlation) -> list[CellPixels]:
    """The pixels of every cell, with the reference image's data."""
    mesh, raster, f = part.mesh, part.raster, part.reference
    rows = raster.find_runs(np.arange(mesh.n_cells))[1][:, 0]
    out = []
    for e in range(mesh.n_cells):
        runs = range(raster.row_ptr[e], raster.row_ptr[e + 1])
        pixels = [(x, int(rows[r])) for r in runs for x in range(raster.starts[r], raster.stops[r])]
        x, y = np.array(pixels, dtype=np.int64).reshape(-1, 2).T
        nodes = mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]
        kind = int(mesh.types[e])
        local = local_points(kind, mesh.nodes[nodes], np.column_stack([x, y]).astype(float))
        place = (y - f.window.y0, x - f.window.x0)
        gradient = np.stack([by[place] for by in f.slopes], axis=1).astype(float)
        out.append(CellPixels(x, y, shape_functions(kind, local), nodes, f.values[place].astype(float), gradient))
    return out
