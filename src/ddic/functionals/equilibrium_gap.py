"""Equilibrium gap: Kbar = P K and its weight eta from a cut-off wavelength [LPHR11]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.elasticity import Material, stiffness_cells
from ddic.kinematics.finite_element import FiniteElementKinematics, finite_element_kinematics
from ddic.kinematics.tie import Tie
from ddic.mesh.mesh import Mesh

_CHUNK_CELLS = 2_000


def controlled_stiffness(mesh: Mesh, kinematics: FiniteElementKinematics, material: Material,
                         row_weights: NDArray[np.float64], tie: Tie | None = None) -> sparse.csr_matrix:
    """Kbar = diag(row_weights) K, (n_dofs, n_dofs); weight 0 drops a row (P of Eq. 11 of [BP17]).

    tie: from unknown to mesh nodes; forces on slaves are then their masters', as much as these move them.
    """
    stiffness = kinematics.assemble_matrix(stiffness_cells(mesh, material))
    if tie is not None:
        stiffness = tie.matrix.T @ stiffness @ tie.matrix
    return (sparse.diags(row_weights) @ stiffness).tocsr()


def plane_waves(nodes: NDArray[np.float64], wavelength: float) -> NDArray[np.float64]:
    """Waves v = e_a cos(2 pi x_b / l_c + phi), phi in {0, pi/2}, on nodes (n, dim); returns (n dim, 2 dim^2)."""
    n, dim = nodes.shape
    waves = []
    for a in range(dim):
        for b in range(dim):
            for phi in (0.0, np.pi / 2):
                v = np.zeros((n, dim))
                v[:, a] = np.cos(2 * np.pi * nodes[:, b] / wavelength + phi)
                waves.append(v.ravel())
    return np.stack(waves, axis=1)


def gap_energies(mesh: Mesh, material: Material, interior_nodes: NDArray[np.bool_],
                 wavelength: float) -> NDArray[np.float64]:
    """|K v|^2 of every plane wave on the interior nodes' rows, a batch of cells at a time, K never assembled."""
    waves = plane_waves(mesh.nodes, wavelength)
    forces = np.zeros_like(waves)
    for begin in range(0, mesh.n_cells, _CHUNK_CELLS):
        part, nodes = mesh.submesh(np.arange(begin, min(begin + _CHUNK_CELLS, mesh.n_cells)))
        dofs = (nodes[:, None] * mesh.dim + np.arange(mesh.dim)).ravel()
        cell_dofs = finite_element_kinematics(part).cell_dofs
        by_cell = stiffness_cells(part, material) @ waves[dofs][cell_dofs]
        for wave in range(waves.shape[1]):
            forces[dofs, wave] += np.bincount(cell_dofs.ravel(), by_cell[..., wave].ravel(), minlength=len(dofs))
    rows = np.repeat(interior_nodes, mesh.dim)
    return np.asarray((forces[rows] ** 2).sum(axis=0))


def texture_energies(nodes: NDArray[np.float64], hessian: sparse.csr_matrix,
                     interior_nodes: NDArray[np.bool_], wavelength: float) -> NDArray[np.float64]:
    """v^T M v of every plane wave on the interior nodes' rows; adds up over subdomains."""
    waves = plane_waves(nodes, wavelength)
    rows = np.repeat(interior_nodes, nodes.shape[1])
    return np.asarray((waves * (hessian @ waves))[rows].sum(axis=0))


def cut_off_weight(texture: NDArray[np.float64], gap: NDArray[np.float64]) -> float:
    """Weight eta at which texture and mechanics count alike at l_c: mean of |v^T M v| / |K v|^2 [LPHR11].

    texture, gap: of every plane wave of ``plane_waves``, on the same nodes. The two phases of a wave are
    added up before the ratio, for a wave may vanish on all nodes; the mean is over a and b.
    """
    by_wave = np.abs(texture).reshape(-1, 2).sum(axis=1) / gap.reshape(-1, 2).sum(axis=1)
    return float(by_wave.mean())
