"""A mesh over the reference image, before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.io.plots.canvas import (
    MOST_SHARP_CELLS,
    find_mesh_bounds,
    make_cell_polygons,
    make_image_figure,
    set_bounds,
)
from ddic.io.plots.partition import PALETTE
from ddic.io.plots.preview import Preview
from ddic.mesh.mesh import Mesh

MARGIN = 0.1
"""Around the mesh, relative to its longer side."""

MOST_NAMED = 12
"""Node sets that the legend names; a larger value fills the page."""

MARKERS = "osD^v<>"


LONGEST_NAME = 12
"""Characters of a node set's name; a larger value needs more room beside the axes."""


def draw_mesh_preview(mesh: Mesh, image: Preview, lines: Sequence[NDArray[np.float64]] = ()) -> Figure:
    """Draw a mesh, its node sets and the lines that cut it over the reference image.

    Parameters
    ----------
    mesh : Mesh
        Pixels.
    image : Preview
        Drawn below.
    lines : sequence of (n_vertices, 2) array, optional
        Discontinuities, pixels.

    Returns
    -------
    Figure
        The page.
    """
    bounds = image.clip(find_mesh_bounds(mesh.nodes, MARGIN))
    sets = {name: nodes for name, nodes in mesh.node_sets.items() if len(nodes)}
    figure, axes = make_image_figure(bounds, f"Mesh: {mesh.n_nodes} nodes, {mesh.n_cells} cells")
    image.draw(axes)
    set_bounds(axes, bounds)
    axes.add_collection(make_cell_polygons(mesh, mesh.nodes, facecolors=(0.337, 0.706, 0.914, 0.25),
                                           edgecolors=tuple(PALETTE[4]), linewidths=0.4,
                                           rasterized=mesh.n_cells > MOST_SHARP_CELLS))
    for k, (name, nodes) in enumerate(list(sets.items())[:MOST_NAMED]):
        axes.plot(*mesh.nodes[nodes].T, MARKERS[k % len(MARKERS)], color=PALETTE[k % len(PALETTE)], markersize=3.5,
                  markeredgecolor="black", markeredgewidth=0.3, label=f"{_shorten(name)} ({len(nodes)})")
    for k, line in enumerate(lines, start=1):
        axes.plot(*line.T, "-", color="red", linewidth=1.5, label=f"line {k}")
    if sets or len(lines):
        # Beside the axes, where other figures have their colour bar.
        axes.legend(fontsize="xx-small", loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0,
                    handletextpad=0.2, borderpad=0.3)
    return figure


def _shorten(name: str) -> str:
    """A name as far as there is room for it."""
    return name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME - 1]}…"
