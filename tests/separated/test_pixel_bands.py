"""Residuals and integrals over bands of rows, against the cells' kernels and plain sums."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.correlation import read_correlation
from ddic.images.spline import PADDING
from ddic.images.sub_image import GROWTH, DeformedSubImage
from ddic.images.window import Window
from ddic.mesh.structured import build_structured_mesh
from ddic.separated.field import SeparatedField, scale_modes
from ddic.separated.pixel_bands import FramePixels
from ddic.synth.fields import Translation
from support.cases import WAVES
from support.pictures import pair_of, source
from support.separated import build_zero_field, frame_of, lines, random_field

REGION = (20.0, 24.0, 164.0, 152.0)
SHAPE = (128, 144)


def _translation(shift: tuple[float, float], size: float = 16.0) -> SeparatedField:
    along_x, along_y = lines(REGION, size)
    x = np.ones((1, 2, along_x.n_nodes)) * np.array(shift)[None, :, None]
    return scale_modes(along_x, along_y, x, np.ones((1, 2, along_y.n_nodes)))


def _whole(frame: FramePixels, name: str) -> np.ndarray:
    return np.concatenate([getattr(band, name) for band in frame.bands]).astype(float)


@pytest.mark.parametrize("degree", [3, 5])
def test_residual_is_that_of_the_cells_kernel(degree: int) -> None:
    frame = frame_of(WAVES, REGION, 16.0, degree=degree)
    field = random_field(*lines(REGION, 16.0), 3)
    sums = frame.evaluate(field)
    mesh = build_structured_mesh(REGION, 16.0)
    pair = pair_of(WAVES)
    correlation = read_correlation(mesh, source(pair.reference), degree)
    deformed = DeformedSubImage(source(pair.deformed), degree)
    image = correlation.compute_residual_image(deformed, field.at(mesh.nodes).ravel())
    # Residuals are stored as float32, of up to 200 grey levels.
    assert np.abs(_whole(frame, "residual") - image[:SHAPE[0], :SHAPE[1]]).max() <= 4e-5
    expected = correlation.compute_residual(deformed, field.at(mesh.nodes).ravel()).sums.values
    assert np.allclose(sums.values, expected, rtol=1e-9, atol=1e-3)


def test_integrals_are_sums_over_pixels() -> None:
    frame = frame_of(WAVES, REGION, 16.0)
    frame.evaluate(build_zero_field(*lines(REGION, 16.0)))
    a, b, r = (_whole(frame, name) for name in ("by_x", "by_y", "residual"))
    random = np.random.default_rng(0)
    v, w = random.normal(size=(2, SHAPE[0]))
    expected = [(a * a * (v * v)[:, None]), a * b * (v * w)[:, None], b * b * (w * w)[:, None], r * a * v[:, None],
                r * b * w[:, None]]
    found = frame.integrate_over_y(np.stack([v, w]))
    # float64 sums of 128 float32 numbers.
    assert np.allclose(found, [image.sum(axis=0) for image in expected], rtol=1e-12, atol=1e-8)
    v, w = random.normal(size=(2, SHAPE[1]))
    expected = [a * a * v * v, a * b * v * w, b * b * w * w, r * a * v, r * b * w]
    assert np.allclose(frame.integrate_over_x(np.stack([v, w])), [image.sum(axis=1) for image in expected],
                       rtol=1e-12, atol=1e-8)


@pytest.mark.parametrize("along_y", [False, True])
def test_pairs_contain_the_integrals_of_one_mode(along_y: bool) -> None:
    frame = frame_of(WAVES, REGION, 16.0)
    frame.evaluate(build_zero_field(*lines(REGION, 16.0)))
    functions = np.random.default_rng(1).normal(size=(2, 2, SHAPE[1] if along_y else SHAPE[0]))
    pairs, single = frame.integrate_pairs(functions, along_y=along_y)
    integrate = frame.integrate_over_x if along_y else frame.integrate_over_y
    for k in range(2):
        one = integrate(functions[k])
        found = [pairs[2 * k, 2 * k], pairs[2 * k, 2 * k + 1], pairs[2 * k + 1, 2 * k + 1], single[2 * k],
                 single[2 * k + 1]]
        assert np.allclose(found, one, rtol=1e-11, atol=1e-7)
    assert np.allclose(pairs, pairs.swapaxes(0, 1), rtol=1e-13, atol=1e-9)


def test_window_grows_where_a_sample_of_the_pixels_does_not_show_it() -> None:
    frame = frame_of(Translation((0.0, 0.0)), REGION, 1.0)
    along_x, along_y = lines(REGION, 1.0)
    # A function that moves one column far: none of the pixels that are looked at first.
    x = np.zeros((1, 2, along_x.n_nodes))
    x[0, 0, 100] = 20.0
    field = scale_modes(along_x, along_y, x, np.ones((1, 2, along_y.n_nodes)))
    far = frame_of(Translation((0.0, 0.0)), REGION, 1.0)
    far.deformed.hold(far.reference.extent)
    assert np.array_equal(frame.evaluate(field).values, far.evaluate(field).values)


def test_no_more_of_the_deformed_image_is_read_than_pixels_are_displaced_to() -> None:
    frame = frame_of(Translation((0.0, 0.0)), (100.0, 110.0, 164.0, 160.0), 16.0)
    frame.evaluate(build_zero_field(frame.reference.along_x, frame.reference.along_y))
    held = frame.deformed.get_spline(Window(110, 120, 120, 130)).window
    # The region, the spline's padding and GROWTH on every side.
    assert held == Window(100, 110, 164, 160).grow(PADDING[3] + GROWTH).clip(192, 192)


def test_pixels_out_of_the_image_leave_integrals_and_come_back() -> None:
    frame = frame_of(Translation((0.0, 0.0)), REGION, 16.0)
    inside = frame.evaluate(_translation((1.5, 0.0)))
    assert inside.n_pixels == SHAPE[0] * SHAPE[1]
    out = frame.evaluate(_translation((60.0, 0.0)))
    # The last pixel centre is at 191: columns from 132 on leave the image.
    assert out.n_pixels == SHAPE[0] * (132 - 20)
    assert not _whole(frame, "by_x")[:, 112:].any()
    assert not _whole(frame, "residual")[:, 112:].any()
    again = frame.evaluate(_translation((1.5, 0.0)))
    assert np.array_equal(again.values, inside.values)
    assert _whole(frame, "by_x")[:, 112:].any()


def test_masks_of_both_images_take_pixels_out() -> None:
    mask = np.ones((192, 192), bool)
    mask[60:80, 70:90] = False
    zero = build_zero_field(*lines(REGION, 16.0))
    for masks in ({"mask": mask}, {"deformed_mask": mask}):
        frame = frame_of(WAVES, REGION, 16.0, **masks)
        sums = frame.evaluate(zero)
        by_x, residual = _whole(frame, "by_x"), _whole(frame, "residual")
        assert not by_x[36:56, 50:70].any()
        assert not residual[36:56, 50:70].any()
        # And the cubic's taps around.
        assert 400 < SHAPE[0] * SHAPE[1] - sums.n_pixels < 24 * 24 + 1
        image = np.concatenate([rows for _, rows in frame.compute_residual_rows(zero, 1.0, 0.0)])
        assert np.isnan(image[36:56, 50:70]).all()
        assert np.isfinite(image).sum() == sums.n_pixels
