"""The matching preconditioner: symmetric, positive definite, and hardly slowed down by a long cut-off wavelength."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ddic.parallel.team import Team
from ddic.partition.subdomain import Weighting
from ddic.solvers.matching import ROUGH, MatchingPreconditioner, find_polynomial, find_roots, multiply_blocks
from ddic.solvers.petsc import PetscStack
from ddic.solvers.whole_system import ConjugateGradientStep, WholeSystem
from support.linear import Decomposed, Kind, linear_step, split

RANKS = [1, 2, 3]


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("kind", "weighting"), [("Q4", "consistent"), ("Hex8", "consistent"), ("Tet4", "paper")])
def test_it_is_symmetric_and_positive_definite(kind: Kind, weighting: Weighting) -> None:
    problem = linear_step(6, 64.0, kind)
    team = Team.world()
    with (Decomposed(team, problem, split(problem.mesh, "metis", 4), weighting) as cut,
          PetscStack() as stack):
        whole = stack.keep(WholeSystem(team, cut.systems))
        preconditioner = stack.keep(MatchingPreconditioner(team, whole))
        rng = np.random.default_rng(team.rank)
        one, other, of_one, of_other = (stack.keep(whole.exchange.create_vector()) for _ in range(4))
        for vector in (one, other):
            vector.setArray(rng.standard_normal(whole.n_owned))
        preconditioner.apply(None, one, of_one)
        preconditioner.apply(None, other, of_other)
        energies = one.dot(of_one), other.dot(of_other)
        assert min(energies) > 0
        # Relative to the product of both norms in which it is symmetric, to rounding of some thousand products.
        assert abs(one.dot(of_other) - other.dot(of_one)) <= 1e-11 * np.sqrt(np.prod(energies))


def test_iterations_hardly_grow_with_the_cut_off_wavelength() -> None:
    counts: dict[str, list[int]] = {"diagonal": [], "matching": []}
    for wavelength in (32.0, 96.0):
        problem = linear_step(12, wavelength, "Hex8")
        with Decomposed(Team.alone(), problem, split(problem.mesh, "blocks", 1), "consistent") as cut:
            for name, precondition in (("diagonal", None), ("matching", MatchingPreconditioner)):
                with PetscStack() as stack:
                    step = stack.keep(ConjugateGradientStep(cut.team, cut.systems, 1e-6, 3000, precondition))
                    counts[name].append(cut.solve(step).krylov_iterations)
    # Three times as long a wave: nine times the root of the condition number, of which the region's size leaves half.
    assert counts["diagonal"][1] > 3 * counts["diagonal"][0]
    assert counts["matching"][1] < 1.5 * counts["matching"][0]
    assert counts["matching"][1] < 60


@pytest.mark.parametrize("extension", [0.5, 3.0, 8.0, 30.0])
def test_the_polynomial_inverts_what_is_left_at_the_surface(extension: float) -> None:
    mass = np.linspace(0.0, 1.0, 101)
    energy = mass + 2 * ROUGH / (1 - mass + ROUGH / extension)
    ratio = np.polynomial.polynomial.polyval(mass, find_polynomial(extension))**2 * energy
    # A preconditioner that is off by a factor of 1.7 at worst costs a third of the iterations.
    assert ratio.min() > 1 / 1.7
    assert ratio.max() < 1.2


def test_all_controlled_leaves_no_surface() -> None:
    assert find_polynomial(0.0) == [1.0]
    problem = linear_step(6, 32.0, "Hex8")
    everywhere = replace(problem, controlled=np.ones(problem.mesh.n_dofs, dtype=bool))
    with (Decomposed(Team.alone(), everywhere, split(problem.mesh, "blocks", 1), "consistent") as cut,
          PetscStack() as stack):
        exact, found = (cut.solve(stack.keep(ConjugateGradientStep(cut.team, cut.systems, 1e-10, 3000, precondition)))
                        for precondition in (None, MatchingPreconditioner))
    # Of two solutions to 1e-10 each, of a condition number of some hundred.
    np.testing.assert_allclose(found.dq[0], exact.dq[0], atol=1e-8 * np.abs(exact.dq[0]).max())


def test_roots_of_blocks_square_to_them_and_are_raised_where_nothing_is_seen() -> None:
    rng = np.random.default_rng(0)
    factors = rng.standard_normal((5, 3, 3))
    blocks = factors @ factors.swapaxes(1, 2)
    blocks[0] = 0.0
    # A tenth of the mean is 1e-4.
    roots = find_roots(blocks, 1e-3)
    values = rng.standard_normal(15)
    twice = multiply_blocks(roots, multiply_blocks(roots, values)).reshape(5, 3)
    # Eigenvalues of the others are far above the least.
    assert twice[1:] == pytest.approx(np.einsum("nij,nj->ni", blocks, values.reshape(5, 3))[1:], rel=1e-10)
    assert roots[0] == pytest.approx(1e-2 * np.eye(3))
