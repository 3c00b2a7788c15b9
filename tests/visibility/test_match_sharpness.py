"""References blurred as much as a frame is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.images.binned import SMALLEST
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import Camera
from ddic.problem.residual_model import ResidualModel
from ddic.synth.fields import Translation
from ddic.visibility.match_reference import UNLIKE, match_sharpness
from ddic.visibility.seen_cells import TypicalCell
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh

Image = NDArray[np.float64]
MESH = square_mesh(24.0, 232.0)
AT_REST = [np.zeros(MESH.n_dofs)]
SHARP = pair_of(Translation((0.0, 0.0)), 256, 8).reference.astype(np.float64)
UNALIKE = {0: TypicalCell(2 * UNLIKE * 1600.0, 1600.0, 200.0, 1.0, 0.0)}


def match(deformed: Image, reference: MaskedSource | None = None, typical: dict[int, TypicalCell] | None = None,
          ) -> tuple[ResidualModel, ResidualModel, tuple[str, ...]]:
    sharp = source(SHARP) if reference is None else reference
    model = model_of(sharp, source(deformed), MESH)
    camera = Camera(0, sharp, None, None)  # type: ignore[arg-type]
    matched, notes = match_sharpness(model, (camera,), AT_REST, UNALIKE if typical is None else typical)
    return model, matched, notes


def blur(along: float, across: float, degrees: float, image: Image = SHARP) -> Image:
    """By rotating the kernel's covariance."""
    t = np.deg2rad(degrees)
    axes = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
    inverse = np.linalg.inv(axes @ np.diag([along**2, max(across, SMALLEST)**2]) @ axes.T)
    offsets = np.stack(np.meshgrid(np.arange(-30, 31), np.arange(-30, 31)), axis=-1).astype(float)
    weights = np.exp(-0.5 * np.einsum("yxi,ij,yxj->yx", offsets, inverse, offsets))
    return np.asarray(cv2.filter2D(image, -1, weights / weights.sum(), borderType=cv2.BORDER_REFLECT_101))


@pytest.mark.parametrize("degrees", [0.0, 90.0, 30.0, -50.0])
@pytest.mark.parametrize(("along", "across"), [(2.0, 0.0), (4.0, 1.0)])
def test_the_blur_of_a_frame_is_found(along: float, across: float, degrees: float) -> None:
    _, matched, (note,) = match(blur(along, across, degrees))
    ((camera, found),) = matched.blurs
    assert camera == 0
    # From slopes of a hundred speckles across: some per cent.
    assert np.hypot(found.along, SMALLEST) == pytest.approx(along, rel=0.12)
    assert found.across == pytest.approx(across, abs=0.35)
    assert abs((np.rad2deg(found.direction) - degrees + 90) % 180 - 90) <= 4
    assert "less sharp" in note


@pytest.mark.parametrize("change", [lambda g: g, lambda g: 0.7 * g + 20.0], ids=["as bright", "dim"])
def test_the_residual_is_gone_and_the_gradient_is_that_of_the_frame(change: object) -> None:
    assert callable(change)
    blurred = blur(3.0, 0.0, 0.0)
    model, matched, notes = match(change(blurred))
    assert len(notes) == 1
    before, after = (m.views[0][0].correlation.reference for m in (model, matched))
    window = before.window
    truth = blurred[window.y0:window.y1, window.x0:window.x1]
    # Grey levels of 255 in float32, and a blur found to some per cent, of speckle of 40 grey levels.
    assert np.abs(before.values - truth).std() > 15
    assert np.abs(after.values - truth).std() < 2.0
    assert np.abs(after.slopes[0, 3:-3, 3:-3] - np.gradient(truth, axis=1)[3:-3, 3:-3]).std() < 1.0
    assert after.usable is before.usable
    assert after.window == before.window


@pytest.mark.parametrize("name", ["sharp", "dim", "sharper", "noisy"])
def test_a_frame_that_is_as_sharp_changes_nothing(name: str) -> None:
    noise = np.random.default_rng(0).normal(0.0, 8.0, SHARP.shape)
    frames = {"sharp": SHARP, "dim": 0.5 * SHARP + 30.0, "sharper": SHARP, "noisy": SHARP + noise}
    reference = source(blur(1.0, 1.0, 0.0)) if name == "sharper" else None
    model, matched, notes = match(frames[name], reference)
    assert matched is model
    assert notes == ()


def test_a_small_residual_is_not_looked_at() -> None:
    like = {0: TypicalCell(0.5 * UNLIKE * 1600.0, 1600.0, 200.0, 1.0, 0.0)}
    model, matched, notes = match(blur(3.0, 0.0, 0.0), typical=like)
    assert matched is model
    assert notes == ()


def test_what_is_masked_in_the_reference_stays_so() -> None:
    mask = np.ones(SHARP.shape, dtype=bool)
    mask[100:140, 90:130] = False
    model, matched, _ = match(blur(3.0, 0.0, 0.0), source(SHARP, mask))
    before, after = (m.views[0][0] for m in (model, matched))
    assert after.n_pixels == before.n_pixels < MESH.n_cells * 256
    np.testing.assert_array_equal(after.count_pixels(), before.count_pixels())
