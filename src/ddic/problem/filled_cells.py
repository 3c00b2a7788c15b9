"""Cells that a frame does not show and nothing else holds: elastic matter that follows its neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.elasticity import Material, integrate_cell_stiffness
from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.plane import build_rotation
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.region_rotation import fit_rigid_motion

Array = NDArray[np.float64]

STIFFNESS = 1e-4
"""Young's modulus of filled cells, relative to the mean diagonal of M. They pull at the cells beside them: a larger
value moves these, a smaller one worsens the operators' condition."""

HELD = 1e-8
"""What the operator of filled cells has on its diagonal beyond their stiffness, relative to the mean diagonal of M: a
subdomain that is hidden altogether may move as a rigid body, and its operator must not be singular. Forces have nothing
of it, so that it costs iterations only; a larger value costs more of them, where hundreds of cells are hidden in a row.
"""


@dataclass(frozen=True, eq=False)
class FilledCells:
    """Elastic energy of the cells that a frame does not show, less that of the region's rigid motion.

    Attributes
    ----------
    team : Team
        All ranks.
    subdomains : tuple of Subdomain
        Owned ones.
    of_nodes : tuple of (n_dofs, n_dofs) csr_matrix
        Stiffness of the filled cells of each on displacements of nodes, not turned, grey levels squared per pixel
        squared.
    stiffness : tuple of (n_unknowns, n_unknowns) csr_matrix
        The same on unknowns, turned as far as the region had when the operators were assembled.
    held : float
        What their operators have on the diagonal beyond it, grey levels squared per pixel squared.
    """

    team: Team
    subdomains: tuple[Subdomain, ...]
    of_nodes: tuple[sparse.csr_matrix, ...]
    stiffness: tuple[sparse.csr_matrix, ...]
    held: float

    def assemble_operator(self, number: int) -> sparse.csr_matrix:
        """Assemble what the operator of an owned subdomain is given.

        Parameters
        ----------
        number : int
            Of the subdomain among the owned ones.

        Returns
        -------
        (n_unknowns, n_unknowns) csr_matrix
            Grey levels squared per pixel squared; positive on each unknown of filled cells.
        """
        stiffness = self.stiffness[number]
        is_filled = stiffness.diagonal() > 0
        return (stiffness + sparse.diags(self.held * is_filled)).tocsr()

    def compute_forces(self, q: Sequence[Array]) -> list[Array]:
        """Compute the forces that b is given; collective.

        Parameters
        ----------
        q : sequence of (n_unknowns,) array
            Unknowns of each owned subdomain.

        Returns
        -------
        list of (n_unknowns,) array
            Grey levels squared per pixel.
        """
        motion = fit_rigid_motion(self.team, self.subdomains, q)
        forces = []
        for subdomain, of_nodes, q_s in zip(self.subdomains, self.of_nodes, q, strict=True):
            of_subdomain = np.zeros(subdomain.n_unknowns)
            if of_nodes.nnz:
                nodes = subdomain.mesh.nodes
                field = subdomain.kinematics.displacement(q_s[:subdomain.n_field]).reshape(nodes.shape)
                rest = (field - motion.evaluate(nodes)) @ motion.rotation
                # Turned as the region is now: else the field would depend on where its operators were assembled.
                pull = -(of_nodes @ rest.ravel()).reshape(nodes.shape) @ motion.rotation.T
                of_subdomain[:subdomain.n_field] = subdomain.kinematics.project_vector(pull.ravel())
            forces.append(of_subdomain)
        return forces


def fill_cells(team: Team, subdomains: Sequence[Subdomain], cells: Sequence[NDArray[np.bool_]], weight: float,
               angle: float) -> FilledCells:
    """Give cells without pixels an elastic energy; free of communication.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        Owned ones.
    cells : sequence of (n_cells,) bool array
        Which of their cells are filled.
    weight : float
        Mean diagonal of M, grey levels squared per pixel squared.
    angle : float
        By which the region has turned, radians.

    Returns
    -------
    FilledCells
        Of all of them.
    """
    of_nodes = [_assemble(subdomain, chosen, STIFFNESS * weight)
                for subdomain, chosen in zip(subdomains, cells, strict=True)]
    stiffness = [_turn(subdomain, matrix, angle) for subdomain, matrix in zip(subdomains, of_nodes, strict=True)]
    return FilledCells(team, tuple(subdomains), tuple(of_nodes), tuple(stiffness), HELD * weight)


def _assemble(subdomain: Subdomain, chosen: NDArray[np.bool_], modulus: float) -> sparse.csr_matrix:
    """On displacements of nodes, (n_dofs, n_dofs)."""
    n_dofs = subdomain.mesh.n_dofs
    if not chosen.any():
        return sparse.csr_matrix((n_dofs, n_dofs))
    of_cells = integrate_cell_stiffness(subdomain.mesh, Material())
    of_cells[~chosen] = 0.0
    stiffness: sparse.csr_matrix = interpolate_cells(subdomain.mesh).assemble_matrix(modulus * of_cells)
    return stiffness


def _turn(subdomain: Subdomain, of_nodes: sparse.csr_matrix, angle: float) -> sparse.csr_matrix:
    """The same on unknowns, R K R^T, (n_unknowns, n_unknowns)."""
    n_motion = subdomain.n_motion
    if not of_nodes.nnz:
        return sparse.csr_matrix((subdomain.n_unknowns, subdomain.n_unknowns))
    turn = sparse.kron(sparse.identity(subdomain.mesh.n_nodes), build_rotation(angle)).tocsr()
    of_field = subdomain.kinematics.project_matrix((turn @ of_nodes @ turn.T).tocsr())
    return sparse.block_diag([of_field, sparse.csr_matrix((n_motion, n_motion))]).tocsr() if n_motion else of_field
