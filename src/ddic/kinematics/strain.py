"""Strains of the measured field, at cell centres."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.mesh.interpolation import differentiate_shapes_at
from ddic.mesh.mesh import Mesh
from ddic.mesh.shapes import compute_shape_gradients, pad_cells


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
        slopes, _ = compute_shape_gradients(mesh, block, block.type.centre[None])
        gradient[block.cells] = np.einsum("eac,eaj->ecj", u[block.nodes], slopes[:, 0])
    if mesh.parts is not None and mesh.parts.n_parts:
        # In the middle of the part, which need not hold the cell's.
        cells = mesh.parts.cells
        slopes_at = differentiate_shapes_at(mesh, cells, mesh.centroids[cells])
        gradient[cells] = np.einsum("eac,eaj->ecj", u[pad_cells(mesh)[cells]], slopes_at)
    return gradient


def build_gradient_operator(mesh: Mesh) -> sparse.csr_matrix:
    """Build what ``compute_displacement_gradients`` does to one component.

    Parameters
    ----------
    mesh : Mesh
        Any.

    Returns
    -------
    (dim n_cells, n_nodes) csr_matrix
        To the derivatives by x_j at the centres, cell by cell.
    """
    nodes = pad_cells(mesh)
    slopes = np.zeros((*nodes.shape, mesh.dim))
    for block in mesh.cell_blocks:
        of_block, _ = compute_shape_gradients(mesh, block, block.type.centre[None])
        slopes[block.cells, :of_block.shape[2]] = of_block[:, 0]
    if mesh.parts is not None and mesh.parts.n_parts:
        cells = mesh.parts.cells
        slopes[cells] = differentiate_shapes_at(mesh, cells, mesh.centroids[cells])
    rows = np.broadcast_to(np.arange(mesh.n_cells * mesh.dim).reshape(-1, 1, mesh.dim), slopes.shape)
    columns = np.broadcast_to(nodes[:, :, None], slopes.shape)
    shape = (mesh.n_cells * mesh.dim, mesh.n_nodes)
    # What is padded repeats a node, with slopes of 0.
    return sparse.csr_matrix((slopes.ravel(), (rows.ravel(), columns.ravel())), shape)


def _independent_components(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """The diagonal of symmetric tensors (n, dim, dim), then what is above it."""
    dim = tensor.shape[-1]
    places = [(i, i) for i in range(dim)] + list(combinations(range(dim), 2))
    return np.stack([tensor[:, i, j] for i, j in places], axis=1)
