"""A displacement beyond where it is known: in equilibrium with what is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from ddic.functionals.elasticity import Material, assemble_stiffness
from ddic.mesh.mesh import Mesh
from ddic.solvers.local_operator import LocalOperator
from ddic.start.affine_map import AffineMap, fit_affine_map
from ddic.start.pieces import find_piece_of_nodes

Array = NDArray[np.float64]

HELD = 1e-9
"""Stiffness, times the mean of K's diagonal, that holds nodes to the affine map of what is known: where one node of a
piece is known, nothing else keeps the piece from turning about it. A larger value lets deformation fade sooner."""


@dataclass(frozen=True, eq=False)
class Extrapolated:
    """A displacement at all nodes of a mesh.

    Attributes
    ----------
    displacement : (n_nodes, 2) array
        Pixels.
    n_pieces_without : int
        Pieces of the mesh in which it was known nowhere: they move with the affine map of what is nearest.
    """

    displacement: Array
    n_pieces_without: int


def extrapolate(mesh: Mesh, displacement: Array, known: NDArray[np.bool_]) -> Extrapolated:
    """Extrapolate a displacement from the nodes at which it is known.

    In each piece the affine map nearest to what is known goes on, and what this leaves is in equilibrium, with free
    edges: rotations and homogeneous strains are extrapolated exactly.

    Parameters
    ----------
    mesh : Mesh
        Perhaps cut by lines, pixels.
    displacement : (n_nodes, 2) array
        Pixels; looked at where it is known.
    known : (n_nodes,) array of bool
        At least one.

    Returns
    -------
    Extrapolated
        As given where it is known.
    """
    values = np.where(known[:, None], displacement, 0.0)
    pieces = find_piece_of_nodes(mesh)
    maps: dict[int, AffineMap] = {}
    for piece in np.unique(pieces[known]):
        own = known & (pieces == piece)
        maps[int(piece)] = fit_affine_map(mesh.nodes[own], displacement[own])
    places = np.flatnonzero(known)
    nearest = places[cKDTree(mesh.nodes[known]).query(mesh.nodes)[1]]
    from_piece = np.where(np.isin(pieces, list(maps)), pieces, pieces[nearest])
    background = np.empty_like(values)
    for piece, of_piece in maps.items():
        members = from_piece == piece
        background[members] = of_piece.at(mesh.nodes[members])
    values[~known] = background[~known]
    values += _balance(mesh, np.where(known[:, None], values - background, 0.0), known)
    return Extrapolated(values, len(np.unique(pieces)) - len(maps))


def _balance(mesh: Mesh, prescribed: Array, known: NDArray[np.bool_]) -> Array:
    """Displacement of unknown nodes in equilibrium with prescribed ones; 0 at these."""
    values = np.zeros_like(prescribed)
    padded = mesh.cells
    touched = ((padded >= 0) & ~known[padded]).any(axis=1)
    if not touched.any():
        return values
    part, nodes = mesh.create_submesh(np.flatnonzero(touched))
    stiffness = assemble_stiffness(part, Material()).tocsr()
    is_free = np.repeat(~known[nodes], mesh.dim)
    free, held = np.flatnonzero(is_free), np.flatnonzero(~is_free)
    inside = stiffness[free][:, free]
    ridge = HELD * float(inside.diagonal().mean())
    operator = LocalOperator((inside + ridge * sparse.identity(len(free), format="csr")).tocsr(),
                             smallest_eigenvalue=0.0, where="extrapolation of the start")
    try:
        found = operator.solve(-stiffness[free][:, held] @ prescribed[nodes].ravel()[held])
    finally:
        operator.destroy()
    of_part = np.zeros(part.n_dofs)
    of_part[free] = found
    values[nodes] = of_part.reshape(-1, mesh.dim)
    return values
