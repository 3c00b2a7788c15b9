"""What is shown of an image: windows of it, reduced by whole blocks or enlarged, and where they lie."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.images.binned import ArraySource
from ddic.page import image_pane
from ddic.page.image_pane import Box, ImagePane, ScreenImage, ScreenRaster

SIDE = 64
RNG = np.random.default_rng(5)
EIGHT_BIT = RNG.integers(0, 256, (SIDE, 2 * SIDE)).astype(np.uint8)


def in_memory(values: NDArray[np.generic]) -> ScreenImage:
    return ScreenImage(ArraySource(Path("memory"), values))


def whole(image: ScreenImage) -> Box:
    return -0.5, -0.5, image.source.width - 0.5, image.source.height - 0.5


def average_blocks(values: NDArray[np.generic], factor: int) -> NDArray[np.float64]:
    rows, columns = (side // factor for side in values.shape)
    blocks = values[:rows * factor, :columns * factor].astype(np.float64).reshape(rows, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(1, 3)))


def greys_of(means: NDArray[np.float64], levels: NDArray[np.generic]) -> NDArray[np.float64]:
    """From black to white, 0 to 255, between the percentiles of all levels."""
    low, high = np.percentile(levels.astype(np.float64), image_pane.CONTRAST)
    return np.asarray(255.0 * np.clip((means - low) / (high - low), 0.0, 1.0))


@pytest.mark.parametrize("factor", [1, 2, 4, 8])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_blocks_have_their_means(factor: int, kind: type) -> None:
    values = (EIGHT_BIT.astype(np.float64) * (255 if kind is np.uint16 else 1)).astype(kind)
    image = in_memory(values)
    raster = image.read(whole(image), 2 * SIDE // factor, SIDE // factor)
    assert raster.grey.shape == (SIDE // factor, 2 * SIDE // factor)
    assert raster.box == whole(image)
    # Half a level of 8 bit, to which means are rounded, and one to which they are cut.
    spread = np.ptp(np.percentile(values.astype(np.float64), image_pane.CONTRAST))
    rounding = 0.5 * 255.0 / spread if kind is np.uint8 else 0.5
    difference = raster.grey - greys_of(average_blocks(values, factor), values)
    assert np.abs(difference).max() <= 1.0 + rounding


def test_a_large_image_is_reduced_from_its_overview(monkeypatch: pytest.MonkeyPatch) -> None:
    """An overview of a quarter of the pixels; coarser windows come of that, finer ones of the image."""
    monkeypatch.setattr(image_pane, "OVERVIEW", EIGHT_BIT.size // 4)
    monkeypatch.setattr(image_pane, "BAND", 7 * 2 * SIDE)
    image = in_memory(EIGHT_BIT.astype(np.float32))
    levels = average_blocks(EIGHT_BIT, 2)
    for factor in (1, 2, 4, 16):
        raster = image.read(whole(image), 2 * SIDE // factor, SIDE // factor)
        assert raster.grey.shape == (SIDE // factor, 2 * SIDE // factor)
        # Grey levels are cut to whole ones; those of the overview scale all.
        np.testing.assert_allclose(raster.grey, greys_of(average_blocks(EIGHT_BIT, factor), levels), atol=1.001)


def test_a_raster_is_no_larger_than_the_screen_wants() -> None:
    """Of 2000 px on a screen of 760 there are 2 px to one: a raster of all pixels would be 2.6 times as wide."""
    image = ScreenImage.make_blank(2000, 2000)
    assert image.read(whole(image), 760, 760).grey.shape == (1000, 1000)


@given(x=st.floats(-30, 150), y=st.floats(-30, 90), width=st.floats(0.01, 300), zoom=st.floats(0.05, 40))
@settings(max_examples=60)
def test_the_box_is_that_of_the_pixels(x: float, y: float, width: float, zoom: float) -> None:
    """Wherever and however large: what is shown at a place is the mean of the very pixels there."""
    image = in_memory(EIGHT_BIT.astype(np.float32))
    box = (x, y, x + width, y + 0.5 * width)
    raster = image.read(box, max(round(zoom * width), 1), max(round(zoom * width / 2), 1))
    x0, y0, x1, y1 = raster.box
    # Whole pixels within the image.
    assert -0.5 <= x0 < x1 <= 2 * SIDE - 0.5
    assert -0.5 <= y0 < y1 <= SIDE - 0.5
    assert all(float(side + 0.5).is_integer() for side in raster.box)
    # All of the box that lies in the image, but for what fills no block at the far edges.
    factor = max(round(raster.pitch[0]), 1)
    if x < 2 * SIDE - 0.5 and x + width > -0.5:
        assert x0 <= max(x, -0.5)
        assert x1 >= min(x + width, 2 * SIDE - 0.5 - (factor - 1))
    means = EIGHT_BIT[round(y0 + 0.5):round(y1 + 0.5), round(x0 + 0.5):round(x1 + 0.5)].astype(float)
    if raster.pitch[0] >= 1.0:
        expected = average_blocks(means, factor)
    else:
        copies = round(1.0 / raster.pitch[0])
        expected = means.repeat(copies, axis=0).repeat(copies, axis=1)
    np.testing.assert_allclose(raster.grey, greys_of(expected, EIGHT_BIT), atol=1.001)


def test_pixels_are_seen_where_it_is_zoomed_beyond_them() -> None:
    """Five pixels on a hundred of the screen are twenty copies each, so that an overlay has the screen's resolution."""
    image = in_memory(EIGHT_BIT)
    raster = image.read((9.5, 19.5, 14.5, 24.5), 100, 100)
    assert raster.box == (9.5, 19.5, 14.5, 24.5)
    assert raster.grey.shape == (100, 100)
    assert raster.pitch == (0.05, 0.05)
    assert len(np.unique(raster.grey[:20, :20])) == 1


def test_beside_the_image_one_pixel_is_shown() -> None:
    image = in_memory(EIGHT_BIT)
    for box, corner in (((200.0, 100.0, 260.0, 130.0), (126.5, 62.5)), ((-90.0, -90.0, -30.0, -60.0), (-0.5, -0.5))):
        raster = image.read(box, 60, 30)
        assert raster.box == (*corner, corner[0] + 1.0, corner[1] + 1.0)


def test_an_image_of_one_pixel_lies_in_the_middle_of_black_and_white() -> None:
    image = in_memory(np.array([[7]], np.uint8))
    raster = image.read(whole(image), 10, 10)
    assert raster.grey.shape == (10, 10)
    assert set(raster.grey.ravel().tolist()) == {127}


def test_a_line_of_pixels_is_shown_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a line camera: it holds no block of 2 x 2, to which its overview is reduced."""
    monkeypatch.setattr(image_pane, "OVERVIEW", 64)
    image = in_memory(EIGHT_BIT[:1].astype(np.float32))
    raster = image.read(whole(image), 32, 1)
    assert raster.box == (-0.5, -0.5, 127.5, 0.5)
    means = EIGHT_BIT[:1].reshape(32, 4).mean(axis=1)
    np.testing.assert_allclose(raster.grey[0], greys_of(means, EIGHT_BIT[:1].reshape(64, 2).mean(axis=1)), atol=1.001)


@pytest.mark.filterwarnings("error")
def test_pixels_that_are_no_numbers_are_black() -> None:
    values = EIGHT_BIT.astype(np.float32)
    values[3, 5] = np.nan
    values[3, 6] = np.inf
    image = in_memory(values)
    raster = image.read(whole(image), 2 * SIDE, SIDE)
    assert (raster.grey[3, 5], raster.grey[3, 6]) == (0, 255)
    known = np.isfinite(values)
    expected = greys_of(EIGHT_BIT.astype(float), values[known])
    np.testing.assert_allclose(raster.grey[known], expected[known], atol=1.001)
    nothing = in_memory(np.full((4, 4), np.nan, np.float32))
    assert not nothing.read(whole(nothing), 4, 4).grey.any()


@pytest.mark.parametrize("ending", ["png", "tif", "bmp"])
def test_files_are_read_alike(tmp_path: Path, ending: str) -> None:
    """PNG and BMP can only be decoded whole, and are once."""
    path = tmp_path / f"image.{ending}"
    if ending == "tif":
        tifffile.imwrite(path, EIGHT_BIT)
    else:
        cv2.imwrite(str(path), EIGHT_BIT)
    image = ScreenImage.open(path)
    assert isinstance(image.source, ArraySource) == (ending != "tif")
    box = (10.5, 4.5, 50.5, 40.5)
    np.testing.assert_array_equal(image.read(box, 40, 36).grey, in_memory(EIGHT_BIT).read(box, 40, 36).grey)


def test_a_blank_image_takes_no_memory() -> None:
    """A gigapixel of which one row is kept."""
    image = ScreenImage.make_blank(40_000, 25_000)
    raster = image.read((100.0, 100.0, 400.0, 300.0), 300, 200)
    assert set(raster.grey.ravel().tolist()) == {127}


@given(box=st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(0.1, 900), st.floats(0.1, 900)),
       shape=st.tuples(st.integers(1, 30), st.integers(1, 30)))
def test_places_and_centres_are_inverse(box: Box, shape: tuple[int, int]) -> None:
    x0, y0, width, height = box
    raster = ScreenRaster(np.zeros(shape, np.uint8), (x0, y0, x0 + width, y0 + height))
    rows, columns = np.indices(shape)
    # Rounding of coordinates of some hundred pixels.
    np.testing.assert_allclose(raster.place(raster.centres), np.column_stack([columns.ravel(), rows.ravel()]),
                               atol=1e-9 * (1.0 + 900.0 / min(raster.pitch)))


def shown_by(pane: ImagePane) -> tuple[NDArray[np.uint8], Box]:
    data = pane.figure.renderers[0].data_source.data
    x, y = data["x"][0], data["y"][0]
    packed = np.ascontiguousarray(data["image"][0])
    return packed.view(np.uint8).reshape(*packed.shape, 4), (x, y, x + data["dw"][0], y + data["dh"][0])


def test_a_pane_shows_the_pixels_where_they_are() -> None:
    """Red, green, blue and opacity of the whole image, four pixels of the screen for each along its sides."""
    pane = ImagePane(in_memory(EIGHT_BIT), largest_side=8 * SIDE)
    pane.draw()
    shown, box = shown_by(pane)
    assert box == (-0.5, -0.5, 2 * SIDE - 0.5, SIDE - 0.5)
    assert pane.pitch == 0.25
    np.testing.assert_array_equal(shown[..., 0], pane.raster.grey)
    np.testing.assert_array_equal(shown[2::4, 2::4, 1], in_memory(EIGHT_BIT).read(box, 2 * SIDE, SIDE).grey)
    np.testing.assert_array_equal(shown[..., 3], 255)


def test_a_narrow_image_is_not_stretched() -> None:
    """An image of 128 x 8 px in a figure of 400 x 200 px: pixels stay square, and the image lies in the middle."""
    pane = ImagePane(in_memory(EIGHT_BIT[:8]), largest_side=400)
    x0, y0, x1, y1 = pane.box
    assert (x1 - x0) / 400 == pytest.approx((y1 - y0) / 200, rel=1e-12)
    assert (x0, x1) == (-0.5, 127.5)
    assert y0 + y1 == pytest.approx(7.0, abs=1e-12)
    pane.draw()
    assert shown_by(pane)[1] == (-0.5, -0.5, 127.5, 7.5)


def test_layers_draw_one_over_the_other_on_a_copy() -> None:
    def first(rgba: NDArray[np.uint8], raster: ScreenRaster) -> None:
        rgba[..., 0] = 10

    def second(rgba: NDArray[np.uint8], raster: ScreenRaster) -> None:
        assert (rgba[..., 0] == 10).all()
        rgba[..., 1] = 20

    pane = ImagePane(in_memory(EIGHT_BIT), [first, second])
    before = pane.raster.grey.copy()
    pane.draw()
    np.testing.assert_array_equal(shown_by(pane)[0][..., :2], np.broadcast_to([10, 20], (*before.shape, 2)))
    np.testing.assert_array_equal(pane.raster.grey, before)
