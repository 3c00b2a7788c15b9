"""Sums over bands do not depend on who has which."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from ddic.separated.band_sums import N_BANDS, divide_rows, sum_groups, sum_neighbours
from ddic.separated.field import LineElements


@pytest.mark.parametrize("n_bands", [16, 11, 1])
@pytest.mark.parametrize("n_ranks", [2, 3, 4, 5])
def test_sum_is_the_same_to_the_last_bit(n_bands: int, n_ranks: int) -> None:
    arrays = list(np.random.default_rng(0).normal(size=(n_bands, 1000)))
    edges = np.linspace(0, n_bands, n_ranks + 1).round().astype(int)
    groups = [sum_neighbours(first, arrays[first:stop]) for first, stop in pairwise(edges)]
    on_one_rank = sum_groups([sum_neighbours(0, arrays)])
    assert np.array_equal(sum_groups(groups), on_one_rank)
    # And it is the sum.
    assert np.allclose(on_one_rank, np.sum(arrays, axis=0), rtol=0, atol=1e-13)


@pytest.mark.parametrize("height", [5, 16, 100, 1001])
def test_bands_hold_every_row_once(height: int) -> None:
    bands = divide_rows(LineElements(np.array([7.0, 7.0 + height])))
    assert len(bands) == min(N_BANDS, height)
    assert [row for band in bands for row in band] == list(range(7, 7 + height))
