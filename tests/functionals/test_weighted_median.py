"""A median of values that count more or less."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ddic.functionals.grey_statistics import FEW, find_value_at, find_weighted_median

PAIRS = st.lists(st.tuples(st.floats(-5, 5), st.integers(0, 6)), min_size=1)


@given(PAIRS.filter(lambda pairs: any(n for _, n in pairs)))
def test_it_is_the_lower_median_of_repeated_values(pairs: list[tuple[float, int]]) -> None:
    values, weights = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
    repeated = np.sort(np.repeat(values, weights.astype(int)))
    assert find_weighted_median(values, weights) == repeated[(len(repeated) - 1) // 2]


@given(st.integers(FEW, 10 * FEW), st.integers(0, 2**32 - 1), st.floats(0.01, 1.0))
def test_of_many_it_is_what_sorting_all_finds(n: int, seed: int, share: float) -> None:
    generator = np.random.default_rng(seed)
    # Many alike, some of no weight.
    values, weights = generator.integers(0, n, n) / 7.0, generator.integers(0, 257, n).astype(float)
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    expected = values[order][np.searchsorted(reached, share * reached[-1])]
    assert find_value_at(values, weights, share * weights.sum()) == expected
