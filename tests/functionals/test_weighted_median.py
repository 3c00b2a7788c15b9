"""A median of values that count more or less."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ddic.functionals.weighted_median import find_weighted_median

PAIRS = st.lists(st.tuples(st.floats(-5, 5), st.integers(0, 6)), min_size=1)


@given(PAIRS.filter(lambda pairs: any(n for _, n in pairs)))
def test_it_is_the_lower_median_of_repeated_values(pairs: list[tuple[float, int]]) -> None:
    values, weights = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
    repeated = np.sort(np.repeat(values, weights.astype(int)))
    assert find_weighted_median(values, weights) == repeated[(len(repeated) - 1) // 2]
