"""What the figures share: axes in image coordinates, colour bars, saving."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh

Component = Literal["x", "y", "magnitude"]
COMPONENTS: tuple[Component, ...] = ("x", "y", "magnitude")
COLOURS = "viridis"

DPI = 150
"""Dots an inch of a saved page; a larger value gives larger files."""

WIDTH_INCHES = 7.0
"""Width of a page."""

NARROWEST_INCHES = 4.5
"""Least width of a page; a larger value leaves more room beside tall meshes."""

TALLEST_INCHES = 9.0
"""Most height of the axes."""

LOWEST_INCHES = 2.0
"""Least height of the axes."""

TITLE_INCHES = 0.6
"""Height of what stands above and below the axes."""

COLOUR_BAR_INCHES = 2.0
"""Width of labels and the colour bar beside the axes."""


def make_image_figure(bounds: tuple[float, float, float, float], title: str) -> tuple[Figure, Axes]:
    """Make a figure whose axes are those of the image: pixels, equal scales, y down.

    Parameters
    ----------
    bounds : (float, float, float, float)
        x0, y0, x1, y1, pixels.
    title : str
        Above the axes.

    Returns
    -------
    figure : Figure
        The page.
    axes : Axes
        Empty axes.
    """
    x0, y0, x1, y1 = bounds
    ratio = (y1 - y0) / max(x1 - x0, 1e-12)
    height = float(np.clip(WIDTH_INCHES * ratio, LOWEST_INCHES, TALLEST_INCHES))
    width = WIDTH_INCHES
    if ratio > 0:
        # A tall mesh gets a narrow page, with room for labels and the colour bar.
        width_of_axes = height / ratio
        width = float(np.clip(width_of_axes + COLOUR_BAR_INCHES, NARROWEST_INCHES, WIDTH_INCHES))
    figure = Figure(figsize=(width, height + TITLE_INCHES), layout="tight")
    axes = figure.add_subplot()
    axes.set_xlim(x0, x1)
    axes.set_ylim(y1, y0)
    axes.set_aspect("equal")
    axes.set_xlabel("x [px]")
    axes.set_ylabel("y [px]")
    axes.set_title(title)
    return figure, axes


def find_mesh_bounds(nodes: NDArray[np.float64], margin: float = 0.03) -> tuple[float, float, float, float]:
    """Find the box around nodes.

    Parameters
    ----------
    nodes : (n, 2) array
        Pixels.
    margin : float, optional
        Relative to the box's longer side.

    Returns
    -------
    (float, float, float, float)
        x0, y0, x1, y1, pixels.
    """
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    gap = margin * float((high - low).max())
    x0, y0 = low - gap
    x1, y1 = high + gap
    return float(x0), float(y0), float(x1), float(y1)


def add_colour_bar(figure: Figure, axes: Axes, mappable: Any, label: str) -> None:
    """Add a labelled colour bar as high as the axes.

    Parameters
    ----------
    figure : Figure
        The page.
    axes : Axes
        Beside which it stands.
    mappable : object
        What is in colour.
    label : str
        With its unit.
    """
    # x, y, width, height, of the axes'.
    beside = axes.inset_axes((1.02, 0.0, 0.03, 1.0))
    figure.colorbar(mappable, cax=beside, label=label)


def make_cell_polygons(mesh: Mesh, nodes: NDArray[np.float64], **style: Any) -> PolyCollection:
    """Make polygons of the cells.

    Parameters
    ----------
    mesh : Mesh
        The cells.
    nodes : (n_nodes, 2) array
        Where they are drawn, pixels.
    **style : object
        As matplotlib's collections take it.

    Returns
    -------
    PolyCollection
        A polygon a cell.
    """
    nodes_of_cells = np.split(mesh.connectivity, mesh.offsets[1:-1])
    corners = [nodes[of_cell] for of_cell in nodes_of_cells]
    return PolyCollection(corners, **style)


def make_triangulation(mesh: Mesh, nodes: NDArray[np.float64]) -> Triangulation:
    """Cut the cells into triangles.

    Parameters
    ----------
    mesh : Mesh
        The cells.
    nodes : (n_nodes, 2) array
        Where they are drawn, pixels.

    Returns
    -------
    Triangulation
        On all nodes.
    """
    triangles = [block.nodes[:, corners] for block in mesh.cell_blocks for corners in block.type.triangles]
    return Triangulation(nodes[:, 0], nodes[:, 1], np.concatenate(triangles))


def pick_component(vectors: NDArray[np.float64], component: Component) -> NDArray[np.float64]:
    """Pick one component of vectors, or their length.

    Parameters
    ----------
    vectors : (n, 2) array
        Of any unit.
    component : {"x", "y", "magnitude"}
        Which.

    Returns
    -------
    (n,) array
        Of the same unit.
    """
    if component == "magnitude":
        return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))
    axis = 0 if component == "x" else 1
    return vectors[:, axis]


def format_component(symbol: str, component: Component) -> str:
    """Write a component of a vector as a label does.

    Parameters
    ----------
    symbol : str
        Of the vector.
    component : {"x", "y", "magnitude"}
        Which.

    Returns
    -------
    str
        TeX.
    """
    return f"$|{symbol}|$" if component == "magnitude" else f"${symbol}_{component}$"


def save_figure(figure: Figure, path: Path) -> None:
    """Save a figure.

    Parameters
    ----------
    figure : Figure
        The page.
    path : Path
        Whose ending tells the format.
    """
    figure.savefig(path, dpi=DPI)
