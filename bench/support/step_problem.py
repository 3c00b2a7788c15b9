"""One linear step of a case on any partition: dual against monolithic, with the same b and q."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.schema import Case, RegularizationSection, SolverSection
from ddic.functionals.equilibrium_gap import controlled_stiffness
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.problem.assembly import Assembly, assemble, correlate, factorize, own_parts
from ddic.problem.inputs import ImagePair, material, open_pair, share_out
from ddic.problem.mesh_source import build_mesh
from ddic.solvers.gauss_newton import OwnedPart
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep

ALONE = Team(MPI.COMM_SELF)


@dataclass(frozen=True)
class Distributed:
    """A case spread over the ranks of a team; dofs: numbers of each owned subdomain's dofs in the whole mesh."""

    team: Team
    parts: list[OwnedPart]
    assembly: Assembly
    operators: list[LocalOperator]
    dofs: list[NDArray[np.int64]]


@dataclass(frozen=True)
class Whole:
    """The same case on one domain, on every rank."""

    mesh: Mesh
    part: OwnedPart
    assembly: Assembly


def whole_problem(case: Case) -> tuple[ImagePair, Whole]:
    """Images and the one-domain problem of a case."""
    case = case.model_copy(update={"solver": SolverSection(method="monolithic")})
    pair = open_pair(case)
    mesh = build_mesh(case, pair.reference.image.width, pair.reference.image.height)
    subdomains, region = share_out(ALONE, case, mesh)
    part = own_parts(subdomains, pair, case.correlation.spline_degree)[0]
    assembly = assemble(ALONE, [part], correlate(ALONE, [part]), region, case.solver, case.regularization)
    return pair, Whole(mesh, part, assembly)


def distributed_problem(team: Team, case: Case, pair: ImagePair, mesh: Mesh) -> Distributed:
    """The case's subdomains spread over a team, assembled and factorised."""
    subdomains, region = share_out(team, case, mesh if team.is_root else None)
    parts = own_parts(subdomains, pair, case.correlation.spline_degree)
    assembly = assemble(team, parts, correlate(team, parts), region, case.solver, case.regularization)
    operators = factorize(team, assembly.systems, assembly.mean_diagonal)
    dofs = [s.dofs for s in subdomains]
    return Distributed(team, parts, assembly, operators, dofs)


def monolithic_correction(whole: Whole, regularization: RegularizationSection | None, q: NDArray[np.float64],
                          b: NDArray[np.float64], multiplicity: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
    """Dq of one domain; multiplicity: of each dof, where interface rows are to be weighted by 1/sqrt(m)."""
    system = whole.assembly.systems[0]
    if multiplicity is not None and regularization is not None:
        weights = system.row_weights / np.sqrt(multiplicity)
        kbar = controlled_stiffness(whole.mesh, whole.part.correlation.interpolation, material(regularization), weights)
        system = LocalSystem(system.subdomain, system.hessian, kbar, weights, system.eta)
    operator = LocalOperator(system.operator, smallest_eigenvalue=0.0, where="the whole mesh")
    try:
        return MonolithicStep(system, operator).solve([q], [b]).dq[0]
    finally:
        operator.destroy()


def dof_multiplicity(mesh: Mesh, distributed: Distributed) -> NDArray[np.int64]:
    """Number of subdomains that share each dof of the whole mesh."""
    counts = np.zeros(mesh.n_dofs, dtype=np.int64)
    for dofs in distributed.team.gather_lists(distributed.dofs):
        counts[dofs] += 1
    return counts


def relative_difference(distributed: Distributed, dq: Sequence[NDArray[np.float64]],
                        reference: NDArray[np.float64]) -> float:
    """Largest difference between the subdomains' dq and the one-domain dq, relative to the largest |dq|."""
    mine = max(float(np.abs(d - reference[dofs]).max()) for d, dofs in zip(dq, distributed.dofs, strict=True))
    return max(distributed.team.gather_lists([mine])) / float(np.abs(reference).max())
