"""How large a problem is: what the log says before it is solved."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.functionals.view import View
from ddic.parallel.team import Team
from ddic.problem.linear_solver import LinearSolver
from ddic.problem.reference_problem import ReferenceProblem


@dataclass(frozen=True)
class ProblemSize:
    """What is about to be solved.

    Attributes
    ----------
    n_unknowns : int
        Of the whole field.
    n_cells : int
        Cells of the mesh.
    n_pixels : int
        Pixels of the mesh that the reference images do not exclude.
    n_subdomains, n_ranks, n_interface : int
        Subdomains, MPI ranks, interface unknowns.
    dynamic_range : float
        max f - min f over the region, grey levels.
    eta : float
        Weight of the equilibrium gap, grey levels squared per pixel squared; 0 without.
    """

    n_unknowns: int
    n_cells: int
    n_pixels: int
    n_subdomains: int
    n_ranks: int
    n_interface: int
    dynamic_range: float
    eta: float


def measure_problem_size(team: Team, reference: ReferenceProblem, solver: LinearSolver) -> ProblemSize:
    """Count what is about to be solved; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    reference : ReferenceProblem
        What the reference images give.
    solver : LinearSolver
        Set up.

    Returns
    -------
    ProblemSize
        Sizes and weights.
    """
    region = reference.region
    ranges = team.gather_lists([_grey_range(r.own) for r in reference.references])
    lowest = min(low for low, _ in ranges)
    highest = max(high for _, high in ranges)
    return ProblemSize(region.n_field, region.n_cells, reference.n_pixels, region.n_subdomains, team.size,
                       solver.n_interface, highest - lowest, solver.assembly.eta)


def _grey_range(view: View) -> tuple[float, float]:
    values = view.correlation.reference.values
    return float(values.min()), float(values.max())
