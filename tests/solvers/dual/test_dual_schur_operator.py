"""S_tot against its definition, Eq. 30-31 of [BP17]."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Interface, Weighting, interface_weights
from ddic.solvers.dual.dual_problem import DualSchurOperator
from ddic.solvers.exchange import Exchange
from support.linear import Decomposed, StepProblem, dense, linear_step, split

RANKS = [1, 2, 3, 4]
WAVELENGTH = 32.0


def _random(exchange: Exchange, seed: int) -> PETSc.Vec:
    """The same random vector on any number of ranks."""
    vector = exchange.create_vector()
    begin, end = vector.getOwnershipRange()
    vector.setArray(np.random.default_rng(seed).normal(size=exchange.n_global)[begin:end])
    return vector


def _displacement_rows(cut: Decomposed, exchange: Exchange) -> NDArray[np.bool_]:
    """Which of this rank's owned rows are jumps of displacement, from the chains of all ranks."""
    mine = [first + k for s in cut.subdomains for first, m in
            zip(s.jumps.first_row, s.jumps.multiplicity, strict=True) for k in range(m - 1)]
    everyone = np.unique(np.array(cut.team.gather_lists(mine), dtype=np.int64))
    vector = exchange.create_vector()
    begin, end = vector.getOwnershipRange()
    vector.destroy()
    return np.isin(np.arange(begin, end), everyone)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("weighting", ["consistent", "paper"])
@pytest.mark.parametrize("kind", ["blocks", "metis"])
def test_symmetric_and_quasi_definite(kind: str, weighting: Weighting) -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    with Decomposed(Team.world(), problem, split(problem.mesh, kind, 9), weighting) as cut:
        exchange, locals_ = cut.interface()
        matrix = exchange.create_matrix(DualSchurOperator(exchange, locals_))
        x, y = _random(exchange, 1), _random(exchange, 2)
        sx, sy = exchange.create_vector(), exchange.create_vector()
        matrix.mult(x, sx)
        matrix.mult(y, sy)
        asymmetry = abs(x.dot(sy) - y.dot(sx)) / (x.norm() * sy.norm())
        jumps = _displacement_rows(cut, exchange)
        energies = []
        for rows in (jumps, ~jumps):
            part = _random(exchange, 3)
            part.setArray(np.where(rows, part.getArray(), 0.0))
            matrix.mult(part, sx)
            energies.append(part.dot(sx) / part.dot(part))
    # Rounding of two products of a hundred terms.
    assert asymmetry <= 1e-12
    assert energies[0] > 0
    assert energies[1] < 0


def _definition(problem: StepProblem, parts: NDArray[np.int64],
                weighting: Weighting) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """S_tot from dense C_s, Cbar_s, Kbar_s, A_s; and which rows are jumps of displacement."""
    subdomains = build_subdomains(problem.region, parts, problem.controlled)
    n_rows = sum(s.n_owned_rows for s in subdomains)
    owners = [set(s.node_ids.tolist()) for s in subdomains]
    total = np.zeros((n_rows, n_rows))
    is_jump = np.zeros(n_rows, dtype=bool)
    for number, part in enumerate(subdomains):
        system = problem.system(part, interface_weights(part.multiplicity, weighting))
        c, c_bar = (_signed(number, part.node_ids, interface, owners, n_rows)
                    for interface in (part.jumps, part.reactions))
        is_jump |= np.abs(c).sum(axis=1) > 0
        # Row weights multiply both Cbar_s^T and Kbar_s: docs/solver.md, Weights of the interface rows.
        c_bar = c_bar * (interface_weights(part.multiplicity, weighting) * problem.scale)
        weighted = dense(system.controlled_stiffness)
        a_inverse = np.linalg.inv(dense(system.hessian) + problem.eta * weighted.T @ weighted)
        g = c + problem.eta * c_bar @ weighted
        total += g @ a_inverse @ g.T - problem.eta * c_bar @ c_bar.T
    return total, is_jump


def _signed(number: int, node_ids: NDArray[np.int64], interface: Interface, owners: list[set[int]],
            n_rows: int) -> NDArray[np.float64]:
    """C_s of one kind: row k of a chain is (copy k) - (copy k + 1), copies in the order of subdomains."""
    matrix = np.zeros((n_rows, 2 * len(node_ids)))
    for dof, first in zip(interface.unknowns, interface.first_row, strict=True):
        chain = [s for s, nodes in enumerate(owners) if int(node_ids[dof // 2]) in nodes]
        place = chain.index(number)
        if place + 1 < len(chain):
            matrix[first + place, dof] = 1.0
        if place > 0:
            matrix[first + place - 1, dof] = -1.0
    return matrix


@pytest.mark.parametrize("weighting", ["consistent", "paper"])
@pytest.mark.parametrize("kind", ["blocks", "metis"])
def test_equals_the_dense_matrix_of_the_definition(kind: str, weighting: Weighting) -> None:
    problem = linear_step(6, WAVELENGTH)
    parts = split(problem.mesh, kind, 4)
    expected, is_jump = _definition(problem, parts, weighting)
    with Decomposed(Team.alone(), problem, parts, weighting) as cut:
        exchange, locals_ = cut.interface()
        matrix = exchange.create_matrix(DualSchurOperator(exchange, locals_))
        x, y = exchange.create_vector(), exchange.create_vector()
        found = np.empty_like(expected)
        for column in range(exchange.n_global):
            x.set(0.0)
            x.setValue(column, 1.0)
            x.assemble()
            matrix.mult(x, y)
            found[:, column] = y.getArray()
    assert is_jump.any()
    assert not is_jump.all()
    # numpy's inverse of A_s (condition number about 1e4) against a Cholesky solve.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_allclose(expected, expected.T, rtol=0, atol=1e-10 * np.abs(expected).max())
    # Quasi-definite: first block positive, second negative semi-definite (to rounding).
    assert np.linalg.eigvalsh(expected[np.ix_(is_jump, is_jump)]).min() > 0
    second = np.linalg.eigvalsh(expected[np.ix_(~is_jump, ~is_jump)])
    assert second.max() <= 1e-10 * abs(second.min())
    assert second.min() < 0


@pytest.mark.parallel([2, 3, 4])
def test_product_does_not_depend_on_the_number_of_ranks() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    parts = split(problem.mesh, "metis", 9)
    products = []
    for team in (Team.alone(), Team.world()):
        with Decomposed(team, problem, parts, "consistent") as cut:
            exchange, locals_ = cut.interface()
            y = exchange.create_vector()
            DualSchurOperator(exchange, locals_).mult(PETSc.Mat(), _random(exchange, 4), y)
            products.append(np.concatenate(team.gather_lists([np.array(y.getArray())])))
    # Only the order of the sums at shared rows differs.
    np.testing.assert_allclose(products[1], products[0], rtol=0, atol=1e-13 * np.abs(products[0]).max())
