"""What binned images say of the error of a displacement."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.mesh.structured import build_structured_mesh
from ddic.start import predicted_error
from ddic.start.binned_pair import BinnedPair
from ddic.start.predicted_error import predict_error
from ddic.synth.fields import Translation
from support.pictures import pair_of, source, square_mesh

SIDE = 384
MESH = square_mesh(80.0, 304.0)
SHIFT = (7.0, -4.0)


def _pair(change: tuple[float, float] = (1.0, 0.0)) -> BinnedPair:
    pair = pair_of(Translation(SHIFT), SIDE, 8)
    gain, offset = change
    return BinnedPair(source(pair.reference), source(gain * pair.deformed.astype(np.float32) + offset), 1)


def _off_by(x: float, y: float = 0.0) -> predicted_error.PredictedError:
    return predict_error(_pair(), MESH, lambda points: np.tile(SHIFT, (len(points), 1)) - (x, y))


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.3, 0.0), (0.0, -0.8), (1.0, 1.0)])
def test_errors_of_a_part_of_a_speckle_are_told(off: tuple[float, float]) -> None:
    found = _off_by(*off)
    # One step of optical flow with central differences: speckles of 5 px make it a third wrong or so.
    assert np.median(found.error) == pytest.approx(np.hypot(*off), rel=0.35, abs=0.02)
    assert found.measure_share_beyond(2 * np.hypot(*off) + 0.1) == 0.0


def test_larger_errors_are_out_of_reach() -> None:
    found = _off_by(20.0)
    assert found.measure_share_beyond(np.inf) > 0.95
    # Unrelated speckles; 196 squares of some ten speckles each.
    assert abs(found.coefficient) < 0.1


def test_a_piece_of_the_region_shows() -> None:
    def displace(points: np.ndarray) -> np.ndarray:
        return np.asarray(SHIFT + np.where(points[:, :1] > 248, 15.0, 0.0))

    # A quarter of the region, its edge through squares.
    assert predict_error(_pair(), MESH, displace).measure_share_beyond(1.0) == pytest.approx(0.25, abs=0.08)


def test_gain_and_offset_do_not_count() -> None:
    plain = _off_by(0.4)
    changed = predict_error(_pair((0.5, 60.0)), MESH, lambda points: np.tile(SHIFT, (len(points), 1)) - (0.4, 0.0))
    np.testing.assert_allclose(changed.correlation, plain.correlation, atol=1e-4)
    np.testing.assert_allclose(changed.error, plain.error, rtol=1e-4)


def test_squares_displaced_out_of_the_image_count_as_wrong() -> None:
    found = predict_error(_pair(), MESH, lambda points: np.full(points.shape, 1000.0))
    assert found.measure_share_beyond(1.0) == 1.0
    assert found.coefficient == 0.0


def test_blank_images_say_nothing() -> None:
    flat = source(np.full((SIDE, SIDE), 100.0, dtype=np.float32))
    found = predict_error(BinnedPair(flat, flat, 1), MESH, np.zeros_like)
    assert found.n_blocks.size == 0
    assert (found.coefficient, found.measure_share_beyond(1.0)) == (1.0, 0.0)


def test_a_few_squares_stand_for_many(monkeypatch: pytest.MonkeyPatch) -> None:
    all_of_them = _off_by(0.5)
    monkeypatch.setitem(predicted_error.MOST_SQUARES, 2, 50)
    drawn = _off_by(0.5)
    assert len(drawn.error) == 50 < len(all_of_them.error)
    assert set(drawn.error) <= set(all_of_them.error)
    assert np.median(drawn.error) == pytest.approx(np.median(all_of_them.error), rel=0.1)


def test_blocks_are_counted_in_pixels() -> None:
    mesh = build_structured_mesh((40.0, 40.0, 150.0, 150.0), 10)
    pair = _pair()
    coarse = BinnedPair(pair.reference, pair.deformed, 4)
    # The same images as if each pixel were a block of 4: displacements and errors are 4 times as large.
    scaled = build_structured_mesh((161.5, 161.5, 601.5, 601.5), 40)
    fine = predict_error(pair, mesh, lambda points: np.tile(SHIFT, (len(points), 1)) - (0.5, 0.0))
    found = predict_error(coarse, scaled, lambda points: 4 * (np.tile(SHIFT, (len(points), 1)) - (0.5, 0.0)))
    np.testing.assert_allclose(found.error, 4 * fine.error, rtol=1e-9)
