"""Calibration of a near camera from two pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ddic.calibration.near import Calibration, calibrate_near_camera
from ddic.calibration.registration import Kind
from ddic.errors import InputError
from ddic.images.camera import CameraMapping, similarity
from ddic.io.image_file import open_image
from support.two_cameras import (
    BARREL,
    FAR_SIZE,
    NEAR_SIZE,
    TILTED,
    TURNED,
    UPRIGHT,
    far_grey,
    in_memory,
    near_grey,
    noisy,
)


def error_of(found: Calibration, mapping: CameraMapping) -> np.ndarray:
    return found.mapping.to_image(found.places_far) - mapping.to_image(found.places_far)


@pytest.mark.parametrize(("mapping", "ratio", "kind"), [
    (UPRIGHT, 4.0, "translation"), (UPRIGHT, 4.5, "similarity"), (TURNED, 3.75, "similarity"),
    (TILTED, 4.4, "homography"), (BARREL, 4.0, "homography")])
def test_mapping_is_found_from_a_rough_ratio(mapping: CameraMapping, ratio: float, kind: Kind) -> None:
    far, near = in_memory(noisy(far_grey(mapping), 1)), in_memory(noisy(near_grey(), 2))
    found = calibrate_near_camera(far, near, ratio, kind, mapping.distorts)
    assert (found.far_size, found.near_size) == (FAR_SIZE, NEAR_SIZE)
    np.testing.assert_array_equal(found.places_std.shape, (5, 2))
    # Noise of two grey levels leaves 0.01 to 0.05 px; four standard deviations of ten numbers.
    assert found.places_std.max() < 0.1
    assert (np.abs(error_of(found, mapping)) < 4 * found.places_std).all()
    np.testing.assert_allclose(found.mapping.to_image(found.places_far), found.places, atol=1e-9)


def test_what_is_said_of_a_similarity() -> None:
    far, near = in_memory(far_grey(TURNED)), in_memory(near_grey())
    found = calibrate_near_camera(far, near, 4.0)
    # Without noise the error is that of the spline, 1e-3 px over 140.
    assert found.ratio == pytest.approx(4.2, abs=1e-4)
    assert found.rotation == pytest.approx(-3.0, abs=1e-3)
    np.testing.assert_allclose(found.offset, (-150.0, -105.0), atol=5e-3)
    assert found.deviation[0] <= found.deviation[1] < 2e-3
    assert calibrate_near_camera(in_memory(far_grey(TILTED)), near, 4.0).deviation[1] > 1.0
    assert found.similarity_std.shape == (4,)


def test_uncertainty_of_entries_and_of_positions_agree() -> None:
    far, near = in_memory(noisy(far_grey(TURNED), 1)), in_memory(noisy(near_grey(), 2))
    found = calibrate_near_camera(far, near, 4.0, "similarity")
    # A similarity's entries [0, 0] and [1, 1] are one number, as are [0, 1] and -[1, 0].
    np.testing.assert_allclose(found.homography_std[0, 0], found.homography_std[1, 1], rtol=1e-6)
    assert not found.homography_std[2].any()
    np.testing.assert_allclose(found.homography_std[:2, 2], found.similarity_std[2:], rtol=1e-4)


def near_field_at(x: float, y: float) -> np.ndarray:
    """A far image in which the near one's pixel (0, 0) is at (x, y)."""
    return far_grey(similarity(4.0, 0.0, (-4 * x, -4 * y)))


BLANK = np.full((FAR_SIZE[1], FAR_SIZE[0]), 7.0)


@pytest.mark.parametrize(("far", "near", "ratio", "words"), [
    (near_field_at(-20.0, 15.0), near_grey(), 4.0,
     r"lies outside far.tif in part: its corner \(0, 0\) is at \(-20.0, 15.0\)"),
    (near_field_at(90.0, 15.0), near_grey(), 4.0, "lies outside far.tif in part"),
    (near_field_at(-200.0, 15.0), near_grey(), 4.0, "was not found in far.tif: .*lies outside the far image"),
    (far_grey(UPRIGHT), near_grey(), 8.0,
     r"--ratio 8: is off by more than 15 %; .* at a ratio of 4.000: give --ratio 4"),
    (near_grey(), far_grey(UPRIGHT), 2.0, "was not found in far.tif: .*swapped"),
    (far_grey(UPRIGHT), near_grey(9), 4.0, "no common texture"),
    (BLANK, near_grey(), 4.0, "far.tif: all pixels have the grey level 7"),
    (far_grey(UPRIGHT), BLANK, 4.0, "near.tif: all pixels have the grey level 7"),
    (far_grey(UPRIGHT), near_grey(), 1.5, "cover 187 x 160 far px, more than the 130 x 110 px of far.tif"),
    (far_grey(UPRIGHT), near_grey(), 14.0, "cover only 20 x 17 far px"),
    (far_grey(UPRIGHT), near_grey(), 0.25, "--ratio 0.25: must be more than 1"),
    (far_grey(UPRIGHT), near_grey(), np.nan, "--ratio nan: must be more than 1"),
])
def test_wrong_inputs(far: np.ndarray, near: np.ndarray, ratio: float, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        calibrate_near_camera(in_memory(far, "far.tif"), in_memory(near, "near.tif"), ratio)
    assert len(error.value.problems) == 1


@pytest.mark.parametrize("ratio", [4.0, 3.5, 4.5])
@pytest.mark.real_data
def test_foam(real_data: Path, ratio: float) -> None:
    folder = real_data / "nearfar_foam"
    found = calibrate_near_camera(open_image(folder / "far_ref.tif"), open_image(folder / "near_ref.tif"), ratio)
    # The far image is the mean of 4 x 4 px, rounded to whole grey levels; its description has the mapping.
    truth = similarity(4.0, 0.0, (1.5 - 360, 1.5 - 840))
    assert np.abs(error_of(found, truth)).max() < 0.005
    assert found.ratio == pytest.approx(4.0, abs=2e-5)
    np.testing.assert_allclose(found.offset, (-358.5, -838.5), atol=0.01)
    assert found.registration.residual_std == pytest.approx(12**-0.5, rel=0.1)


@pytest.mark.real_data
def test_foam_is_not_found_in_other_pictures(real_data: Path) -> None:
    near = open_image(real_data / "openhole" / "zoom-0053_1.tif")
    with pytest.raises(InputError, match="no common texture"):
        calibrate_near_camera(open_image(real_data / "nearfar_foam" / "far_ref.tif"), near, 4.0)
