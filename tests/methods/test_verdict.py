"""Whether a measurement is believed does not depend on where the specimen has moved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic

Image = NDArray[np.uint8]
SIZE, MARGIN = 260, 140
BOX = (MARGIN, MARGIN, MARGIN + SIZE, MARGIN + SIZE)
SHIFT = (100, -80)


def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = points.T
    return np.column_stack([0.8 * np.sin(x / 70) * np.cos(y / 90), 0.6 * np.cos(x / 80)])


@pytest.fixture(scope="module")
def pair() -> tuple[Image, Image]:
    side = SIZE + 2 * MARGIN
    return ddic.make_synthetic_pair(move, (side, side), noise=1.0, seed=3)


def cover(image: Image, low: int, high: int, grey: int = 30) -> Image:
    covered = image.copy()
    covered[low:high, low:high] = grey
    return covered


def measure(reference: Image, deformed: Image, shift: tuple[int, int], **options: Any) -> ddic.Result:
    moved = np.roll(deformed, shift[::-1], (0, 1))
    return ddic.measure((reference, moved), ddic.structured_mesh(BOX, 20), **options)


@pytest.mark.parametrize("method", ["conjugate_gradient", "dual"])
@pytest.mark.parametrize("wavelength", [None, 100])
def test_a_moved_specimen_is_measured_as_finely_as_one_at_rest(pair: tuple[Image, Image], method: str,
                                                               wavelength: int | None) -> None:
    options: dict[str, Any] = {"solver": {"method": method} | ({"subdomains": 4} if method == "dual" else {})}
    if wavelength:
        options["regularization"] = {"cut_off_wavelength": wavelength}
    at_rest, moved = (measure(*pair, shift, **options).displacement for shift in ((0, 0), SHIFT))
    # The images are the same to the last bit: both come as near to one field as the tolerance on every node says.
    assert np.abs(moved - SHIFT - at_rest).max() < 1e-3


@pytest.mark.parametrize("shift", [(0, 0), SHIFT])
def test_what_is_refused_at_rest_is_refused_when_moved(pair: tuple[Image, Image], shift: tuple[int, int]) -> None:
    covered = cover(pair[1], MARGIN + 60, MARGIN + 140)
    with pytest.raises(ddic.ConvergenceError, match=r"largest dq = .* in subdomain 0"):
        measure(pair[0], covered, shift, solver={"method": "conjugate_gradient"},
                correlation={"spoilt_pixels": "keep"})


@pytest.mark.parametrize("shift", [(0, 0), SHIFT])
def test_what_regularization_carries_through_is_marked(pair: tuple[Image, Image], shift: tuple[int, int]) -> None:
    covered = cover(pair[1], MARGIN + 60, MARGIN + 140)
    result = measure(pair[0], covered, shift, solver={"method": "conjugate_gradient"},
                     regularization={"cut_off_wavelength": 120})
    cells = result.mesh.connectivity.reshape(-1, 4)
    centres = result.mesh.nodes[cells].mean(axis=1)
    doubtful = result.fields["doubtful"].astype(bool)
    inside = ((centres > MARGIN + 70) & (centres < MARGIN + 130)).all(axis=1)
    assert doubtful[inside].all()
    errors = np.linalg.norm(result.displacement - shift - move(result.mesh.nodes), axis=1)[cells].mean(axis=1)
    assert errors[~doubtful].max() < 0.3
    assert doubtful.mean() < 0.25
