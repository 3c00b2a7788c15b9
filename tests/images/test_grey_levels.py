from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import check_finite, check_noise, find_saturation, measure_grey_levels
from ddic.io.image_file import open_image


def test_grey_levels_do_not_depend_on_the_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = np.random.default_rng(5).integers(0, 256, (37, 20), dtype=np.uint8)
    pixels[4, :5] = 255
    source = ArraySource(Path("memory"), pixels, saturation=255.0)
    whole = measure_grey_levels(source)
    monkeypatch.setattr("ddic.images.grey_levels.BAND_PIXELS", {2: 80})
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
        check_finite(image, ArraySource(Path("mask"), mask))
    mask[30, 40:42] = False
    check_finite(image, ArraySource(Path("mask"), mask))


def test_not_finite_pixels_are_found_in_later_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = np.zeros((9, 4))
    pixels[7, 2] = np.nan
    source = ArraySource(Path("memory"), pixels)
    monkeypatch.setattr("ddic.images.grey_levels.BAND_PIXELS", {2: 8})
    with pytest.raises(InputError, match=r"1 pixel.*\(2, 7\)"):
        check_finite(source)


@pytest.mark.parametrize(("dtype", "highest", "factor", "expected"), [
    ("uint8", 255, 1, 255), ("uint8", 200, 1, 255),
    # 12 bits in 16, below and above; not where one level is higher, or where lower bits are in use.
    ("uint16", 4095, 1, 4095), ("uint16", 4095, 16, 65520), ("uint16", 4096, 1, 65535), ("uint16", 65520, 1, 65535),
    ("uint16", 1023, 1, 1023), ("uint16", 16383, 4, 65532), ("uint16", 65535, 1, 65535), ("int16", 4095, 1, 4095),
    ("int64", 255, 1, 255)])
def test_saturation_is_that_of_the_bits_in_use(dtype: str, highest: int, factor: int, expected: int) -> None:
    values = np.random.default_rng(0).integers(0, highest, (40, 30))
    values[[3, 30], [5, 20]] = highest
    # So that lower bits are in use where the factor is 1.
    values[0, 0] = 1
    image = ArraySource(Path("memory"), (factor * values).astype(dtype), float(np.iinfo(dtype).max))
    assert find_saturation(image) == expected
    found = measure_grey_levels(image)
    assert found.saturation == expected
    assert found.n_saturated == (2 if factor * highest == expected else 0)


def test_float_images_do_not_saturate() -> None:
    image = ArraySource(Path("memory"), np.ones((4, 5), np.float32), None)
    assert find_saturation(image) is None
    assert measure_grey_levels(image).n_saturated == 0


def test_colour_images_saturate_where_all_colours_do() -> None:
    image = ArraySource(Path("memory"), np.full((4, 5), 255.0, np.float32), 255.0)
    assert find_saturation(image) == 255
    assert measure_grey_levels(image).n_saturated == 20


@pytest.mark.parametrize("dtype", ["uint16", "int32", "int64"])
def test_noise_of_wide_integers_is_that_of_levels_of_16_bits(dtype: str) -> None:
    pixels = np.arange(0, 25600, 100, dtype=dtype).reshape(16, 16)
    source = ArraySource(Path("memory"), pixels, float(np.iinfo(dtype).max))
    check_noise(source, 0.01)
    check_noise(source, 150.0)
    with pytest.raises(InputError, match=r"noise = 0\.001"):
        check_noise(source, 0.001)
