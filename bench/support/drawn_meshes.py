"""Meshes drawn where their nodes have moved to, amplified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from ddic.io.result_reader import Result
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


def split_by_subdomain(result: Result, u: Array) -> list[MovedMesh]:
    """Cut a field, (n_nodes, 2), into those of its subdomains."""
    numbers = np.unique(result.subdomain_ids)
    cut = (result.mesh.create_submesh(np.flatnonzero(result.subdomain_ids == s)) for s in numbers)
    return [MovedMesh(mesh, u[nodes]) for mesh, nodes in cut]


def read_independent_fields(result: Result) -> list[MovedMesh]:
    """Read what each subdomain measured by itself: copies of a node differ, so that each piece of the file counts."""
    with h5py.File(result.path) as file:
        group = file["VTKHDF"]
        points, cells = (np.cumsum(group[name][:])[:-1] for name in ("NumberOfPoints", "NumberOfCells"))
        node_ids = np.split(group["PointData/GlobalNodeId"][:], points)
        fields = np.split(group["PointData/independent_displacement"][:, :2], points)
        numbers = [ids[0] for ids in np.split(group["CellData/SubdomainId"][:], cells)]
    found = []
    for s in np.unique(result.subdomain_ids):
        mesh, nodes = result.mesh.create_submesh(np.flatnonzero(result.subdomain_ids == s))
        piece = numbers.index(s)
        order = np.argsort(node_ids[piece])
        found.append(MovedMesh(mesh, fields[piece][order[np.searchsorted(node_ids[piece][order], nodes)]]))
    return found


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
