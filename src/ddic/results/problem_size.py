"""How large a problem is: what the log says before it is solved."""

from __future__ import annotations

from ddic.functionals.view import View
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import ProblemSize


def measure_problem_size(problem: WeightedProblem) -> ProblemSize:
    """Count what is about to be solved; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Set up.

    Returns
    -------
    ProblemSize
        Sizes and weights.
    """
    reference, team = problem.reference, problem.team
    region = reference.region
    ranges = team.gather_lists([_grey_range(r.own) for r in reference.references])
    dynamic_range = max(high for _, high in ranges) - min(low for low, _ in ranges)
    return ProblemSize(region.n_field, region.n_cells, reference.n_pixels, region.n_subdomains, team.size,
                       problem.solver.n_interface, dynamic_range, problem.solver.assembly.eta)


def _grey_range(view: View) -> tuple[float, float]:
    values = view.correlation.reference.values
    return float(values.min()), float(values.max())
