"""Displacement on both sides of a line at pixels beside it, and which side each pixel belongs to by its residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.plane import build_tree, find_nearest_segments, multiply_across
from ddic.start.independent import Images

Array = NDArray[np.float64]

FEWEST_FITTED = 100
"""Pixels below which grey levels are not corrected."""

HALO = 30
"""Pixels about a window after which a cubic spline's coefficients are those of the whole image."""


def evaluate_both_sides(cut: CutMesh, displacement: Array, line: Array, points: Array,
                        others: Sequence[Array] = ()) -> tuple[Array, Array]:
    """Evaluate the displacement of the sides of a line, each also beyond the line.

    Parameters
    ----------
    cut : CutMesh
        A mesh that the line cuts, perhaps among others.
    displacement : (n_nodes, 2) array
        Of its nodes, pixels.
    line : (n_vertices, 2) array
        Pixels.
    points : (n, 2) array
        Pixels near the line.
    others : sequence of (n_vertices, 2) array
        Other lines, pixels.

    Returns
    -------
    left, right : (n, 2) array
        By the shape functions of the nearest cell that this line alone cuts, pixels; nan where another line lies
        between; left is where the cross product
        with the line's direction is positive.

    Raises
    ------
    ValueError
        Where the line cuts no cell.
    """
    mesh = cut.mesh
    numbers = np.zeros(0, np.int64) if mesh.parts is None else mesh.parts.cells
    n_parts = np.bincount(cut.cell_of[numbers], minlength=int(cut.cell_of.max()) + 1)
    numbers = numbers[n_parts[cut.cell_of[numbers]] == 2]
    centres = mesh.centroids[numbers]
    heights = measure_heights(centres, line)
    # Cell by cell, the part to the right first.
    order = np.lexsort((heights, cut.cell_of[numbers]))
    pairs, low, high = numbers[order].reshape(-1, 2), heights[order][::2], heights[order][1::2]
    # Of cells that another line cuts, both parts lie on one side of this one, or farther from it.
    is_own = (low < 0) & (high > 0)
    if not is_own.any():
        raise ValueError("the line cuts no cell of the mesh")
    right, left = pairs[is_own].T
    middles = centres[order].reshape(-1, 2, 2).mean(axis=1)[is_own]
    nearest = build_tree(middles).query(points)[1]
    u_left, u_right = (interpolate_located(mesh, displacement, place_in_cells(mesh, cells[nearest], points))
                       for cells in (left, right))
    for other in others:
        is_beyond = measure_heights(points, other) * measure_heights(middles, other)[nearest] <= 0
        u_left[is_beyond] = u_right[is_beyond] = np.nan
    return u_left, u_right


def measure_heights(points: Array, line: Array) -> Array:
    """Measure how far points lie to the left of the nearest segment of a polyline, (n,), pixels."""
    segments, _ = find_nearest_segments(points, line)
    along = np.diff(line, axis=0)[segments]
    return np.asarray(multiply_across(along, points - line[segments]) / np.linalg.norm(along, axis=1))


def compute_residuals(images: Images, pixels: NDArray[np.int64], displacement: Array,
                      own: NDArray[np.bool_] | None = None) -> Array:
    """Compute f(x) - a g(x + u) - b at pixels, with one gain and offset where the images' grey levels are corrected.

    Parameters
    ----------
    images : Images
        The pair.
    pixels : (n, 2) array of int64
        Columns and rows.
    displacement : (n, 2) array
        There, pixels.
    own : (n,) array of bool, optional
        Pixels that the displacement belongs to, by which gain and offset are found; all by default.

    Returns
    -------
    (n,) array
        Grey levels; nan where a pixel is left out of an image, or is displaced out of it.
    """
    f, g = _evaluate_images(images.reference, images.deformed, pixels, displacement)
    fitted = np.isfinite(f - g) & (True if own is None else own)
    if images.correction == "none" or fitted.sum() < FEWEST_FITTED:
        return f - g
    gain, offset = np.polyfit(g[fitted], f[fitted], 1)
    return np.asarray(f - gain * g - offset)


def _evaluate_images(reference: MaskedSource, deformed: MaskedSource, pixels: NDArray[np.int64],
                     displacement: Array) -> tuple[Array, Array]:
    """f(x) and g(x + u), nan where a pixel is left out."""
    if not len(pixels):
        return np.zeros(0), np.zeros(0)
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
        return f, np.full(len(pixels), np.nan)
    low, high = np.floor(at[is_inside].min(axis=0)), np.ceil(at[is_inside].max(axis=0)) + 1
    seen = Window(int(low[0]), int(low[1]), int(high[0]), int(high[1])).grow(HALO).clip(extent.x1, extent.y1)
    g_values = deformed.image.read(seen).astype(np.float64)
    g = ndimage.map_coordinates(g_values, (at - (seen.x0, seen.y0))[:, ::-1].T, order=3, mode="mirror")
    usable = deformed.find_usable(seen)
    if usable is not None:
        beside = np.rint(np.where(is_inside[:, None], at, at[is_inside][0])).astype(np.int64) - (seen.x0, seen.y0)
        shown = ndimage.minimum_filter(usable, size=3)
        is_inside = is_inside & (shown[beside[:, 1], beside[:, 0]] > 0)
    return f, np.where(is_inside, g, np.nan)
