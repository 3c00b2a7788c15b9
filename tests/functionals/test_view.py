"""A camera's functional 1/2 w sum (f - g(phi(T(X + u))))^2 in the unknowns, against differences of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ddic.kinematics.pose import Motion, Rig, pose, seen_mesh
from numpy.typing import NDArray
from scipy import ndimage

from ddic.functionals.correlation import read_correlation
from ddic.functionals.view import View
from ddic.images.binned import ArraySource
from ddic.images.camera import CameraMapping, identity, similarity
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from support.random_meshes import grid_mesh
from support.slow_correlation import cell_pixels

SIDE = 150
DEGREE = 3
MAPPINGS = {
    "similarity": similarity(4.0, 7.0, (-1180.0, -860.0)),
    "homography": CameraMapping(np.array([[3.9, -0.2, -1120.0], [0.3, 4.1, -960.0], [3e-5, -2e-5, 1.0]])),
}
EVERY_MAPPING = pytest.mark.parametrize("mapping", MAPPINGS.values(), ids=MAPPINGS)
EVERY_MOTION = pytest.mark.parametrize("motion", ["none", "translation", "rigid"])
WEIGHT = 0.37


def picture(seed: int = 0, smoothing: float = 4.0) -> NDArray[np.float64]:
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(SIDE, SIDE)), smoothing)
    # Sixty-fourths of a grey level are float32 numbers, and so are they with a whole number added.
    return np.asarray(np.round(64 * (128 + 40 * noise / noise.std())) / 64)


def source(values: NDArray[np.float64]) -> MaskedSource:
    return MaskedSource(ArraySource(Path("memory"), values.astype(np.float32), None))


def view_of(mapping: CameraMapping, motion: Motion, f: NDArray[np.float64], g: NDArray[np.float64],
            n_more: int = 0) -> View:
    """A mesh of 4 x 3 cells in the middle of the image, seen by a camera."""
    middle = mapping.to_specimen(np.array([[SIDE / 2, SIDE / 2]]))[0]
    mesh = grid_mesh(4, 3, (5.0, 5.0), origin=(middle[0] - 10.0, middle[1] - 7.5), seed=2, jitter=0.1)
    placed = pose(Rig(mapping, motion, middle, 20.0), mesh.nodes, WEIGHT, n_more)
    part = read_correlation(seen_mesh(mesh, placed), source(f), DEGREE)
    return View(part, DeformedSubImage(source(g), DEGREE), 1, placed)


def functional(view: View, g: NDArray[np.float64]) -> Callable[[NDArray[np.float64]], float]:
    """1/2 w sum (f - g)^2 pixel by pixel, g by scipy's spline, as a function of the unknowns."""
    placed = view.pose
    assert placed is not None
    cells = cell_pixels(view.correlation)
    f = np.concatenate([cell.f for cell in cells])
    positions = np.concatenate([np.column_stack([cell.x, cell.y]) for cell in cells])
    shapes = np.zeros((len(f), len(placed.nodes)))
    for rows, cell in zip(np.split(np.arange(len(f)), np.cumsum([len(c.x) for c in cells])[:-1]), cells, strict=True):
        shapes[rows[:, None], cell.nodes] = cell.shapes
    coefficients = ndimage.spline_filter(g, DEGREE, mode="mirror")

    def value(q: NDArray[np.float64]) -> float:
        at = positions + shapes @ placed.displacement(q).reshape(-1, 2)
        moved = ndimage.map_coordinates(coefficients, at.T[::-1], order=DEGREE, mode="mirror", prefilter=False)
        return 0.5 * placed.weight * float(((f - moved) ** 2).sum())

    return value


def n_unknowns(view: View) -> int:
    assert view.pose is not None
    return int(view.pose.tangent.shape[1])


def some_directions(n: int, n_shifts: int) -> list[NDArray[np.float64]]:
    """Two random directions, and each unknown of the motion."""
    rng = np.random.default_rng(5)
    return [*rng.normal(size=(2, n)), *np.eye(n)[n - n_shifts:]]


@EVERY_MAPPING
@EVERY_MOTION
def test_b_is_minus_the_gradient_where_the_images_slopes_agree(mapping: CameraMapping, motion: Motion) -> None:
    # g = f + 9 has grad g = grad f, so that at rest b, which takes grad f for grad g, is exact whatever f - g.
    f = picture()
    g = f + 9.0
    view = view_of(mapping, motion, f, g)
    n = n_unknowns(view)
    phi = functional(view, g)
    residual = view.residual(np.zeros(n))
    b, by_node = view.right_hand_side(residual), view.correlation.assemble_right_hand_side(residual)
    assert view.pose is not None
    for direction in some_directions(n, view.pose.rig.n_shifts):
        step = 1e-4
        slope = (phi(step * direction) - phi(-step * direction)) / (2 * step)
        # grad f and coefficients are float32 (6e-8); what a motion of all nodes leaves of their terms is small.
        scale = WEIGHT * float(np.abs(by_node) @ np.abs(view.pose.tangent @ direction))
        assert b @ direction == pytest.approx(-slope, abs=1e-6 * scale)


@EVERY_MAPPING
@EVERY_MOTION
def test_m_is_the_second_derivative_where_the_images_agree(mapping: CameraMapping, motion: Motion) -> None:
    f = picture()
    view = view_of(mapping, motion, f, f)
    n = n_unknowns(view)
    phi = functional(view, f)
    hessian = view.hessian().toarray()
    assert view.pose is not None
    for direction in some_directions(n, view.pose.rig.n_shifts):
        direction = direction / np.abs(direction).max()  # noqa: PLW2901
        step = 1e-3
        # Phi(0) = 0 and Phi'(0) = 0: the mean of both sides leaves the fourth derivative times step^2.
        energy = (phi(step * direction) + phi(-step * direction)) / 2
        # The spline returns f to float32 rounding, 1e-5 grey of the 1e-2 that a step of 4e-3 px changes.
        assert energy == pytest.approx(0.5 * step**2 * direction @ hessian @ direction, rel=1e-3)


@EVERY_MAPPING
@EVERY_MOTION
def test_m_pixel_by_pixel(mapping: CameraMapping, motion: Motion) -> None:
    view = view_of(mapping, motion, picture(), picture())
    assert view.pose is not None
    tangent = view.pose.tangent.toarray()
    rows = []
    for cell in cell_pixels(view.correlation):
        slopes = np.einsum("pa,pi->pai", cell.shapes, cell.gradient).reshape(len(cell.x), -1)
        rows.append(slopes @ tangent[(2 * cell.nodes[:, None] + np.arange(2)).ravel()])
    jacobian = np.concatenate(rows)
    hessian = view.hessian().toarray()
    # Rounding of sums over some thousand pixels.
    np.testing.assert_allclose(hessian, WEIGHT * jacobian.T @ jacobian, atol=1e-11 * np.abs(hessian).max())
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-14 * np.abs(hessian).max())


@EVERY_MAPPING
def test_the_columns_of_the_motion_are_m_times_a_rigid_displacement(mapping: CameraMapping) -> None:
    view = view_of(mapping, "rigid", picture(), picture())
    assert view.pose is not None
    nodes, rig = view.pose.nodes, view.pose.rig
    rigid = np.zeros((nodes.size, 3))
    rigid[0::2, 0] = rigid[1::2, 1] = 1.0
    rigid[0::2, 2], rigid[1::2, 2] = -(nodes - rig.centre)[:, 1] / rig.length, (nodes - rig.centre)[:, 0] / rig.length
    m = view.hessian().toarray()
    n = nodes.size
    size = np.abs(m).max()
    np.testing.assert_allclose(m[:n, n:], m[:n, :n] @ rigid, atol=1e-12 * size)
    np.testing.assert_allclose(m[n:, n:], rigid.T @ m[:n, :n] @ rigid, atol=1e-10 * size)
    b = view.right_hand_side(view.residual(np.zeros(n + 3)))
    np.testing.assert_allclose(b[n:], rigid.T @ b[:n], atol=1e-10 * np.abs(b).sum())


def test_weight_multiplies_m_and_b() -> None:
    f, g = picture(), picture(1)
    view = view_of(MAPPINGS["homography"], "rigid", f, g)
    assert view.pose is not None
    heavy = replace(view, pose=replace(view.pose, weight=4 * WEIGHT))
    zero = np.zeros(n_unknowns(view))
    b, m = view.right_hand_side(view.residual(zero)), view.hessian().toarray()
    np.testing.assert_allclose(heavy.right_hand_side(heavy.residual(zero)), 4 * b, rtol=1e-15)
    np.testing.assert_allclose(heavy.hessian().toarray(), 4 * m, rtol=1e-15)


def test_what_another_camera_has_leaves_m_and_b() -> None:
    f, g = picture(), picture(1)
    alone, more = (view_of(MAPPINGS["similarity"], "none", f, g, n_more=n) for n in (0, 3))
    n = n_unknowns(alone)
    q = np.random.default_rng(1).normal(size=n + 3)
    np.testing.assert_array_equal(more.hessian().toarray()[:n, :n], alone.assemble_hessian().toarray())
    assert not more.hessian().toarray()[n:].any()
    b = more.right_hand_side(more.residual(q))
    np.testing.assert_array_equal(b[:n], alone.right_hand_side(alone.residual(q[:n])))
    assert not b[n:].any()


@pytest.mark.parametrize("posed", [False, True], ids=["no pose", "identity"])
def test_the_one_camera_of_a_plain_case_is_its_correlation(posed: bool) -> None:
    mesh = grid_mesh(4, 4, (16.0, 16.0), origin=(40.0, 40.0), seed=2, jitter=0.1)
    f, g = picture(), picture(1)
    part, deformed = read_correlation(mesh, source(f), DEGREE), DeformedSubImage(source(g), DEGREE)
    still = pose(Rig(identity(), "none", np.zeros(2), 1.0), mesh.nodes, 1.0)
    view = View(part, deformed, 0, still if posed else None)
    q = np.random.default_rng(1).normal(size=mesh.n_dofs)
    expected, found = part.compute_residual(deformed, q, all_kinds=True), view.residual(q, all_kinds=True)
    # phi(X + u) - phi(X) of the identity rounds positions of 1e2 px.
    close = {"rtol": 1e-12, "atol": 1e-9} if posed else {"rtol": 0.0, "atol": 0.0}
    np.testing.assert_allclose(view.displacement(q), q, **close)
    assert view.displaced_window(q) == part.displaced_window(q)
    np.testing.assert_allclose(view.hessian().toarray(), part.assemble_hessian().toarray(), **close)
    np.testing.assert_allclose(found.cell_sums.values, expected.cell_sums.values, rtol=close["rtol"], atol=1e-6)
    np.testing.assert_allclose(view.right_hand_side(found, 0.9, 3.0), part.assemble_right_hand_side(expected, 0.9, 3.0),
                               rtol=close["rtol"], atol=1e-6 if posed else 0.0)
    np.testing.assert_allclose(view.residual_image(q, 0.9, 3.0), part.compute_residual_image(deformed, q, 0.9, 3.0),
                               atol=1e-4 if posed else 0.0)


def test_pixels_that_leave_the_deformed_image_leave_m() -> None:
    f = picture()
    view = view_of(MAPPINGS["similarity"], "translation", f, f)
    q = np.zeros(n_unknowns(view))
    # 20 px of the specimen are 80 px of an image that ends 40 px beyond the mesh.
    q[-2] = 20.0
    seen = view.seen_from(q)
    total = view.correlation.n_usable_pixels
    expected = int(np.isfinite(view.residual_image(q)).sum())
    assert 0 < expected < total
    assert seen.correlation.n_usable_pixels == expected
    assert view.seen_from(np.zeros_like(q)).correlation.n_usable_pixels == total
    lost = view.hessian().toarray() - seen.hessian().toarray()
    # What is taken away is a sum of squares.
    assert np.linalg.eigvalsh(lost).min() >= -1e-12 * np.abs(lost).max()
