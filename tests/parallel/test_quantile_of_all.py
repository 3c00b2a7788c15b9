"""A weighted quantile of values that are spread over ranks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.functionals.grey_statistics import find_value_at, find_weighted_median
from ddic.parallel import distribution
from ddic.parallel.distribution import find_quantile_of_all
from ddic.parallel.team import Team

SIZES = st.floats(-1e3, 1e3, allow_subnormal=False)


@given(pairs=st.lists(st.tuples(SIZES, st.integers(0, 5)), min_size=1, max_size=60))
def test_narrowing_finds_the_same_value_as_looking_at_all(pairs: list[tuple[float, int]]) -> None:
    values, weights = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(distribution, "GATHERED", 2)
        patch.setattr(distribution, "N_INTERVALS", 3)
        found = find_quantile_of_all(Team.alone(), values, weights)
    assert found == (find_weighted_median(values, weights) if weights.any() else None)


def test_a_few_enormous_values_do_not_hide_the_others() -> None:
    # The first interval of 1024 holds all but one value.
    values = np.concatenate([np.random.default_rng(0).normal(size=50_001), [1e30]])
    assert find_quantile_of_all(Team.alone(), values, np.ones(len(values))) == np.sort(values)[len(values) // 2 - 1]


@pytest.mark.parallel([1, 2, 3, 4])
def test_every_number_of_ranks_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distribution, "GATHERED", 50)
    team, random = Team.world(), np.random.default_rng(1)
    values, weights = random.lognormal(size=1000), random.integers(0, 300, 1000).astype(float)
    # The last rank has nothing, unless it is the only one.
    owner = random.integers(0, max(team.size - 1, 1), 1000)
    mine = owner == team.rank
    assert find_quantile_of_all(team, values[mine], weights[mine]) == find_weighted_median(values, weights)
    expected = find_value_at(values, weights, 0.9 * weights.sum())
    assert find_quantile_of_all(team, values[mine], weights[mine], 0.9) == expected
    assert find_quantile_of_all(team, np.zeros(0), np.zeros(0)) is None
