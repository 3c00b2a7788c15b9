"""Bands of rows."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.separated.field import N_BANDS, LineElements, divide_rows


@pytest.mark.parametrize("height", [5, 16, 100, 1001])
def test_bands_hold_every_row_once(height: int) -> None:
    bands = divide_rows(LineElements(np.array([7.0, 7.0 + height])))
    assert len(bands) == min(N_BANDS, height)
    assert [row for band in bands for row in band] == list(range(7, 7 + height))
