"""The mesh partition and the sub-images over the reference image (Fig. 8 of [BP17])."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ddic.io.plots.canvas import find_mesh_bounds, make_cell_polygons, make_image_figure
from ddic.io.plots.preview import Preview
from ddic.io.result_reader import Result

# Without its grey, which is lost on the image.
PALETTE = np.delete(colormaps["tab10"](np.arange(10)), 7, axis=0)

MARGIN = 0.1
"""Around the mesh, relative to its longer side."""


def draw_partition(result: Result, image: Preview | None = None) -> Figure:
    """Draw subdomains in colour with the bounding box of each (its sub-image without halo).

    Parameters
    ----------
    result : Result
        With its partition.
    image : Preview, optional
        Drawn below.

    Returns
    -------
    Figure
        The page.
    """
    mesh = result.mesh
    bounds = find_mesh_bounds(mesh.nodes, MARGIN)
    if image is not None:
        bounds = _clip(bounds, image)
    title = f"Partition: {mesh.n_cells} cells, {result.n_subdomains} subdomains"
    figure, axes = make_image_figure(bounds, title)
    if image is not None:
        image.draw(axes)
        # Drawing an image moves the limits to its own.
        x0, y0, x1, y1 = bounds
        axes.set_xlim(x0, x1)
        axes.set_ylim(y1, y0)
    colours = PALETTE[result.subdomain_ids % len(PALETTE)]
    cells = make_cell_polygons(mesh, mesh.nodes, facecolors=colours, edgecolors="black", linewidths=0.15, alpha=0.45)
    axes.add_collection(cells)
    for subdomain in np.unique(result.subdomain_ids):
        axes.add_patch(_draw_box(result, int(subdomain)))
    return figure


def _clip(bounds: tuple[float, float, float, float], image: Preview) -> tuple[float, float, float, float]:
    """The part of a box that lies in an image, whose pixels reach half a pixel beyond their centres."""
    x0, y0, x1, y1 = bounds
    return max(x0, -0.5), max(y0, -0.5), min(x1, image.width - 0.5), min(y1, image.height - 0.5)


def _draw_box(result: Result, subdomain: int) -> Rectangle:
    """The bounding box of a subdomain's cells."""
    cells = result.mesh.cells[result.subdomain_ids == subdomain]
    corners = result.mesh.nodes[cells[cells >= 0]]
    x0, y0 = corners.min(axis=0)
    x1, y1 = corners.max(axis=0)
    colour = PALETTE[subdomain % len(PALETTE)]
    return Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=colour, linewidth=1.6, linestyle="--")
