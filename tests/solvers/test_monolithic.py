"""The monolithic step against a dense solution of Eq. 11 of [BP17]."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.parallel.team import Team
from ddic.solvers.local_system import MonolithicStep
from support.linear import Decomposed, dense, linear_step


@pytest.mark.parametrize("wavelength", [None, 32.0])
def test_solves_equation_11(wavelength: float | None) -> None:
    problem = linear_step(8, wavelength)
    whole = np.zeros(problem.mesh.n_cells, dtype=np.int64)
    with Decomposed(Team.alone(), problem, whole, "consistent") as cut:
        system = cut.systems[0]
        result = MonolithicStep(system, cut.operators[0]).solve(cut.field([problem.q]), cut.field([problem.b]))
        matrix, right = dense(system.hessian), problem.b
        if system.controlled_stiffness is not None:
            kbar = dense(system.controlled_stiffness)
            matrix = matrix + problem.eta * kbar.T @ kbar
            right = right - problem.eta * kbar.T @ (kbar @ problem.q)
    expected = np.linalg.solve(matrix, right)
    assert result.krylov_iterations == 0
    assert len(result.krylov_history) == 0
    # Two direct solvers, condition number below 1e5.
    np.testing.assert_allclose(result.dq[0], expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_regularization_acts_on_the_controlled_rows_alone() -> None:
    # A field that is balanced on every controlled row feels no regularization: b - eta Kbar^T Kbar q = b.
    problem = linear_step(8, 32.0)
    whole = np.zeros(problem.mesh.n_cells, dtype=np.int64)
    affine = (problem.mesh.nodes @ np.array([[0.01, -0.02], [0.03, 0.005]])).ravel()
    with Decomposed(Team.alone(), problem, whole, "consistent") as cut:
        right = cut.systems[0].right_hand_side(problem.b, affine)
    # The patch test: a linear displacement leaves interior nodes without force, to rounding.
    np.testing.assert_allclose(right, problem.b, rtol=0, atol=1e-9 * np.abs(problem.b).max())
