"""Degrees of freedom by linear steps, against the trace itself."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.probing import estimate_degrees_of_freedom
from support.linear import Decomposed, dense, linear_step, split


@pytest.mark.parallel([1, 2, 3, 4])
@pytest.mark.parametrize("wavelength", [None, 40.0])
def test_they_are_the_trace_whatever_the_partition(wavelength: float | None) -> None:
    problem, team = linear_step(12, wavelength), Team(MPI.COMM_WORLD)
    whole = build_subdomains(problem.region, np.zeros(problem.mesh.n_cells, np.int64), problem.controlled)[0]
    system = problem.system(whole, np.ones(problem.mesh.n_dofs))
    exact = float(np.trace(np.linalg.solve(dense(system.operator), dense(system.hessian))))
    found = []
    for kind, n in (("blocks", 4), ("metis", 7)):
        with Decomposed(team, problem, split(problem.mesh, kind, n), "consistent") as parts:
            step = parts.step(DualSettings("scaled"))
            found.append(estimate_degrees_of_freedom(team, parts.systems, step))
    if wavelength is None:
        # As many as unknowns, whatever the signs; a step leaves a hundredth.
        assert exact == pytest.approx(problem.mesh.n_dofs)
        assert found == pytest.approx([exact, exact], rel=0.02)
    else:
        assert exact < 0.6 * problem.mesh.n_dofs
        # Four vectors of signs: sqrt(2 / (4 exact)), some 6 % at one standard deviation.
        assert found == pytest.approx([exact, exact], rel=0.2)
        # The signs are the unknowns': another partition changes what a step may leave alone.
        assert found[1] == pytest.approx(found[0], rel=0.02)
