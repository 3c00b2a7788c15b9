"""A large image is looked at in bands of it, a bounded number of pixels."""

from __future__ import annotations

import pytest

from ddic.images import grey_levels
from ddic.images.grey_levels import list_spread_bands
from ddic.images.window import Window


@pytest.mark.parametrize(("most", "n_bands"), [(10_000, 10), (2_000, 2), (1, 1)])
def test_bands_hold_no_more_pixels_than_are_looked_at(most: int, n_bands: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grey_levels, "BAND_PIXELS", {2: 1000})
    monkeypatch.setattr(grey_levels, "MOST_LOOKED_AT", most)
    window = Window((5, 7), (105, 107))
    bands = list(list_spread_bands(window))
    assert len(bands) == n_bands
    assert all(window.contains(band) and band.n_pixels == 1000 for band in bands)
    # Evenly: from the first row on, as far apart as they are few.
    assert [band.y0 for band in bands] == [7 + number * (100 // n_bands) for number in range(n_bands)]
