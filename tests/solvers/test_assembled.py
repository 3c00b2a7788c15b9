"""The assembled step against the monolithic and the dual one, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from petsc4py import PETSc

from ddic.errors import FactorizationError, SingularSubdomainError, is_collective
from ddic.parallel.team import Team
from ddic.partition.subdomain import Weighting
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.whole_system import AssembledStep
from support.linear import Decomposed, linear_step, one_domain_solution, split
from support.textureless import corner, without_texture

RANKS = [1, 2, 3, 4]
# Two factorisations of one matrix, whose condition number is about 1e4 at this cut-off wavelength.
SAME = 1e-10
# What a Krylov residual of 1e-12 leaves (test_dual_step).
SAME_AS_DUAL = 1e-9
WAVELENGTH = 32.0


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [None, WAVELENGTH])
@pytest.mark.parametrize(("kind", "n_subdomains"), [("blocks", 4), ("blocks", 9), ("metis", 16)])
@pytest.mark.parametrize("weighting", ["consistent", "paper"])
def test_assembled_equals_monolithic(weighting: Weighting, kind: str, n_subdomains: int,
                                     wavelength: float | None) -> None:
    problem = linear_step(wavelength=wavelength)
    parts = split(problem.mesh, kind, n_subdomains)
    reference = one_domain_solution(problem, parts, weighting)
    with Decomposed(Team.world(), problem, parts, weighting) as cut:
        step = AssembledStep(cut.team, cut.systems, 0.0)
        result = cut.solve(step)
        step.destroy()
        error = cut.relative_error(result.dq, reference)
    assert error <= SAME
    assert (result.krylov_iterations, result.error) == (0, 0.0)


@pytest.mark.parallel(RANKS)
def test_copies_that_differ_become_the_field_of_the_dual_step() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 9), "consistent") as cut:
        rngs = [np.random.default_rng(s.index) for s in cut.subdomains]
        q = cut.field(r.normal(size=len(d)) for r, d in zip(rngs, cut.numbers, strict=True))
        b = cut.field(problem.b[d] / s.multiplicity for d, s in zip(cut.numbers, cut.subdomains, strict=True))
        dual = cut.step(DualSettings("scaled", 1e-12, 3000)).solve(q, b)
        step = AssembledStep(cut.team, cut.systems, 0.0)
        assembled = step.solve(q, b)
        step.destroy()
    largest = max(float(np.abs(x - y).max()) for x, y in zip(assembled.dq, dual.dq, strict=True))
    assert largest <= SAME_AS_DUAL * max(float(np.abs(y).max()) for y in dual.dq)


@pytest.mark.parallel([1, 2, 4])
@pytest.mark.parametrize("wavelength", [None, WAVELENGTH])
def test_a_region_that_nothing_holds_is_named(wavelength: float | None) -> None:
    problem = linear_step(wavelength=wavelength)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 9), "consistent") as cut:
        systems = without_texture(cut, corner)
        with pytest.raises(SingularSubdomainError, match=r"column 1\d\d, row 1\d\d.*too little") as e:
            AssembledStep(cut.team, systems, 1e-9 * problem.mean_diagonal)
    assert is_collective(e.value)


@pytest.mark.parallel([1, 2])
def test_want_of_memory_is_not_taken_for_want_of_texture() -> None:
    problem = linear_step(48, WAVELENGTH)
    options = PETSc.Options()
    # One MiB a rank for MUMPS: the 4802 unknowns have 2 MB of entries before any fill.
    options.setValue("assembled_mat_mumps_icntl_23", "1")
    try:
        with (Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut,
              pytest.raises(FactorizationError, match="memory") as e):
            AssembledStep(cut.team, cut.systems, 0.0)
    finally:
        options.delValue("assembled_mat_mumps_icntl_23")
    assert is_collective(e.value)
