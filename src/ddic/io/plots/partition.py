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
        bounds = (max(bounds[0], -0.5), max(bounds[1], -0.5),
                  min(bounds[2], image.width - 0.5), min(bounds[3], image.height - 0.5))
    sizes = f"{mesh.n_cells} cells, {result.n_subdomains} subdomains"
    figure, axes = make_image_figure(bounds, f"Partition: {sizes}")
    if image is not None:
        image.draw(axes)
        # Drawing an image moves the limits to its own.
        axes.set_xlim(bounds[0], bounds[2])
        axes.set_ylim(bounds[3], bounds[1])
    colours = PALETTE[result.subdomain_ids % len(PALETTE)]
    axes.add_collection(make_cell_polygons(mesh, mesh.nodes, facecolors=colours, edgecolors="black",
                                           linewidths=0.15, alpha=0.45))
    for subdomain in np.unique(result.subdomain_ids):
        members = np.flatnonzero(result.subdomain_ids == subdomain)
        nodes = mesh.cells[members]
        corners = mesh.nodes[nodes[nodes >= 0]]
        low, high = corners.min(axis=0), corners.max(axis=0)
        colour = PALETTE[subdomain % len(PALETTE)]
        axes.add_patch(Rectangle((low[0], low[1]), *(high - low), fill=False, edgecolor=colour, linewidth=1.6,
                                 linestyle="--"))
    return figure
