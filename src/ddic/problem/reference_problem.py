"""What the reference images alone give: the mesh cut, its pixels and M."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import Hessians, assemble_hessians
from ddic.problem.blank_subdomains import join_blank_subdomains
from ddic.problem.choose_solver import choose_solver
from ddic.problem.inputs import Inputs
from ddic.problem.region_mesh import Region, RegionMesh, build_region_mesh, scatter_region, split_region
from ddic.problem.thread_note import note_crowded_cores
from ddic.problem.views import ReferenceViews, read_reference_views
from ddic.solvers.factor_packages import describe_missing_packages

T = TypeVar("T")


@dataclass(frozen=True)
class ReferenceProblem:
    """Owned subdomains with their pixels and M, from the reference images alone.

    Attributes
    ----------
    inputs : Inputs
        What it was made from, with a case that says the linear step.
    region : Region
        What is known of the whole mesh.
    references : list of ReferenceViews
        Owned subdomains, cameras not yet weighted.
    hessians : list of list of (n_dofs, n_dofs) csr_matrix
        M of each view, on displacements of nodes in its image.
    n_pixels : int
        Pixels of all views of the whole region that the reference images do not exclude.
    notes : tuple of str
        What the user should know.
    """

    inputs: Inputs
    region: Region
    references: list[ReferenceViews]
    hessians: list[Hessians]
    n_pixels: int
    notes: tuple[str, ...]

    @property
    def subdomains(self) -> list[Subdomain]:
        """Owned subdomains."""
        return [reference.subdomain for reference in self.references]

    def convert_to_reference(self, q: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Take unknowns since the first reference image from the one in use; free of communication.

        Parameters
        ----------
        q : sequence of (n_unknowns,) array
            Of each owned subdomain.

        Returns
        -------
        list of (n_unknowns,) array
            The same, unless a later frame has taken the first image's place.
        """
        updated = self.inputs.updated
        if updated is None:
            return list(q)
        return [q_s - before for q_s, before in zip(q, updated.restrict(self.subdomains), strict=True)]


def build_whole_mesh(team: Team, inputs: Inputs) -> RegionMesh | None:
    """Build the whole mesh on rank 0; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        What the measurement is made from.

    Returns
    -------
    RegionMesh or None
        On rank 0.

    Raises
    ------
    InputError
        On all ranks, where the mesh is refused.
    """
    return team.build_on_root(lambda: build_region_mesh(inputs))


def prepare_reference(team: Team, inputs: Inputs, region_mesh: RegionMesh | None, clock: PhaseClock,
                      meanwhile: Callable[[], T]) -> tuple[ReferenceProblem, T]:
    """Choose how to solve, cut the mesh, read the reference images and assemble M; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        What the measurement is made from.
    region_mesh : RegionMesh or None
        The whole mesh, on rank 0.
    clock : PhaseClock
        Of the phases.
    meanwhile : callable
        Work free of communication that other ranks do while rank 0 splits the mesh.

    Returns
    -------
    problem : ReferenceProblem
        Owned subdomains, none of them blank where the others can hold it.
    found : T
        What ``meanwhile`` found on this rank.

    Raises
    ------
    InputError
        On all ranks, where the mesh cannot be cut as asked, or leaves an image.
    """
    with clock.phase(Phase.START):
        inputs, region_mesh = choose_solver(team, inputs, region_mesh)
        parts, found = team.together(lambda: (
            None if region_mesh is None else split_region(region_mesh, team.size), meanwhile()))
    problem = _read_and_assemble(team, inputs, region_mesh, parts, clock)
    case = inputs.case
    if case.solver.method != "dual" or case.regularization is None or problem.region.n_subdomains == 1:
        # Without regularization a blank part is singular whatever the partition, and the factorisation says where.
        return problem, found
    with clock.phase(Phase.ASSEMBLE):
        joining = join_blank_subdomains(team, region_mesh, problem.references, [m[0] for m in problem.hessians],
                                        case.correlation.spline_degree)
    if joining is None:
        return problem, found
    return _read_and_assemble(team, inputs, region_mesh, joining.parts, clock, (joining.note,)), found


def _describe_discontinuities(team: Team, region_mesh: RegionMesh | None) -> tuple[str, ...]:
    """How much of the mesh is cut, where it is; collective."""

    def describe() -> tuple[str, ...]:
        region = require_held(region_mesh).discontinuous
        return () if region is None else (f"discontinuities: {region.describe()}",)

    return team.on_root(describe)


def _read_and_assemble(team: Team, inputs: Inputs, region_mesh: RegionMesh | None, parts: NDArray[np.int64] | None,
                       clock: PhaseClock, notes: tuple[str, ...] = ()) -> ReferenceProblem:
    case = inputs.case
    with clock.phase(Phase.START):
        subdomains, region = scatter_region(team, region_mesh, parts)
    with clock.phase(Phase.READ):
        references = team.together(lambda: read_reference_views(case, inputs.cameras, subdomains))
        n_pixels = sum(team.gather_lists([view.n_pixels for r in references for view in r.views]))
    with clock.phase(Phase.ASSEMBLE):
        hessians = assemble_hessians(team, clock.note_each(references))
    lines = _describe_discontinuities(team, region_mesh)
    notes = (*inputs.notes, *notes, *lines, *note_crowded_cores(team, case.solver.threads),
             *describe_missing_packages(case.solver.method))
    return ReferenceProblem(inputs, region, references, hessians, n_pixels, notes)
