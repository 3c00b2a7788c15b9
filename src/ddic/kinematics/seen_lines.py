"""Discontinuities as a camera sees them: near the cells that it measures, since elsewhere its mapping may not hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.images.camera import CameraMapping
from ddic.kinematics.discontinuities import Discontinuities, Opening
from ddic.mesh.cell_parts import CellParts, Lines
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree, find_runs, subdivide

Array = NDArray[np.float64]

REACH = 2.0
"""Distance from a mesh's nodes, in diameters of its largest cell, up to which a camera sees a line. Within one diameter
are the cells, and pixels beside a line that do not count are to be found there whole."""

LONGEST = 8.0
"""Pixels of the specimen between vertices of a line that a camera sees: its mapping bends little over so many. The same
whatever the partition."""


def see_parts(parts: CellParts, mesh: Mesh, mapping: CameraMapping) -> CellParts:
    """Map parts of cut cells into a camera's pixels.

    Parameters
    ----------
    parts : CellParts
        Of the mesh, specimen's frame.
    mesh : Mesh
        The cells that the camera measures, specimen's frame.
    mapping : CameraMapping
        Of the camera.

    Returns
    -------
    CellParts
        The same parts, the camera's pixels; edges stay straight.
    """
    polylines = [piece for line in parts.lines.polylines for piece in _see_line(line, mesh, mapping)]
    # What a bend cuts off lies in one cell.
    near = [bend for bend in parts.lines.bends if _is_near(bend, mesh).all()]
    bends = tuple(mapping.to_image(bend) for bend in near)
    return replace(parts, corners=mapping.to_image(parts.corners), lines=Lines(tuple(polylines), bends))


def see_discontinuities(discontinuities: Discontinuities, mesh: Mesh, mapping: CameraMapping) -> Discontinuities:
    """Map lines into a camera's pixels.

    Parameters
    ----------
    discontinuities : Discontinuities
        Specimen's frame.
    mesh : Mesh
        The cells that the camera measures, specimen's frame.
    mapping : CameraMapping
        Of the camera.

    Returns
    -------
    Discontinuities
        Those pieces of the lines that the camera sees, its pixels.
    """
    lines: list[Array] = []
    openings: list[Opening] = []
    for line, opening in zip(discontinuities.lines, discontinuities.openings, strict=True):
        pieces = _see_line(line, mesh, mapping)
        lines += pieces
        openings += [opening] * len(pieces)
    return Discontinuities(tuple(lines), tuple(openings))


def _see_line(line: Array, mesh: Mesh, mapping: CameraMapping) -> list[Array]:
    """Pieces of a line near a mesh, the camera's pixels: as straight within a cell as the cells' edges are."""
    vertices = subdivide(line, LONGEST)
    return [mapping.to_image(vertices[run]) for run in find_runs(_is_near(vertices, mesh))]


def _is_near(points: Array, mesh: Mesh) -> NDArray[np.bool_]:
    """Whether points lie in a mesh or not far beyond its edge."""
    corners = mesh.nodes[mesh.connectivity]
    sizes = np.maximum.reduceat(corners, mesh.offsets[:-1]) - np.minimum.reduceat(corners, mesh.offsets[:-1])
    diameter = float(np.linalg.norm(sizes, axis=1).max())
    distances, _ = build_tree(mesh.nodes).query(points)
    return np.asarray(distances <= REACH * diameter)
