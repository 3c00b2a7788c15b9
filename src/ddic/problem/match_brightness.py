"""Where the light changes from cell to cell, the reference image is given the same change of brightness.

A gain and an offset of each cell leave the slope of the light inside it, which Gauss-Newton takes for a displacement.
The light is continuous: offsets of cells, averaged at nodes and interpolated between them, tell its slope.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.view import FrameView
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import list_pixels
from ddic.parallel.node_sums import sum_shared_nodes
from ddic.problem.residual_model import ResidualModel
from ddic.problem.seen_cells import SeenCells, TypicalCell

Array = NDArray[np.float64]

SEEN = 0.9
"""Correlation coefficient of f and g in a cell, relative to what contrast and noise let expect, from which on its
offset is that of the light: what lies in front of the specimen is dark or bright, too. A larger value leaves out cells
in which the light changes much."""

LEAST_SLOPE = 0.25
"""Difference of brightness between nodes of a cell, relative to the standard deviation of the residual, from which on
the cell is given a slope. A smaller value spends time on what is less than noise."""


def match_brightness(whole: ResidualModel, seen: Sequence[Sequence[SeenCells]],
                     typical: Mapping[int, TypicalCell]) -> ResidualModel:
    """Give the reference images the slopes of the light in a frame; collective.

    Parameters
    ----------
    whole : ResidualModel
        Of all pixels that the frame shows.
    seen : sequence of sequence of SeenCells
        Cells of each owned subdomain and view.
    typical : mapping of int to TypicalCell
        What most cells are like, by camera.

    Returns
    -------
    ResidualModel
        With other grey levels of the reference images.
    """
    subdomains = [of_subdomain.subdomain for of_subdomain in whole.views]
    by_camera = [{view.camera: cells for view, cells in zip(of_subdomain.views, of_views, strict=True)}
                 for of_subdomain, of_views in zip(whole.views, seen, strict=True)]
    sums = [_sum_offsets(subdomain.mesh, whole.n_cameras, cells, typical)
            for subdomain, cells in zip(subdomains, by_camera, strict=True)]
    totals = sum_shared_nodes(whole.team, subdomains, sums)

    def even() -> list[tuple[FrameView, ...]]:
        return [tuple(_even_out(view, total, typical[view.camera]) for view in of_subdomain.views)
                for of_subdomain, total in zip(whole.views, totals, strict=True)]

    views = whole.team.together(even)
    return replace(whole, views=[replace(of_subdomain, views=evened)
                                 for of_subdomain, evened in zip(whole.views, views, strict=True)])


def _sum_offsets(mesh: Mesh, n_cameras: int, seen: Mapping[int, SeenCells],
                 typical: Mapping[int, TypicalCell]) -> Array:
    """Pixels of the cells about each node, and the sum of their offsets, (n_nodes, 2 n_cameras), by camera."""
    sums = np.zeros((mesh.n_nodes, 2 * n_cameras))
    n_corners = np.diff(mesh.offsets)
    for camera, cells in seen.items():
        of_most = typical[camera]
        expected = of_most.contrast / max(of_most.contrast + of_most.noise, 1e-300)
        n_pixels = np.where(cells.coefficient >= SEEN * expected, cells.n_pixels, 0.0)
        offsets = cells.mean_f - of_most.gain * cells.mean_g - of_most.offset
        for column, of_cells in ((2 * camera, n_pixels), (2 * camera + 1, n_pixels * offsets)):
            sums[:, column] = np.bincount(mesh.connectivity, np.repeat(of_cells, n_corners), minlength=mesh.n_nodes)
    return sums


def _even_out(view: FrameView, sums: Array, typical: TypicalCell) -> FrameView:
    """A view whose f has the light of g."""
    correlation, place = view.view.correlation, 2 * view.camera
    n_pixels, total = sums[:, place], sums[:, place + 1]
    light = total / np.maximum(n_pixels, 1.0)
    mesh = correlation.mesh
    of_corners = light[mesh.connectivity]
    first = mesh.offsets[:-1]
    differences = np.maximum.reduceat(of_corners, first) - np.minimum.reduceat(of_corners, first)
    # Where a node is known by no cell, all of its cells are hidden.
    is_known = np.logical_and.reduceat(n_pixels[mesh.connectivity] > 0, first)
    sloping = np.flatnonzero(is_known & (differences > LEAST_SLOPE * np.sqrt(typical.noise)))
    if not len(sloping):
        return view
    image = correlation.reference
    removed = np.zeros(image.values.shape, dtype=np.float32)
    pixels, cells = list_pixels(correlation.raster, sloping)
    located = place_in_cells(mesh, cells, pixels.astype(np.float64))
    at_pixels = interpolate_located(mesh, light[:, None], located)[:, 0]
    removed[pixels[:, 1] - image.window.y0, pixels[:, 0] - image.window.x0] = at_pixels
    evened = replace(correlation, reference=image.correct_light(removed))
    return replace(view, view=replace(view.view, correlation=evened))
