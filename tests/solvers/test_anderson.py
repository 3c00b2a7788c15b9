"""Anderson mixing on fixed-point problems whose solutions are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.solvers.gauss_newton import DEPTH, LEAST_SHARE, AndersonMixing
from support.fields import plain_field

Array = NDArray[np.float64]
N = 40
SLOW = 5
"""Unknowns that a step brings nearer only slowly: no more than are mixed."""

ROUNDING = np.sqrt(LEAST_SHARE)
"""Of errors, where a linear problem is solved: normal equations square what is left out as dependent."""


class Linear:
    """Steps of a constant M where the true Jacobian is A: dq = M^-1 A (q* - q), q* = solution."""

    def __init__(self, n_slow: int = SLOW) -> None:
        random = np.random.default_rng(2)
        self.solution = random.normal(size=N)
        shares = np.ones(N)
        # Of what is missing, a step gives 8 to 30 % there, or too much.
        shares[:n_slow] = [0.08, 1.7, 0.15, 0.3, 1.45, 0.22, 0.5][:n_slow]
        mix = np.eye(N) + 0.2 * random.normal(size=(N, N)) / np.sqrt(N)
        self.step = mix @ np.diag(shares) @ np.linalg.inv(mix)

    def correct(self, q: Array) -> Array:
        return np.asarray(self.step @ (self.solution - q))


def iterate(problem: Linear, mixing: AndersonMixing, n: int) -> list[float]:
    """Errors after each of n iterations from zero."""
    q, errors = np.zeros(N), []
    for _ in range(n):
        q, = mixing.advance(plain_field(q), plain_field(problem.correct(q)))
        errors.append(float(np.linalg.norm(q - problem.solution)))
    return errors


def test_the_first_iteration_is_that_of_gauss_newton() -> None:
    problem = Linear()
    q, dq = np.zeros(N), problem.correct(np.zeros(N))
    np.testing.assert_array_equal(AndersonMixing([np.ones(N)]).advance(plain_field(q), plain_field(dq))[0], dq)


@pytest.mark.parametrize("n_slow", [1, 3, SLOW])
def test_a_linear_problem_ends_after_as_many_iterations_as_krylovs(n_slow: int) -> None:
    # M^-1 A has 1 and n_slow other eigenvalues: GMRES needs n_slow + 1 of its directions, and mixing one step more
    # than its residual is known.
    errors = iterate(Linear(n_slow), AndersonMixing([np.ones(N)]), n_slow + 2)
    assert errors[-1] <= ROUNDING * errors[0]
    assert errors[-3] > 100.0 * ROUNDING * errors[0]


def test_more_slow_directions_than_are_kept_still_come_down() -> None:
    problem = Linear(7)
    mixed = iterate(problem, AndersonMixing([np.ones(N)]), 20)
    q, n_plain = np.zeros(N), 0
    while np.linalg.norm(q - problem.solution) > mixed[-1]:
        q, n_plain = q + problem.correct(q), n_plain + 1
    # The slowest, of 8 % an iteration, takes 28 a digit by itself.
    assert n_plain > 80


def test_what_was_learnt_is_forgotten_where_corrections_grow() -> None:
    mixing = AndersonMixing([np.ones(N)])
    iterate(Linear(), mixing, 4)
    q = np.random.default_rng(7).normal(size=N)
    # Of another part of the way: far larger than the last.
    far = 10.0 * np.random.default_rng(8).normal(size=N)
    np.testing.assert_array_equal(mixing.advance(plain_field(q), plain_field(far))[0], q + far)
    # From there on it learns anew, from the change between these two on.
    assert not np.array_equal(mixing.advance(plain_field(q + far), plain_field(0.5 * far))[0], q + 1.5 * far)


def test_a_mixing_that_forgot_is_a_new_one() -> None:
    mixing = AndersonMixing([np.ones(N)])
    iterate(Linear(), mixing, 4)
    mixing.forget()
    assert iterate(Linear(), mixing, 5) == iterate(Linear(), AndersonMixing([np.ones(N)]), 5)


def test_corrections_that_do_not_change_are_no_division_by_zero() -> None:
    mixing = AndersonMixing([np.ones(N)])
    q = np.zeros(N)
    for _ in range(DEPTH + 2):
        q, = mixing.advance(plain_field(q), plain_field(np.ones(N)))
        assert np.isfinite(q).all()
    mixing.forget()
    for _ in range(3):
        q, = mixing.advance(plain_field(q), plain_field(np.zeros(N)))
        assert np.isfinite(q).all()


def test_unknowns_of_no_weight_are_mixed_as_the_others_ask() -> None:
    # A camera's motion moves no node of the specimen's frame.
    weights = np.ones(N)
    weights[30:] = 0.0
    errors = iterate(Linear(), AndersonMixing([weights]), SLOW + 2)
    assert errors[-1] <= ROUNDING * errors[0]


@pytest.mark.parallel([1, 3])
def test_subdomains_that_share_unknowns_mix_as_the_whole_on_any_number_of_ranks() -> None:
    # Four subdomains of 13 unknowns, of which neighbours share four; copies count half each.
    pieces = [np.arange(9 * k, 9 * k + 13) for k in range(4)]
    multiplicity = np.bincount(np.concatenate(pieces), minlength=N)
    problem, whole = Linear(), AndersonMixing([np.ones(N)])

    def follow(team: Team) -> list[Array]:
        own = split_evenly(np.ones(4), team.size)[team.rank]
        mixing = AndersonMixing([1.0 / multiplicity[pieces[k]] for k in own])
        q, of_whole = plain_field(*(np.zeros(13) for _ in own), team=team), np.zeros(N)
        for _ in range(6):
            # Each subdomain's corrections are those of the whole, as a linear step's are.
            dq = problem.correct(of_whole)
            of_whole, = whole.advance(plain_field(of_whole), plain_field(dq))
            q = mixing.advance(q, q.with_parts(dq[pieces[k]] for k in own))
            for of_subdomain, k in zip(q, own, strict=True):
                np.testing.assert_allclose(of_subdomain, of_whole[pieces[k]], atol=1e-9)
        whole.forget()
        return team.gather_lists(q)

    together, alone = follow(Team.world()), follow(Team.alone())
    # Sums run over subdomains in their order, whoever owns them.
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_array_equal(one, other)
