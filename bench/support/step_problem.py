"""One linear step of a case on any partition: systems, factors, steps, with any b and q.

This module, ``cut_off_problem``, ``tiled_texture`` and the jobs are all of bench and accept that know how ddic sets up
a problem; everything else runs its commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.loader import LoadedCase
from ddic.case.schema import Case, RegularizationSection, SolverSection
from ddic.functionals.regularization import controlled_stiffness
from ddic.functionals.view import FrameView
from ddic.inputs.inputs import open_inputs
from ddic.mesh.mesh import Mesh
from ddic.parallel.field import ByView, Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import Assembly, assemble
from ddic.problem.reference_problem import Hessians, ReferenceProblem, assemble_hessians, read_reference_views
from ddic.problem.region_mesh import (
    Region,
    RegionMesh,
    build_material,
    build_region_mesh,
    scatter_region,
    split_region,
)
from ddic.problem.residual_model import open_frame_views
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.linear_step import StepResult
from ddic.solvers.local_system import LocalOperator, MonolithicStep

ALONE = Team(MPI.COMM_SELF)
"""This rank without the others."""

Vector = NDArray[np.float64]
Split = Callable[[Mesh], NDArray[np.int64]]
"""From the whole mesh to the subdomain of each cell, (n_cells,)."""


@dataclass(frozen=True)
class StepProblem:
    """A case of one camera spread over the ranks of a team, M assembled.

    Attributes
    ----------
    team : Team
        Ranks.
    case : Case
        With its solver and regularization.
    whole : RegionMesh or None
        The whole mesh, on rank 0.
    reference : ReferenceProblem
        Owned subdomains with their pixels in the reference image, and M.
    views : ByView of FrameView
        The same pixels in both images.
    """

    team: Team
    case: Case
    whole: RegionMesh | None
    reference: ReferenceProblem
    views: ByView[FrameView]

    @property
    def region(self) -> Region:
        """What every rank knows of the whole mesh."""
        return self.reference.region

    @property
    def hessians(self) -> Hessians:
        """M of each view, grey levels squared per pixel squared."""
        return self.reference.hessians

    @property
    def subdomains(self) -> list[Subdomain]:
        """Owned subdomains."""
        return self.reference.subdomains

    @property
    def numbers(self) -> list[NDArray[np.int64]]:
        """Numbers of their unknowns in the whole problem."""
        return [subdomain.numbers for subdomain in self.subdomains]

    def assemble(self) -> Assembly:
        """Find eta and set up the local systems; collective.

        Returns
        -------
        Assembly
            Of owned subdomains.
        """
        return assemble(self.team, self.reference, [1.0])

    def right_hand_sides(self, q: Sequence[Vector]) -> list[Vector]:
        """Give b_s at a displacement, Eq. 7 of [BP17].

        Parameters
        ----------
        q : sequence of (n_unknowns,) arrays
            Of each owned subdomain, pixels.

        Returns
        -------
        list of (n_unknowns,) arrays
            Grey levels squared per pixel.
        """
        found = []
        for (view,), q_s in zip(self.views, q, strict=True):
            found.append(view.assemble_right_hand_side(view.compute_residual(q_s)))
        return found

    def count_subdomains(self) -> NDArray[np.int64]:
        """Count the subdomains that share each unknown of the whole problem; collective.

        Returns
        -------
        (n_field,) array
            Their numbers.
        """
        counts = np.zeros(self.region.n_field, dtype=np.int64)
        for numbers in self.team.gather_lists(self.numbers):
            counts[numbers] += 1
        return counts


def prepare_step(team: Team, case: Case, split: Split | None = None) -> StepProblem:
    """Open the images of a case, cut its mesh and assemble M; collective.

    Parameters
    ----------
    team : Team
        Ranks.
    case : Case
        With absolute paths.
    split : callable, optional
        Cuts the mesh, on rank 0; by default as the case says.

    Returns
    -------
    StepProblem
        Without any factor.
    """
    inputs, frame = open_inputs(team, LoadedCase(case, Path("job"), ""))
    whole = team.build_on_root(lambda: build_region_mesh(inputs))
    if whole is None:
        parts = None
    else:
        parts = split_region(whole, team.size) if split is None else split(whole.mesh)
    subdomains, region = scatter_region(team, inputs, whole, parts)
    views = read_reference_views(case, inputs.cameras, subdomains)
    n_pixels = team.sum(sum(view.n_pixels for view in views.flat))
    reference = ReferenceProblem(replace(inputs, case=case), region, subdomains, views, assemble_hessians(team, views),
                                 n_pixels, ())
    return StepProblem(team, case, whole, reference, open_frame_views(case, frame, views))


def prepare_whole(case: Case) -> StepProblem:
    """Prepare a case on one domain, on every rank by itself.

    Parameters
    ----------
    case : Case
        Its ``[solver]`` does not count.

    Returns
    -------
    StepProblem
        One subdomain.
    """
    return prepare_step(ALONE, case.model_copy(update={"solver": SolverSection(method="monolithic")}))


def factorize(assembly: Assembly) -> list[LocalOperator]:
    """Factorise A_s of all owned subdomains.

    Parameters
    ----------
    assembly : Assembly
        Their systems.

    Returns
    -------
    list of LocalOperator
        To be destroyed.
    """
    return [LocalOperator(system.without_motion.operator, smallest_eigenvalue=assembly.smallest_eigenvalue,
                          where=f"subdomain {system.subdomain.index}")
            for system in assembly.systems]


def solve_dual(problem: StepProblem, settings: DualSettings, q: Vector, b: Vector) -> StepResult:
    """Solve one linear step by subdomains, from scratch; collective.

    Parameters
    ----------
    problem : StepProblem
        The subdomains.
    settings : DualSettings
        Of the interface problem.
    q : (n_field,) array
        Displacement of the whole mesh, pixels.
    b : (n_field,) array
        Share of each subdomain in the right-hand side.

    Returns
    -------
    StepResult
        The correction of each owned subdomain.
    """
    assembly = problem.assemble()
    operators = factorize(assembly)
    step = DualStep(problem.team, assembly.systems, operators, assembly.reaction_scale, settings)
    try:
        subdomains = [system.subdomain for system in assembly.systems]
        start = Field(problem.team, subdomains, [q[n] for n in problem.numbers])
        return step.solve(start, start.with_parts(b[n] for n in problem.numbers))
    finally:
        step.destroy()
        for operator in operators:
            operator.destroy()


def correct_monolithically(whole: StepProblem, q: Vector, b: Vector,
                           multiplicity: NDArray[np.int64] | None = None) -> Vector:
    """Solve one linear step on one domain.

    Parameters
    ----------
    whole : StepProblem
        One subdomain.
    q : (n_field,) array
        Displacement, pixels.
    b : (n_field,) array
        Right-hand side.
    multiplicity : (n_field,) array, optional
        Subdomains at each unknown, where interface rows are to be weighted by 1/sqrt of it.

    Returns
    -------
    (n_field,) array
        Correction dq, pixels.
    """
    (system,) = whole.assemble().systems
    section = whole.case.regularization
    if multiplicity is not None and section is not None:
        weights = system.row_weights / np.sqrt(multiplicity)
        stiffness = weighted_stiffness(system.subdomain, section, weights)
        system = replace(system, stiffness=stiffness, row_weights=weights)
    operator = LocalOperator(system.operator, smallest_eigenvalue=0.0, where="the whole mesh")
    try:
        start = Field(whole.team, [system.subdomain], [q])
        return MonolithicStep(system, operator).solve(start, start.with_parts([b])).dq[0]
    finally:
        operator.destroy()


def weighted_stiffness(subdomain: Subdomain, section: RegularizationSection, weights: Vector) -> sparse.csr_matrix:
    """Assemble Kbar of a subdomain.

    Parameters
    ----------
    subdomain : Subdomain
        Its mesh and unknowns.
    section : RegularizationSection
        Says the material.
    weights : (n_field,) array
        Of its rows, no unit.

    Returns
    -------
    (n_field, n_field) csr_matrix
        Kbar_s.
    """
    return controlled_stiffness(subdomain.kinematics, build_material(section, subdomain.mesh.dim), weights)


def find_relative_difference(problem: StepProblem, dq: Sequence[Vector], reference: Vector) -> float:
    """Find the largest difference between the subdomains' dq and the one-domain dq; collective.

    Parameters
    ----------
    problem : StepProblem
        The subdomains.
    dq : sequence of (n_unknowns,) arrays
        Their corrections, pixels.
    reference : (n_field,) array
        Correction of one domain, pixels.

    Returns
    -------
    float
        Relative to the largest entry of the reference.
    """
    mine = max(float(np.abs(d - reference[numbers]).max()) for d, numbers in zip(dq, problem.numbers, strict=True))
    return max(problem.team.gather_lists([mine])) / float(np.abs(reference).max())
