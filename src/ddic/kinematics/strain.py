"""Strains of the measured field, at cell centres."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.interpolation import differentiate_shapes_at
from ddic.mesh.mesh import Mesh, invert_matrices, pad_cells


@dataclass(frozen=True)
class Strain:
    """Symmetric tensors of every cell, no unit: in the plane (exx, eyy, exy).

    Attributes
    ----------
    infinitesimal : (n_cells, dim (dim + 1) / 2) array
        (grad u + grad u^T) / 2.
    green_lagrange : (n_cells, dim (dim + 1) / 2) array
        That plus grad u^T grad u / 2.
    """

    infinitesimal: NDArray[np.float64]
    green_lagrange: NDArray[np.float64]


def compute_strain(mesh: Mesh, q: NDArray[np.float64]) -> Strain:
    """Compute the strain at the centre of every cell.

    Parameters
    ----------
    mesh : Mesh
        Any.
    q : (n_dofs,) array
        Nodal displacement, pixels.

    Returns
    -------
    Strain
        Of every cell.
    """
    gradient = compute_displacement_gradients(mesh, q)
    small = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    large = small + 0.5 * np.einsum("eki,ekj->eij", gradient, gradient)
    return Strain(_independent_components(small), _independent_components(large))


def find_inverted_cells(mesh: Mesh, q: NDArray[np.float64]) -> NDArray[np.int64]:
    """Find the cells that a displacement turns inside out at their centre: det(I + grad u) <= 0.

    Parameters
    ----------
    mesh : Mesh
        Any.
    q : (n_dofs,) array
        Nodal displacement, pixels; nan where it is not known.

    Returns
    -------
    (n,) int64 array
        Their sorted numbers.
    """
    deformation = np.eye(mesh.dim) + compute_displacement_gradients(mesh, q)
    with np.errstate(invalid="ignore"):
        return np.flatnonzero(np.linalg.det(deformation) <= 0).astype(np.int64)


def compute_displacement_gradients(mesh: Mesh, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute du_c/dx_j at the centre of every cell.

    Parameters
    ----------
    mesh : Mesh
        Any.
    q : (n_dofs,) array
        Nodal displacement, pixels.

    Returns
    -------
    (n_cells, dim, dim) array
        No unit.
    """
    gradient = np.empty((mesh.n_cells, mesh.dim, mesh.dim))
    u = q.reshape(mesh.nodes.shape)
    for block in mesh.cell_blocks:
        by_local = block.type.slopes_at_centre
        # du_c / dxi_k (dx_j / dxi_k)^-1: two products of whole arrays are ten times as fast as one of each cell.
        of_u, of_x = (np.tensordot(values[block.nodes], by_local, axes=(1, 0)) for values in (u, mesh.nodes))
        inverse, _ = invert_matrices(of_x)
        gradient[block.cells] = of_u @ inverse
    if mesh.parts is not None and mesh.parts.n_parts:
        # In the middle of the part, which need not hold the cell's.
        cells = mesh.parts.cells
        slopes_at = differentiate_shapes_at(mesh, cells, mesh.centroids[cells])
        gradient[cells] = np.einsum("eac,eaj->ecj", u[pad_cells(mesh)[cells]], slopes_at)
    return gradient


def _independent_components(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """The diagonal of symmetric tensors (n, dim, dim), then what is above it."""
    dim = tensor.shape[-1]
    places = [(i, i) for i in range(dim)] + list(combinations(range(dim), 2))
    return np.stack([tensor[:, i, j] for i, j in places], axis=1)
