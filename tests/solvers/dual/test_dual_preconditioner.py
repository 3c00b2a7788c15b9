"""The preconditioner's local inverses and their assembly, Eq. 37-40 of [BP17]."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.errors import SingularSubdomainError
from ddic.parallel.team import Team
from ddic.solvers.dual.dual_problem import PackedSymmetric
from ddic.solvers.dual.preconditioner import (
    DualPreconditioner,
    assemble_schur,
    invert_by_blocks,
)
from support.linear import Decomposed, dense, linear_step, split


def _quasi_definite(seed: int, n: int, m: int) -> NDArray[np.float64]:
    """[[a, b], [b^T, c]] with a positive definite, c negative semi-definite of half rank, well conditioned."""
    rng = np.random.default_rng(seed)
    orthogonal = np.linalg.qr(rng.normal(size=(n, n)))[0]
    a = orthogonal @ np.diag(rng.uniform(0.5, 2.0, n)) @ orthogonal.T
    half = rng.normal(size=(m, max(m // 2, 1)))
    c = -half @ half.T - 0.5 * np.eye(m)
    b = rng.normal(size=(n, m))
    return np.block([[a, b], [b.T, c]])


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 12), m=st.integers(0, 8))
def test_block_inverse_equals_numpy(seed: int, n: int, m: int) -> None:
    schur = _quasi_definite(seed, n, m) if m else _quasi_definite(seed, n, 1)[:n, :n]
    inverse = invert_by_blocks(schur, n)
    expected = np.linalg.inv(schur)
    # Condition numbers stay below 1e3: 1e-10 is far above rounding and far below any wrong block.
    np.testing.assert_allclose(inverse, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_array_equal(inverse[:n, n:], inverse[n:, :n].T)


@pytest.mark.parametrize("wavelength", [None, 32.0])
def test_inverse_of_a_real_subdomain(wavelength: float | None) -> None:
    problem = linear_step(8, wavelength)
    with Decomposed(Team.alone(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        _, locals_ = cut.interface()
        for system, local in zip(cut.systems, locals_, strict=True):
            t, a = dense(local.trace), dense(system.operator)
            expected = t @ np.linalg.inv(a) @ t.T - np.diag(local.compliance)
            schur = assemble_schur(local)
            size = np.abs(expected).max()
            np.testing.assert_allclose(schur, expected, rtol=0, atol=1e-11 * size)
            identity = schur @ invert_by_blocks(schur, local.n_jumps)
            # Rounding times the condition number of S_s, about 1e4 here.
            np.testing.assert_allclose(identity, np.eye(len(schur)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("wavelength", [None, 32.0])
def test_inverse_of_the_first_block_is_the_primal_schur_complement(wavelength: float | None) -> None:
    # Eq. 40 of [BP17]: (S^ll)^-1 = A_bb - A_bi A_ii^-1 A_ib.
    problem = linear_step(8, wavelength)
    with Decomposed(Team.alone(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        _, locals_ = cut.interface()
        for system, local in zip(cut.systems, locals_, strict=True):
            a = dense(system.operator)
            boundary = system.subdomain.jumps.unknowns
            inside = np.setdiff1d(np.arange(len(a)), boundary)
            primal = a[np.ix_(boundary, boundary)] - a[np.ix_(boundary, inside)] @ np.linalg.solve(
                a[np.ix_(inside, inside)], a[np.ix_(inside, boundary)])
            n = local.n_jumps
            inverse = invert_by_blocks(assemble_schur(local)[:n, :n], n)
            np.testing.assert_allclose(inverse, primal, rtol=0, atol=1e-10 * np.abs(primal).max())


def test_a_block_that_is_not_definite_is_refused() -> None:
    schur = _quasi_definite(0, 4, 2)
    schur[:4, :4] *= -1
    with pytest.raises(SingularSubdomainError, match="interface problem of a subdomain is singular"):
        invert_by_blocks(schur, 4)


@pytest.mark.parallel([1, 2, 3, 4])
def test_application_sums_the_local_terms_and_is_symmetric() -> None:
    problem = linear_step(wavelength=32.0)
    with Decomposed(Team.world(), problem, split(problem.mesh, "metis", 9), "consistent") as cut:
        exchange, locals_ = cut.interface()
        inverses = [PackedSymmetric(invert_by_blocks(assemble_schur(local), local.n_jumps).astype(np.float32))
                    for local in locals_]
        context = DualPreconditioner(exchange, [local.incidence for local in locals_], inverses)
        x, y = exchange.create_vector(), exchange.create_vector()
        begin, end = x.getOwnershipRange()
        values = np.random.default_rng(0).normal(size=(2, exchange.n_global))
        x.setArray(values[0, begin:end])
        y.setArray(values[1, begin:end])
        px, py = exchange.create_vector(), exchange.create_vector()
        context.apply(None, x, px)
        context.apply(None, y, py)
        asymmetry = abs(y.dot(px) - x.dot(py)) / (x.norm() * py.norm())
        # Every local term of every rank, added up densely.
        expected = np.zeros(exchange.n_global)
        for local, inverse in zip(locals_, inverses, strict=True):
            on_interface = local.incidence.T @ values[0][exchange.ghosts]
            expected[exchange.ghosts] += local.incidence @ inverse.apply(on_interface)
        expected = cut.team.sum(expected)
        difference = np.abs(px.getArray() - expected[begin:end]).max(initial=0.0)
    # Of arrays in single precision.
    assert asymmetry <= 1e-6
    assert difference <= 1e-12 * np.abs(expected).max()
