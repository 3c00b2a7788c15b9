from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from ddic.errors import InputError
from ddic.images.grey_levels import check_finite, measure_grey_levels
from ddic.io.image_file import open_image


def test_grey_levels_do_not_depend_on_the_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = np.random.default_rng(5).integers(0, 256, (37, 20), dtype=np.uint8)
    pixels[4, :5] = 255
    source = SimpleNamespace(path=Path("memory"), width=20, height=37, saturation=255.0,
                             read=lambda w: pixels[w.y0:w.y1, w.x0:w.x1])
    whole = measure_grey_levels(source)
    monkeypatch.setattr("ddic.images.grey_levels.BAND_PIXELS", 80)
    banded = measure_grey_levels(source)
    assert whole.n_saturated == banded.n_saturated == np.count_nonzero(pixels == 255)
    # Sums in another order: a few roundings of float64.
    assert banded.gradient_energy == pytest.approx(whole.gradient_energy, rel=1e-13)
    assert banded.mean == pytest.approx(pixels.mean(), rel=1e-13)
    assert (banded.lowest, banded.highest) == (pixels.min(), 255)


def test_not_finite_pixels_are_counted_and_located_unless_masked(tmp_path: Path) -> None:
    pixels = np.zeros((61, 83), np.float32)
    pixels[10, 20], pixels[30, 40], pixels[30, 41] = np.nan, np.inf, -np.inf
    tifffile.imwrite(tmp_path / "f.tif", pixels)
    image = open_image(tmp_path / "f.tif")
    with pytest.raises(InputError, match=r"f\.tif: 3 pixel.*\(20, 10\)"):
        check_finite(image)
    mask = np.ones(pixels.shape, bool)
    mask[10, 20] = False
    with pytest.raises(InputError, match=r"2 pixel.*\(40, 30\)"):
        check_finite(image, mask)
    mask[30, 40:42] = False
    check_finite(image, mask)


def test_not_finite_pixels_are_found_in_later_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = np.zeros((9, 4))
    pixels[7, 2] = np.nan
    source = SimpleNamespace(path=Path("memory"), width=4, height=9, saturation=None,
                             read=lambda w: pixels[w.y0:w.y1, w.x0:w.x1])
    monkeypatch.setattr("ddic.images.grey_levels.BAND_PIXELS", 8)
    with pytest.raises(InputError, match=r"1 pixel.*\(2, 7\)"):
        check_finite(source)
