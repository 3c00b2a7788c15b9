"""A mesh, or its partition and sub-images (Fig. 8 of [BP17]), over the reference image, before anything is measured."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from scipy.sparse import csr_array

from ddic.arrays import Array, IntArray
from ddic.io.result_reader import Result
from ddic.mesh.mesh import Mesh
from ddic.plots import canvas
from ddic.plots.canvas import PIXELS, LengthUnit
from ddic.plots.maps import make_figure_over
from ddic.plots.slices import Below, Slice, Slices, make_views

PALETTE = np.array([[0.902, 0.624, 0.0], [0.337, 0.706, 0.914], [0.0, 0.620, 0.451], [0.941, 0.894, 0.259],
                    [0.0, 0.447, 0.698], [0.835, 0.369, 0.0], [0.800, 0.475, 0.655]])
"""Seven colours that are told apart whatever colours one sees: Okabe and Ito, Color Universal Design, 2008, without
black."""

MARGIN = 0.1
"""Around the mesh, relative to its longer side."""

MARGIN_INCHES = 0.3
"""Right of the axes, where other figures have a colour bar."""

SHARE_OF_NUMBER = 0.35
"""Height of a number relative to its subdomain's side."""

SMALLEST_POINTS, LARGEST_POINTS = 3.0, 12.0
"""Type of numbers; where they would be smaller, none are written."""


def draw_partition(result: Result, image: Below = None, unit: LengthUnit = PIXELS) -> Figure:
    """Draw numbered subdomains in colour with the bounding box of each (its sub-image without halo)."""
    mesh, nodes = result.mesh, unit.size * result.mesh.nodes
    plural = "" if result.n_subdomains == 1 else "s"
    title = f"Partition: {mesh.n_cells} cells, {result.n_subdomains} subdomain{plural}"
    if isinstance(image, tuple):
        return _draw_subdomains_on_slices(result, image, title, unit)
    figure, axes = make_figure_over(image, canvas.find_mesh_bounds(nodes, MARGIN), title, unit, MARGIN_INCHES)
    width, height = axes.get_position().size * figure.get_size_inches()
    chosen = choose_colours(mesh, result.subdomain_ids)
    colours = PALETTE[chosen[result.subdomain_ids]]
    polygons = canvas.make_cell_polygons(mesh, nodes, facecolors=colours, edgecolors="black", linewidths=0.15,
                                         alpha=0.5, rasterized=mesh.n_cells > canvas.MOST_SHARP_CELLS)
    axes.add_collection(polygons)
    for subdomain in np.unique(result.subdomain_ids).tolist():
        cells = np.flatnonzero(result.subdomain_ids == subdomain)
        of_cells = mesh.cells[cells]
        axes.add_patch(_draw_box(nodes[of_cells[of_cells >= 0]], PALETTE[chosen[subdomain]]))
        side = float(np.sqrt(width * height * len(cells) / mesh.n_cells))
        _write_number(axes, unit.size * mesh.centroids[cells], subdomain, side)
    return figure


def choose_colours(mesh: Mesh, subdomain_ids: IntArray) -> IntArray:
    """Choose colours unlike neighbours', if there are enough, by subdomain: rows of PALETTE, (largest + 1,)."""
    n = int(subdomain_ids.max()) + 1
    of_corners = np.repeat(subdomain_ids, np.diff(mesh.offsets))
    has_node = csr_array((np.ones(len(of_corners)), (of_corners, mesh.connectivity)), shape=(n, mesh.n_nodes))
    touching = (has_node @ has_node.T).tocsr()
    chosen = np.full(n, -1, dtype=np.int64)
    used = np.zeros(len(PALETTE), dtype=np.int64)
    for subdomain in range(n):
        beside = set(chosen[touching[[subdomain]].indices].tolist())
        free = [colour for colour in range(len(PALETTE)) if colour not in beside] or list(range(len(PALETTE)))
        # The least used of those that are free, so that all are.
        chosen[subdomain] = min(free, key=lambda colour: int(used[colour]))
        used[chosen[subdomain]] += 1
    return chosen


def _draw_subdomains_on_slices(result: Result, slices: Slices, title: str, unit: LengthUnit) -> Figure:
    """The same of a volume; boxes are those of what the slice shows."""
    figure, (views,) = make_views(slices, [title], unit, beside=MARGIN_INCHES)
    chosen = choose_colours(result.mesh, result.subdomain_ids)
    for axes, one in zip(views.axes, slices, strict=True):
        _paint_cells(axes, one, unit, PALETTE[chosen[result.subdomain_ids]], 0.5, (0.0, 0.0, 0.0, 0.6))
        shown, points = np.append(result.subdomain_ids, -1)[one.cells], unit.size * one.points
        inches = float(np.prod(axes.get_position().size * figure.get_size_inches()))
        for subdomain in np.unique(shown[shown >= 0]).tolist():
            of_patch = points[shown == subdomain]
            axes.add_patch(_draw_box(of_patch, PALETTE[chosen[subdomain]]))
            _write_number(axes, of_patch, subdomain, float(np.sqrt(inches * len(of_patch) / shown.size)))
    return figure


def _paint_cells(axes: Axes, one: Slice, unit: LengthUnit, colours: Array, opacity: float,
                 of_edges: tuple[float, ...]) -> None:
    """Show cells on a slice in colours (n_cells, 3), and their edges where there are not too many to be seen."""
    cells, edges = one.cells, one.edges
    painted = np.dstack([colours[cells], np.where(cells >= 0, opacity, 0.0)])
    if edges.mean() <= MOST_EDGES:
        painted[edges] = of_edges
    one.show(axes, painted, unit)


def _draw_box(corners: Array, colour: Array) -> Rectangle:
    """The bounding box of a subdomain's nodes."""
    x0, y0 = corners.min(axis=0)
    x1, y1 = corners.max(axis=0)
    return Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=colour, linewidth=1.6, linestyle="--")


def _write_number(axes: Axes, middles: Array, subdomain: int, side: float) -> None:
    """Write a subdomain's number on the cell that is nearest to the middle of all; side: about its own, inches."""
    x, y = middles[np.linalg.norm(middles - middles.mean(axis=0), axis=1).argmin()]
    size = SHARE_OF_NUMBER * canvas.POINTS_AN_INCH * side
    if size < SMALLEST_POINTS:
        return
    axes.text(x, y, str(subdomain), ha="center", va="center", fontsize=min(size, LARGEST_POINTS), fontweight="bold",
              path_effects=[withStroke(linewidth=2.0, foreground="white")])


FACE, FACE_OPACITY = PALETTE[1], 0.25
"""Of the cells of a mesh."""

MOST_EDGES = 0.3
"""Share of a slice's points at edges of cells up to which these are drawn; a larger value makes fine meshes black."""

MOST_NAMED = 12
"""Node sets that the legend names; a larger value fills the page."""

MARKERS = "osD^v<>"


LONGEST_NAME = 12
"""Characters of a node set's name; a larger value needs more room beside the axes."""


def draw_mesh_preview(mesh: Mesh, image: Below, lines: Sequence[Array] = ()) -> Figure:
    """Draw a mesh, its node sets and the lines (n_vertices, 2) that cut it, pixels, over the reference image."""
    title = f"Mesh: {mesh.n_nodes} nodes, {mesh.n_cells} cells"
    if isinstance(image, tuple):
        return _draw_mesh_on_slices(mesh, image, title)
    figure, axes = make_figure_over(image, canvas.find_mesh_bounds(mesh.nodes, MARGIN), title)
    cells = canvas.make_cell_polygons(mesh, mesh.nodes, facecolors=(*FACE, FACE_OPACITY),
                                      edgecolors=tuple(PALETTE[4]), linewidths=0.4,
                                      rasterized=mesh.n_cells > canvas.MOST_SHARP_CELLS)
    axes.add_collection(cells)
    _draw_node_sets(axes, mesh, mesh.nodes)
    for k, line in enumerate(lines, start=1):
        axes.plot(*line.T, "-", color="red", linewidth=1.5, label=f"line {k}")
    _name_what_is_drawn(axes)
    return figure


def _draw_mesh_on_slices(mesh: Mesh, slices: Slices, title: str) -> Figure:
    """The same of a volume; nodes of sets are those of the cells in a slice."""
    figure, (views,) = make_views(slices, [title])
    for axes, one in zip(views.axes, slices, strict=True):
        _paint_cells(axes, one, PIXELS, np.tile(FACE, (mesh.n_cells, 1)), FACE_OPACITY, (*PALETTE[4], 1.0))
        places, corners = np.full((mesh.n_nodes, 2), np.nan), mesh.cells[np.unique(one.cells[one.cells >= 0])]
        near = corners[corners >= 0]
        places[near] = mesh.nodes[near][:, one.columns]
        _draw_node_sets(axes, mesh, places)
    _name_what_is_drawn(views.axes[min(1, len(slices) - 1)])
    return figure


def _draw_node_sets(axes: Axes, mesh: Mesh, places: Array) -> None:
    """Marks of the node sets, whose nodes are drawn at (n_nodes, 2)."""
    sets = {name: nodes for name, nodes in mesh.node_sets.items() if len(nodes)}
    for k, (name, nodes) in enumerate(list(sets.items())[:MOST_NAMED]):
        axes.plot(*places[nodes].T, MARKERS[k % len(MARKERS)], color=PALETTE[k % len(PALETTE)], markersize=3.5,
                  markeredgecolor="black", markeredgewidth=0.3, label=f"{_shorten(name)} ({len(nodes)})")


def _name_what_is_drawn(axes: Axes) -> None:
    """A legend, where there is something to name."""
    if axes.get_legend_handles_labels()[1]:
        # Beside the axes, where other figures have their colour bar.
        axes.legend(fontsize="xx-small", loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0,
                    handletextpad=0.2, borderpad=0.3)


def _shorten(name: str) -> str:
    """A name as far as there is room for it."""
    return name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME - 1]}…"
