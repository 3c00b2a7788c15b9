"""The linear steps on meshes that do not match, against a saddle point with a multiplier for each tied node."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest

from ddic.parallel.team import Team
from support.tied_step import Layout, TiedCut, TiedStep, multiplier_solution, tied_step

RANKS = [1, 2, 3, 4]
TIGHT: dict[str, Any] = {"tolerance": 1e-12, "max_iterations": 3000}
# The Krylov residual is 1e-12 of the right-hand side; condition numbers of the interface problem below 1e3 leave 1e-9.
SAME = 1e-9


def errors_of(problem: TiedStep, **solver: Any) -> tuple[float, int]:
    cut = TiedCut(Team.world(), problem, **solver)
    reference = Team.world().on_root(lambda: multiplier_solution(problem))
    with cut.step() as step:
        result = cut.solve(step)
    return cut.relative_error(result.dq, reference), result.krylov_iterations


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True])
@pytest.mark.parametrize("layout", ["island", "edge"])
@pytest.mark.parametrize("near_element", [3.1, 5.7])
def test_dual_equals_the_saddle_point(near_element: float, layout: Layout, regularized: bool) -> None:
    problem = tied_step(layout, "translation", near_element, regularized=regularized)
    for n in (4, 9):
        error, iterations = errors_of(problem, subdomains=n, **TIGHT)
        assert error <= SAME
        assert 0 < iterations < 300


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("preconditioner", ["scaled", "two_level", "paper"])
@pytest.mark.parametrize("cell", ["Q4", "T3"])
def test_with_a_turn_and_any_preconditioner(cell: Literal["Q4", "T3"], preconditioner: str) -> None:
    problem = tied_step("island", "rigid", 3.1, regularized=True, cell=cell)
    assert errors_of(problem, subdomains=6, preconditioner=preconditioner, **TIGHT)[0] <= SAME


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True])
@pytest.mark.parametrize(("method", "bound"), [("assembled", 1e-10), ("conjugate_gradient", 1e-7)])
def test_the_whole_system_equals_the_saddle_point(method: str, bound: float, regularized: bool) -> None:
    """One factorisation leaves rounding; conjugate gradients stop at 1e-12 of a condition number of some 1e4."""
    problem = tied_step("edge", "rigid", 3.1, regularized=regularized)
    assert errors_of(problem, method=method, subdomains=5, **TIGHT)[0] <= bound


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("local_inverse", ["dense", "sparse"])
def test_either_local_inverse(local_inverse: str) -> None:
    problem = tied_step("edge", "translation", 3.1, regularized=True)
    assert errors_of(problem, subdomains=6, local_inverse=local_inverse, **TIGHT)[0] <= SAME


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("blocks", [(2, 2), (3, 3), (5, 4)])
def test_subdomains_that_touch_the_boundary_at_a_corner(blocks: tuple[int, int]) -> None:
    """Given blocks are cut where the meshes change; cells whose slaves do not tell their masters move."""
    problem = tied_step("island", "translation", 3.1, regularized=False)
    assert errors_of(problem, partition="blocks", blocks=blocks, **TIGHT)[0] <= SAME


def test_the_multipliers_are_of_full_rank() -> None:
    """Of the oracle itself: its displacement is tied, and no unknown is left out."""
    problem = tied_step("island", "translation", 3.1, regularized=True)
    u, motion = multiplier_solution(problem)
    assert np.isfinite(u).all()
    assert len(motion) == 2
    nodes = u.reshape(-1, 2)
    np.testing.assert_allclose(problem.tying.weights @ nodes[:problem.tying.n_unknown_nodes], nodes,
                               atol=1e-9 * np.abs(u).max())
