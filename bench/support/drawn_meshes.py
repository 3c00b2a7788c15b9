"""Meshes drawn where their nodes have moved to, amplified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from ddic.io.result_reader import Result, keep_cells
from ddic.mesh.mesh import Mesh

Array = NDArray[np.float64]

COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown")


@dataclass(frozen=True)
class MovedMesh:
    """A mesh and the displacement of its nodes, (n_nodes, 2), pixels."""

    mesh: Mesh
    u: Array

    def draw(self, axes: Axes, factor: float, **style: Any) -> None:
        """Draw its cells where the displacement, so many times as large, puts them."""
        at = self.mesh.nodes + factor * self.u
        axes.add_collection(PolyCollection([at[cell[cell >= 0]] for cell in self.mesh.cells], **style))

    def bounds(self, factor: float) -> Array:
        """Least and largest coordinates, (2, 2), of what is drawn."""
        at = self.mesh.nodes + factor * self.u
        return np.array([at.min(axis=0), at.max(axis=0)])


def split_by_subdomain(result: Result) -> list[MovedMesh]:
    """Cut a field into those of its subdomains."""
    parts = [keep_cells(result, np.flatnonzero(result.subdomain_ids == s)) for s in np.unique(result.subdomain_ids)]
    return [MovedMesh(part.mesh, part.displacement) for part in parts]


def draw_subdomains(axes: Axes, parts: Sequence[MovedMesh], factor: float, width: float) -> None:
    """Draw subdomains, neighbours mostly in different colours, with lines of a width, points."""
    for number, part in enumerate(parts):
        colour = COLOURS[number % len(COLOURS)]
        part.draw(axes, factor, facecolor=to_rgba(colour, 0.25), edgecolor=colour, linewidth=width)


def frame_parts(axes: Axes, parts: Sequence[MovedMesh], factor: float, margin: float) -> None:
    """Show all of some parts with a margin, pixels; y points down."""
    corners = np.array([part.bounds(factor) for part in parts])
    (x0, y0), (x1, y1) = corners[:, 0].min(axis=0) - margin, corners[:, 1].max(axis=0) + margin
    axes.set(xlim=(x0, x1), ylim=(y1, y0), aspect="equal")
