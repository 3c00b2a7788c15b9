"""Displacement beyond a line, and residuals at pixels."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ddic.detection.refine_line import compute_residuals, evaluate_both_sides
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.structured import build_structured_mesh
from ddic.start.independent import Images
from ddic.synth.fields import Translation
from support.pictures import pair_of, source


def _images(reference: np.ndarray, deformed: np.ndarray, mask: np.ndarray | None = None,
            correction: GreyCorrection = "none") -> Images:
    return Images(source(reference, mask), source(deformed), np.ones(reference.shape, np.uint8), 3, correction)


MIDDLE = np.array([100.3, 98.7])


@given(angle=st.floats(0.0, 3.1), seed=st.integers(0, 1000))
def test_linear_sides_go_on_beyond_the_line(angle: float, seed: int) -> None:
    along, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    line = np.stack([MIDDLE - 300 * along, MIDDLE + 300 * along])
    cut = cut_mesh(build_structured_mesh((20.0, 20.0, 180.0, 180.0), 16.0), [line])
    random = np.random.default_rng(seed)
    offsets, slopes = random.normal(size=(2, 2)), 0.01 * random.normal(size=(2, 2, 2))
    of_side = [lambda x, k=k: offsets[k] + (x - MIDDLE) @ slopes[k].T for k in range(2)]
    assert cut.mesh.parts is not None
    # The line that cuts may be moved by some thousandths of a pixel to keep clear of nodes.
    cuts_at = cut.mesh.parts.lines.polylines[0][0]
    is_left = (find_points_on_own_side(cut.mesh) - cuts_at) @ normal > 0
    u = np.where(is_left[:, None], of_side[0](cut.mesh.nodes), of_side[1](cut.mesh.nodes))
    points = MIDDLE + random.uniform(-60, 60, (200, 1)) * along + random.uniform(-8, 8, (200, 1)) * normal
    left, right = evaluate_both_sides(cut, u, 0, points)
    # Shape functions reproduce linear fields inside a cell and out.
    np.testing.assert_allclose(left, of_side[0](points), atol=1e-9)
    np.testing.assert_allclose(right, of_side[1](points), atol=1e-9)


def test_residual_vanishes_at_the_right_displacement() -> None:
    pair = pair_of(Translation((1.3, -0.6)))
    pixels = np.stack(np.meshgrid(np.arange(20, 120), np.arange(30, 90)), axis=-1).reshape(-1, 2)
    u = np.full(pixels.shape, [1.3, -0.6])
    residuals = compute_residuals(_images(pair.reference, pair.deformed), pixels, u)
    at_rest = compute_residuals(_images(pair.reference, pair.deformed), pixels, 0 * u)
    # What a cubic spline misses of speckles of 5 px, hundredths of their contrast.
    assert residuals.std() < 0.03 * at_rest.std()


def test_pixels_that_leave_the_image_or_are_masked_have_none() -> None:
    pair = pair_of(Translation((0.0, 0.0)))
    mask = np.ones(pair.reference.shape, dtype=bool)
    mask[50, 60] = False
    pixels = np.array([[60, 50], [61, 50], [10, 50]])
    u = np.array([[0.0, 0.0], [0.0, 0.0], [-20.0, 0.0]])
    residuals = compute_residuals(_images(pair.reference, pair.deformed, mask), pixels, u)
    assert np.isnan(residuals).tolist() == [True, False, True]
    far = compute_residuals(_images(pair.reference, pair.deformed), pixels, u + 1e6)
    assert np.isnan(far).all()


def test_gain_and_offset_are_taken_out_where_they_are_asked_for() -> None:
    pair = pair_of(Translation((1.3, -0.6)))
    pixels = np.stack(np.meshgrid(np.arange(20, 120), np.arange(30, 90)), axis=-1).reshape(-1, 2)
    u = np.full(pixels.shape, [1.3, -0.6])
    brighter = 1.3 * pair.deformed + 20
    plain = compute_residuals(_images(pair.reference, pair.deformed), pixels, u)
    corrected = compute_residuals(_images(pair.reference, brighter, correction="global"), pixels, u)
    # Least squares take out a little of the interpolation error too.
    np.testing.assert_allclose(corrected, plain, atol=0.3 * plain.std())
