"""One linear step of a case on any partition, dual and on one domain, with the same b and q.

With ``cut_off_problem`` this is the only module of bench and accept that builds subdomains' systems itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.schema import Case, RegularizationSection, SolverSection
from ddic.functionals.equilibrium_gap import controlled_stiffness
from ddic.kinematics.finite_element import finite_element_kinematics
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.problem.assembly import Assembly, assemble, correlate, factorize, own_parts
from ddic.problem.inputs import ImagePair, material, open_pair, share_out
from ddic.problem.linear_solver import linear_step
from ddic.problem.mesh_source import build_mesh
from ddic.solvers.gauss_newton import OwnedPart
from ddic.solvers.linear_step import StepResult
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep

ALONE = Team(MPI.COMM_SELF)
"""This rank without the others."""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Distributed:
    """A case spread over the ranks of a team, assembled and factorised.

    Attributes
    ----------
    team : Team
        Ranks.
    assembly : Assembly
        Local systems of owned subdomains.
    operators : list of LocalOperator
        Their factors.
    dofs : list of (n_dofs_s,) arrays
        Numbers of their unknowns in the whole mesh.
    """

    team: Team
    assembly: Assembly
    operators: list[LocalOperator]
    dofs: list[NDArray[np.int64]]

    def count_subdomains(self, mesh: Mesh) -> NDArray[np.int64]:
        """Count the subdomains that share each unknown of the whole mesh.

        Parameters
        ----------
        mesh : Mesh
            The whole mesh.

        Returns
        -------
        (n_dofs,) array
            Their numbers.
        """
        counts = np.zeros(mesh.n_dofs, dtype=np.int64)
        for dofs in self.team.gather_lists(self.dofs):
            counts[dofs] += 1
        return counts

    def destroy(self) -> None:
        """Free the factors."""
        for operator in self.operators:
            operator.destroy()


@dataclass(frozen=True)
class Whole:
    """The same case on one domain, on every rank.

    Attributes
    ----------
    mesh : Mesh
        The whole mesh.
    part : OwnedPart
        Its pixels.
    assembly : Assembly
        One system.
    """

    mesh: Mesh
    part: OwnedPart
    assembly: Assembly

    @property
    def hessian(self) -> sparse.csr_matrix:
        """M, (n_dofs, n_dofs), grey levels squared per pixel squared."""
        return self.assembly.systems[0].hessian

    def right_hand_side(self, q: Vector) -> Vector:
        """Give b at a displacement, Eq. 5 of [BP17].

        Parameters
        ----------
        q : (n_dofs,) array
            Displacement, pixels.

        Returns
        -------
        (n_dofs,) array
            b, grey levels squared per pixel.
        """
        view = self.part.view
        return view.right_hand_side(view.residual(q))


def whole_problem(case: Case) -> tuple[ImagePair, Whole]:
    """Open the images of a case and assemble it on one domain.

    Parameters
    ----------
    case : Case
        Its ``[solver]`` does not count.

    Returns
    -------
    pair : ImagePair
        Its images.
    whole : Whole
        The problem.
    """
    case = case.model_copy(update={"solver": SolverSection(method="monolithic")})
    pair = open_pair(case)
    mesh = build_mesh(case, pair.reference.image.width, pair.reference.image.height)
    subdomains, region = share_out(ALONE, case, mesh)
    part = own_parts(subdomains, pair, case.correlation.spline_degree)[0]
    assembly = assemble(ALONE, [part], correlate(ALONE, [part]), region, case.solver, case.regularization)
    return pair, Whole(mesh, part, assembly)


def distribute_problem(team: Team, case: Case, pair: ImagePair, mesh: Mesh) -> Distributed:
    """Spread the case's subdomains over a team, assembled and factorised; collective.

    Parameters
    ----------
    team : Team
        Ranks.
    case : Case
        With the partition.
    pair : ImagePair
        Its images.
    mesh : Mesh
        The whole mesh.

    Returns
    -------
    Distributed
        To be destroyed.
    """
    subdomains, region = share_out(team, case, mesh if team.is_root else None)
    parts = own_parts(subdomains, pair, case.correlation.spline_degree)
    assembly = assemble(team, parts, correlate(team, parts), region, case.solver, case.regularization)
    operators = factorize(team, assembly.systems, assembly.mean_diagonal)
    return Distributed(team, assembly, operators, [s.dofs for s in subdomains])


def solve_step(problem: Distributed, solver: SolverSection, q: Vector, b: Vector) -> StepResult:
    """Solve one linear step by subdomains; collective.

    Parameters
    ----------
    problem : Distributed
        The subdomains.
    solver : SolverSection
        Method and tolerance.
    q : (n_dofs,) array
        Displacement of the whole mesh, pixels.
    b : (n_dofs,) array
        Share of each subdomain in the right-hand side.

    Returns
    -------
    StepResult
        The correction of each owned subdomain.
    """
    step, _ = linear_step(problem.team, solver, problem.assembly, problem.operators)
    try:
        return step.solve([q[d] for d in problem.dofs], [b[d] for d in problem.dofs])
    finally:
        step.destroy()


def correct_monolithically(whole: Whole, regularization: RegularizationSection | None, q: Vector, b: Vector,
                           multiplicity: NDArray[np.int64] | None = None) -> Vector:
    """Solve one linear step on one domain.

    Parameters
    ----------
    whole : Whole
        The problem.
    regularization : RegularizationSection, optional
        Of the case.
    q : (n_dofs,) array
        Displacement, pixels.
    b : (n_dofs,) array
        Right-hand side.
    multiplicity : (n_dofs,) array, optional
        Subdomains at each unknown, where interface rows are to be weighted by 1/sqrt of it.

    Returns
    -------
    (n_dofs,) array
        Correction dq, pixels.
    """
    system = whole.assembly.systems[0]
    if multiplicity is not None and regularization is not None:
        weights = system.row_weights / np.sqrt(multiplicity)
<<<<<<< HEAD
        kbar = controlled_stiffness(whole.mesh, whole.part.correlation.interpolation, material(regularization), weights)
=======
        kinematics = finite_element_kinematics(whole.mesh)
        kbar = controlled_stiffness(whole.mesh, kinematics, material(regularization), weights)
>>>>>>> refs/heads/accept
        system = LocalSystem(system.subdomain, system.hessian, kbar, weights, system.eta)
    operator = LocalOperator(system.operator, smallest_eigenvalue=0.0, where="the whole mesh")
    try:
        return MonolithicStep(system, operator).solve([q], [b]).dq[0]
    finally:
        operator.destroy()


def find_relative_difference(distributed: Distributed, dq: Sequence[Vector], reference: Vector) -> float:
    """Find the largest difference between the subdomains' dq and the one-domain dq; collective.

    Parameters
    ----------
    distributed : Distributed
        The subdomains.
    dq : sequence of (n_dofs_s,) arrays
        Their corrections, pixels.
    reference : (n_dofs,) array
        Correction of one domain, pixels.

    Returns
    -------
    float
        Relative to the largest entry of the reference.
    """
    mine = max(float(np.abs(d - reference[dofs]).max()) for d, dofs in zip(dq, distributed.dofs, strict=True))
    return max(distributed.team.gather_lists([mine])) / float(np.abs(reference).max())
