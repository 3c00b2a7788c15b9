"""A parallel sparse matrix beside the serial sum of the same blocks."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from scipy import sparse

from ddic.errors import FactorizationError
from ddic.parallel.team import Team
from ddic.solvers import exchange as spread
from ddic.solvers import petsc
from ddic.solvers.exchange import ParallelEntries
from ddic.solvers.petsc import check_petsc_size, to_petsc_integers

RANKS = (1, 2, 3, 4)
N_ROWS, N_COLUMNS, N_BLOCKS = 7, 5, 9
"""Owned by each rank; blocks that each adds."""


@pytest.fixture
def team() -> Team:
    return Team.world()


def _make_blocks(team: Team, rank: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Blocks that a rank adds, on rows and columns of all ranks; the same wherever they are made."""
    random = np.random.default_rng(rank)
    blocks = []
    for _ in range(N_BLOCKS):
        rows = random.choice(N_ROWS * team.size, 4, replace=False)
        columns = random.choice(N_COLUMNS * team.size, 3, replace=False)
        blocks.append((rows, columns, random.integers(-9, 10, (4, 3)).astype(float)))
    return blocks


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("chunk", [2**23, 20])
def test_blocks_of_all_ranks_add_up(team: Team, chunk: int) -> None:
    expected = np.zeros((N_ROWS * team.size, N_COLUMNS * team.size))
    for rank in range(team.size):
        for rows, columns, block in _make_blocks(team, rank):
            expected[np.ix_(rows, columns)] += block
    entries = ParallelEntries(team, N_ROWS, N_COLUMNS)
    with patch.object(spread, "_CHUNK", chunk):
        for number, (rows, columns, block) in enumerate(_make_blocks(team, team.rank)):
            if number % 2:
                entries.add(rows, columns, block)
            else:
                entries.add_sparse(rows, columns, sparse.csr_matrix(block))
    own = slice(N_ROWS * team.rank, N_ROWS * (team.rank + 1))
    # Whole numbers: sums in any order are exact.
    np.testing.assert_array_equal(entries.sum_owned_rows().toarray(), expected[own])


@pytest.mark.parallel(4)
def test_ranks_that_need_nothing_are_sent_nothing(team: Team) -> None:
    """Every rank adds to its own rows and to those of the next one."""
    n_held = 2
    entries = ParallelEntries(team, 10**9, 10**9)
    first = 10**9 * team.rank
    neighbour = 10**9 * ((team.rank + 1) % team.size)
    rows = np.array([first, neighbour])
    sent: dict[int, object] = {}
    exchange = Team.exchange

    def note(self: Team, items: dict[int, object]) -> dict[int, object]:
        sent.update(items)
        return exchange(self, items)

    entries.add(rows, rows, np.ones((n_held, n_held)))
    # A CSR of all rows, four thousand million of them, would take 16 GB a rank.
    held = entries._add_up(entries._blocks)
    assert held.entries.shape[0] == n_held
    small = ParallelEntries(team, 5, 5)
    rows = np.array([5 * team.rank, 5 * ((team.rank + 1) % team.size)])
    small.add(rows, rows, np.ones((n_held, n_held)))
    with patch.object(Team, "exchange", note):
        local = small.sum_owned_rows()
    assert list(sent) == [(team.rank + 1) % team.size]
    assert local.sum() == 2 * n_held


def test_numbers_too_large_for_petsc_are_refused() -> None:
    largest = petsc.LARGEST
    numbers = np.array([0, largest], dtype=np.int64)
    converted = to_petsc_integers(numbers, "unknowns")
    assert converted.tolist() == [0, largest]
    assert to_petsc_integers(np.zeros(0, np.int64), "unknowns").size == 0
    with pytest.raises(FactorizationError, match=f"unknowns: {largest + 1} is more than PETSc"):
        check_petsc_size(largest + 1, "unknowns")
    if largest < np.iinfo(np.int64).max:
        with pytest.raises(FactorizationError, match="--with-64-bit-indices"):
            to_petsc_integers(numbers + 1, "unknowns")
