"""Displacement on both sides of a line at pixels beside it, and which side each pixel belongs to by its residual."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.interpolation import evaluate_shapes_at
from ddic.mesh.plane import multiply_across

Array = NDArray[np.float64]

HALO = 30
"""Pixels about a window after which a cubic spline's coefficients are those of the whole image."""


def evaluate_both_sides(cut: CutMesh, displacement: Array, line: Array, points: Array) -> tuple[Array, Array]:
    """Evaluate the displacement of the sides of a straight line, each also beyond the line.

    Parameters
    ----------
    cut : CutMesh
        A mesh that the line cuts.
    displacement : (n_nodes, 2) array
        Of its nodes, pixels.
    line : (2, 2) array
        Pixels.
    points : (n, 2) array
        Pixels near the line.

    Returns
    -------
    left, right : (n, 2) array
        By the shape functions of the nearest cut cell, pixels; left is where the cross product with the line's
        direction is positive.

    Raises
    ------
    ValueError
        Where no line cuts the mesh.
    """
    mesh = cut.mesh
    if mesh.parts is None:
        raise ValueError("no line cuts the mesh")
    numbers = mesh.parts.cells
    heights = multiply_across(line[1] - line[0], mesh.centroids[numbers] - line[0])
    n_parts = np.bincount(cut.cell_of[numbers], minlength=int(cut.cell_of.max()) + 1)
    # Cell by cell, the part to the right first.
    order = np.lexsort((heights, cut.cell_of[numbers]))
    right, left = numbers[order[n_parts[cut.cell_of[numbers[order]]] == 2]].reshape(-1, 2).T
    nearest = cKDTree((mesh.centroids[left] + mesh.centroids[right]) / 2).query(points)[1]
    u_left, u_right = (_interpolate(cut, displacement, cells[nearest], points) for cells in (left, right))
    return u_left, u_right


def _interpolate(cut: CutMesh, displacement: Array, cells: NDArray[np.int64], points: Array) -> Array:
    shapes = evaluate_shapes_at(cut.mesh, cells, points)
    of_cells = displacement[np.maximum(cut.mesh.cells[cells], 0)]
    return np.asarray(np.einsum("na,nac->nc", shapes[:, :of_cells.shape[1]], of_cells))


def compute_residuals(reference: MaskedSource, deformed: MaskedSource, pixels: NDArray[np.int64],
                      displacement: Array) -> Array:
    """Compute f(x) - g(x + u) at pixels.

    Parameters
    ----------
    reference, deformed : MaskedSource
        The images.
    pixels : (n, 2) array of int64
        Columns and rows.
    displacement : (n, 2) array
        There, pixels.

    Returns
    -------
    (n,) array
        Grey levels; nan where a pixel is masked or is displaced out of the image.
    """
    low, high = pixels.min(axis=0), pixels.max(axis=0) + 1
    window = Window(int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    f = reference.image.read(window).astype(np.float64)[pixels[:, 1] - window.y0, pixels[:, 0] - window.x0]
    usable = reference.find_usable(window)
    if usable is not None:
        f = np.where(usable[pixels[:, 1] - window.y0, pixels[:, 0] - window.x0], f, np.nan)
    at = pixels + displacement
    extent = deformed.extent
    is_inside = ((at >= 0) & (at <= (extent.width - 1, extent.height - 1))).all(axis=1)
    if not is_inside.any():
        return np.full(len(pixels), np.nan)
    low, high = np.floor(at[is_inside].min(axis=0)), np.ceil(at[is_inside].max(axis=0)) + 1
    seen = Window(int(low[0]), int(low[1]), int(high[0]), int(high[1])).grow(HALO).clip(extent.x1, extent.y1)
    g_values = deformed.image.read(seen).astype(np.float64)
    g = ndimage.map_coordinates(g_values, (at - (seen.x0, seen.y0))[:, ::-1].T, order=3, mode="mirror")
    return np.where(is_inside, f - g, np.nan)
