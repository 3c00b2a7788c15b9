"""Subdomains spread over ranks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI

from ddic.errors import InputError, is_on_all_ranks
from ddic.parallel.distribution import distribute, owners
from ddic.parallel.team import Team
from ddic.partition.connectivity import build_subdomains
from support.linear import linear_step, split

RANKS = [1, 2, 3, 4]


@given(n_ranks=st.integers(1, 40), more=st.integers(0, 100))
def test_owners_are_contiguous_balanced_and_complete(n_ranks: int, more: int) -> None:
    ranges = owners(n_ranks + more, n_ranks)
    assert [s for part in ranges for s in part] == list(range(n_ranks + more))
    sizes = [len(part) for part in ranges]
    assert len(sizes) == n_ranks
    assert min(sizes) >= 1
    assert max(sizes) - min(sizes) <= 1


def test_more_ranks_than_subdomains_are_refused() -> None:
    with pytest.raises(InputError, match=r"5 MPI ranks for 4 subdomains.*at most 4.*solver\.subdomains"):
        owners(4, 5)


@pytest.mark.parallel(RANKS)
def test_every_rank_gets_its_own_subdomains_whole() -> None:
    team = Team(MPI.COMM_WORLD)
    problem = linear_step(wavelength=32.0)
    everything = build_subdomains(problem.mesh, split(problem.mesh, "metis", 9), problem.controlled)
    mine = distribute(team, lambda: everything)
    assert [s.index for s in mine] == list(owners(9, team.size)[team.rank])
    for s in mine:
        np.testing.assert_array_equal(s.node_ids, everything[s.index].node_ids)
        np.testing.assert_array_equal(s.mesh.nodes, everything[s.index].mesh.nodes)
        np.testing.assert_array_equal(s.reaction.first_row, everything[s.index].reaction.first_row)


@pytest.mark.parallel([2, 3, 4])
def test_too_few_subdomains_are_an_error_on_all_ranks() -> None:
    team = Team(MPI.COMM_WORLD)
    problem = linear_step()
    whole = np.zeros(problem.mesh.n_cells, dtype=np.int64)
    with pytest.raises(InputError, match="MPI ranks for 1 subdomains") as caught:
        distribute(team, lambda: build_subdomains(problem.mesh, whole, problem.controlled))
    assert is_on_all_ranks(caught.value)
