"""Owned numbers and the ghosts of neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.solvers.exchange import Exchange

RANKS = [1, 2, 3, 4]
OWNED = (4, 0, 3, 2)
"""Numbers that each rank owns; rank 1 owns none, as a rank whose chains all belong to others does."""


def _needed(n: int, rank: int) -> list[NDArray[np.int64]]:
    """Two unsorted, overlapping lists of numbers, different on each rank."""
    rng = np.random.default_rng(rank)
    return [rng.permutation(n)[: n // 2 + 1].astype(np.int64), rng.permutation(n)[: n // 3].astype(np.int64)]


@pytest.mark.parallel(RANKS)
def test_ghosts_see_the_owners_values() -> None:
    team = Team.world()
    n = sum(OWNED[: team.size])
    needed = _needed(n, team.rank)
    exchange = Exchange(team, OWNED[team.rank], needed)
    owned = exchange.create_vector()
    begin, end = owned.getOwnershipRange()
    owned.setArray(100.0 + np.arange(begin, end))
    ghosts = exchange.fetch_ghosts(owned)
    assert exchange.n_global == n
    assert end - begin == OWNED[team.rank]
    np.testing.assert_array_equal(exchange.ghosts, np.unique(np.concatenate(needed)))
    np.testing.assert_array_equal(ghosts, 100.0 + exchange.ghosts)


@pytest.mark.parallel(RANKS)
def test_contributions_add_up_at_the_owner_and_replace_what_was_there() -> None:
    team = Team.world()
    n = sum(OWNED[: team.size])
    exchange = Exchange(team, OWNED[team.rank], _needed(n, team.rank))
    owned = exchange.create_vector()
    owned.set(1e6)
    exchange.add_to_owners((team.rank + 1.0) * (1.0 + exchange.ghosts), owned)
    begin, end = owned.getOwnershipRange()
    expected = np.zeros(n)
    for rank in range(team.size):
        ghosts = np.unique(np.concatenate(_needed(n, rank)))
        expected[ghosts] += (rank + 1.0) * (1.0 + ghosts)
    # Sums of small integers are exact.
    np.testing.assert_array_equal(owned.getArray(), expected[begin:end])


@pytest.mark.parallel(RANKS)
def test_the_two_directions_are_adjoint() -> None:
    team = Team.world()
    n = sum(OWNED[: team.size])
    exchange = Exchange(team, OWNED[team.rank], _needed(n, team.rank))
    rng = np.random.default_rng(10 + team.rank)
    x, y = exchange.create_vector(), exchange.create_vector()
    x.setArray(rng.normal(size=OWNED[team.rank]))
    w = rng.normal(size=len(exchange.ghosts))
    exchange.add_to_owners(w, y)
    on_ghosts = team.sum(float(w @ exchange.fetch_ghosts(x)))
    # A few dozen terms of order 1.
    assert on_ghosts == pytest.approx(y.dot(x), abs=1e-12)


@pytest.mark.parallel(RANKS)
def test_nothing_to_exchange() -> None:
    exchange = Exchange(Team.world(), 0, [])
    owned = exchange.create_vector()
    exchange.add_to_owners(np.zeros(0), owned)
    assert exchange.n_global == 0
    assert len(exchange.fetch_ghosts(owned)) == 0
