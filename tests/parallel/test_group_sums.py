"""Sums over groups of terms do not depend on who has which."""

from __future__ import annotations

from functools import reduce
from itertools import pairwise
from random import Random

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ddic.parallel.team import merge_groups, sum_groups, sum_neighbours


@given(n_terms=st.integers(1, 40), cuts=st.lists(st.integers(0, 40), max_size=6), order=st.randoms())
def test_sum_is_the_same_to_the_last_bit(n_terms: int, cuts: list[int], order: Random) -> None:
    terms = list(np.random.default_rng(0).normal(size=(n_terms, 10)))
    edges = [0, *sorted(min(cut, n_terms) for cut in cuts), n_terms]
    groups = [sum_neighbours(first, terms[first:stop]) for first, stop in pairwise(edges)]
    order.shuffle(groups)
    on_one_rank = sum_groups(sum_neighbours(0, terms))
    assert np.array_equal(sum_groups(reduce(merge_groups, groups)), on_one_rank)
    # And it is the sum.
    assert np.allclose(on_one_rank, np.sum(terms, axis=0), rtol=0, atol=1e-13)


def test_who_has_many_terms_sends_few_groups() -> None:
    # Terms 3 to 1000: at most a group a level at either end.
    groups = sum_neighbours(3, np.ones((998, 1)))
    assert len(groups) <= 2 * 10
    assert sum(values[0] for values in groups.values()) == 998
