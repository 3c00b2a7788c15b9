"""Pixel sums written out with numpy, pixel by pixel, as the reference of the compiled kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.functionals.correlation import Correlation
from ddic.mesh.cell_type import Q4


@dataclass(frozen=True)
class CellPixels:
    """Pixels of one cell.

    x, y: (n,); shapes: (n, nodes) values of the shape functions; nodes: (nodes,) node numbers;
    f, gradient: (n,), (n, 2) of the reference image; counts: (n,) whether f counts there.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    shapes: NDArray[np.float64]
    nodes: NDArray[np.int64]
    f: NDArray[np.float64]
    gradient: NDArray[np.float64]
    counts: NDArray[np.bool_]


@dataclass(frozen=True)
class SlowSums:
    """M (n_dofs, n_dofs), b (n_dofs,), grey sums by cell (n_cells, 6) and the residual by cell and pixel."""

    hessian: NDArray[np.float64]
    b: NDArray[np.float64]
    grey: NDArray[np.float64]
    residuals: list[NDArray[np.float64]]


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
    rows = raster.rows
    out = []
    for e in range(mesh.n_cells):
        runs = range(raster.row_ptr[e], raster.row_ptr[e + 1])
        pixels = [(x, int(rows[r])) for r in runs for x in range(raster.starts[r], raster.stops[r])]
        x, y = np.array(pixels, dtype=np.int64).reshape(-1, 2).T
        nodes = mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]
        kind = int(mesh.types[e])
        local = local_points(kind, mesh.nodes[nodes], np.column_stack([x, y]).astype(float))
        place = (y - f.window.y0, x - f.window.x0)
        gradient = np.stack([f.by_x[place], f.by_y[place]], axis=1).astype(float)
        counts = np.ones(len(x), dtype=bool) if f.usable is None else f.usable[place] > 0
        out.append(CellPixels(x, y, shape_functions(kind, local), nodes, f.values[place].astype(float), gradient,
                              counts))
    return out


def slow_sums(part: Correlation, deformed: NDArray[np.float64], degree: int, q: NDArray[np.float64],
              mask: NDArray[np.bool_] | None = None) -> SlowSums:
    """Sums over the pixels of a mesh; deformed: the whole image g; mask: where g counts."""
    u = q.reshape(-1, 2)
    height, width = deformed.shape
    hessian, b = np.zeros((len(q), len(q))), np.zeros(len(q))
    grey, residuals = [], []
    for cell in cell_pixels(part):
        dofs = (2 * cell.nodes[:, None] + np.arange(2)).ravel()
        # Row j of N . grad f of each pixel.
        slopes = (cell.shapes[:, :, None] * cell.gradient[:, None, :]).reshape(len(cell.x), -1)
        hessian[np.ix_(dofs, dofs)] += slopes[cell.counts].T @ slopes[cell.counts]
        px, py = (np.stack([cell.x, cell.y], axis=1) + cell.shapes @ u[cell.nodes]).T
        counts = cell.counts & (px >= 0) & (px <= width - 1) & (py >= 0) & (py <= height - 1)
        counts &= np.array([mask is None or _all_four_count(mask, a, c) for a, c in zip(px, py, strict=True)],
                           dtype=bool)
        g = ndimage.map_coordinates(deformed, [py, px], order=degree, mode="mirror")
        r = cell.f - g
        b[dofs] += slopes[counts].T @ r[counts]
        r_, g_ = r[counts], g[counts]
        grey.append([len(r_), r_.sum(), g_.sum(), (r_**2).sum(), (g_**2).sum(), (r_ * g_).sum()])
        residuals.append(np.where(counts, r, np.nan))
    return SlowSums(hessian, b, np.array(grey), residuals)


def _all_four_count(mask: NDArray[np.bool_], px: float, py: float) -> bool:
    """Whether the four pixels around a point count; beyond the image's last pixel there is none."""
    height, width = mask.shape
    x, y = min(max(int(np.floor(px)), 0), width - 1), min(max(int(np.floor(py)), 0), height - 1)
    return bool(mask[y: y + 2, x: x + 2].all())
