"""Strains of the measured field, at cell centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.shapes import CENTRES, shape_gradients


@dataclass(frozen=True)
class Strain:
    """Symmetric tensors (exx, eyy, exy) per cell, each (n_cells, 3), no unit.

    infinitesimal: (grad u + grad u^T) / 2; green_lagrange: that plus grad u^T grad u / 2.
    """

    infinitesimal: NDArray[np.float64]
    green_lagrange: NDArray[np.float64]


def cell_strain(mesh: Mesh, q: NDArray[np.float64]) -> Strain:
    """Strain at the centre of every cell from nodal displacement q (n_dofs,), pixels."""
    gradient = _cell_gradient(mesh, q)
    small = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    large = small + 0.5 * np.einsum("eki,ekj->eij", gradient, gradient)
    return Strain(_voigt(small), _voigt(large))


def inverted_cells(mesh: Mesh, q: NDArray[np.float64]) -> NDArray[np.int64]:
    """Numbers of the cells that q (n_dofs,), pixels, turns inside out at their centre: det(I + grad u) <= 0."""
    return np.flatnonzero(np.linalg.det(np.eye(2) + _cell_gradient(mesh, q)) <= 0).astype(np.int64)


def _cell_gradient(mesh: Mesh, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement gradient du_c/dx_j at the centre of every cell, (n_cells, 2, 2)."""
    gradient = np.empty((mesh.n_cells, 2, 2))
    u = q.reshape(mesh.nodes.shape)
    for cell_type in np.unique(mesh.types):
        members = np.flatnonzero(mesh.types == cell_type)
        slopes, _ = shape_gradients(mesh, members, CENTRES[int(cell_type)])
        nodal = u[mesh.cells[members][:, : slopes.shape[2]]]
        gradient[members] = np.einsum("ekc,ekj->ecj", nodal, slopes[:, 0])
    return gradient


def _voigt(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([tensor[:, 0, 0], tensor[:, 1, 1], tensor[:, 0, 1]], axis=1)
