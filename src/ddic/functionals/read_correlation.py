"""From meshes and a reference image to subdomains with their pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.functionals.correlation import Correlation
from ddic.functionals.line_band import find_band_pixels
from ddic.images.spline import HALO, PADDING, GradientImage
from ddic.images.sub_image import MaskedSource, read_reference
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.window import merge_windows
from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import Raster, rasterize

VISITED_ROWS = 32
"""Height, pixels, of the bands in which cells are visited: of 16-px cells two rows. With a larger one, neighbours in a
row are further apart in time and share fewer lines of the cache; with a smaller one, those of a column do."""


def read_correlation(mesh: Mesh, reference: MaskedSource, degree: int) -> Correlation:
    """Rasterise a subdomain's mesh and read its window of the reference image.

    Parameters
    ----------
    mesh : Mesh
        In the image's pixels.
    reference : MaskedSource
        The reference image.
    degree : int
        Of the spline, 3 or 5.

    Returns
    -------
    Correlation
        Of the subdomain.

    Raises
    ------
    InputError
        Where a pixel of the mesh lies outside the image.
    """
    return read_correlations([mesh], reference, degree)[0][0]


def read_correlations(meshes: Sequence[Mesh], reference: MaskedSource, degree: int,
                      threads: Threads = ONE_THREAD) -> list[list[Correlation]]:
    """Rasterise several subdomains' meshes and read their windows of the reference image.

    Neighbours share a window where it holds fewer pixels than their own ones, whose edges and halos overlap.

    Parameters
    ----------
    meshes : sequence of Mesh
        In the image's pixels.
    reference : MaskedSource
        The reference image.
    degree : int
        Of the spline, 3 or 5.
    threads : Threads
        Of all that is done with the subdomains' pixels.

    Returns
    -------
    list of lists of Correlation
        Groups, in the meshes' order, that share a window of the image.

    Raises
    ------
    InputError
        Where a pixel of a mesh lies outside the image.
    """
    rasters = [rasterize(mesh) for mesh in meshes]
    windows = [raster.window for raster in rasters]
    extent = reference.extent
    if not all(extent.contains(window) for window in windows):
        raise InputError(f"{reference.image.path}: pixels of the mesh lie outside the image "
                         f"({extent.width} x {extent.height} px); move or cut the mesh")
    groups: list[list[Correlation]] = []
    for common, members in merge_windows(windows, HALO[degree] + PADDING[degree]):
        image = read_reference(reference, common, degree, threads)
        groups.append([])
        for k in members:
            own = _without_band(meshes[k], rasters[k], image.restrict(windows[k]), degree)
            groups[-1].append(_build_correlation(meshes[k], rasters[k], own, reference, threads))
    return groups


def restrict_to_cells(whole: Correlation, cells: NDArray[np.int64]) -> Correlation:
    """Take some of a subdomain's cells alone, with the same window of the image.

    Parameters
    ----------
    whole : Correlation
        The subdomain.
    cells : (n,) int64 array
        Their numbers.

    Returns
    -------
    Correlation
        Of these cells.
    """
    mesh, _ = whole.mesh.create_submesh(cells)
    return _build_correlation(mesh, rasterize(mesh), whole.reference, whole.source, whole.threads)


def _build_correlation(mesh: Mesh, raster: Raster, image: GradientImage, source: MaskedSource,
                       threads: Threads) -> Correlation:
    """A subdomain whose cells are visited in bands of rows."""
    x, y = mesh.centroids.T
    order = np.lexsort((x, y // VISITED_ROWS)).astype(np.int64)
    return Correlation(mesh, interpolate_cells(mesh), raster, image, source, order, threads)


def _without_band(mesh: Mesh, raster: Raster, image: GradientImage, degree: int) -> GradientImage:
    """The window of the reference image with the pixels near a discontinuity left out."""
    pixels, _ = find_band_pixels(mesh, raster, degree)
    if not len(pixels):
        return image
    near = np.zeros(image.values.shape, dtype=bool)
    near[pixels[:, 1] - image.window.y0, pixels[:, 0] - image.window.x0] = True
    return image.exclude(near)
