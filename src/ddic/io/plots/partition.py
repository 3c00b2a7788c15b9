"""The mesh partition and the sub-images over the reference image (Fig. 8 of [BP17])."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ddic.io.plots.canvas import cell_polygons, image_figure, mesh_bounds
from ddic.io.plots.preview import Preview
from ddic.io.result_reader import Result

PALETTE, N_COLOURS = "tab20", 20


def partition_figure(result: Result, image: Preview | None = None) -> Figure:
    """Subdomains in colour with the bounding box of each (its sub-image without halo), over the image."""
    mesh = result.mesh
    bounds = mesh_bounds(mesh.nodes) if image is None else (-0.5, -0.5, image.width - 0.5, image.height - 0.5)
    cells = f"{mesh.n_cells} cells, {result.n_subdomains} subdomains"
    figure, axes = image_figure(bounds, f"Partition and sub-images: {cells}")
    if image is not None:
        image.draw(axes)
    palette = np.asarray(colormaps[PALETTE](np.arange(N_COLOURS)))
    # Neighbours in number are often neighbours on the mesh: a stride sets their colours apart.
    colours = palette[(7 * result.subdomain_ids) % N_COLOURS]
    axes.add_collection(cell_polygons(mesh, mesh.nodes, facecolors=colours, edgecolors="black",
                                      linewidths=0.15, alpha=0.45))
    for subdomain in np.unique(result.subdomain_ids):
        members = np.flatnonzero(result.subdomain_ids == subdomain)
        nodes = mesh.cells[members]
        corners = mesh.nodes[nodes[nodes >= 0]]
        low, high = corners.min(axis=0), corners.max(axis=0)
        colour = palette[(7 * subdomain) % N_COLOURS]
        axes.add_patch(Rectangle((low[0], low[1]), *(high - low), fill=False, edgecolor=colour, linewidth=1.6,
                                 linestyle="--"))
    return figure
