"""A camera's functional 1/2 w sum (f - g(phi(T(X + u))))^2 in the unknowns, against differences of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from ddic.functionals.correlation import read_correlation
from ddic.functionals.view import FrameView, View
from ddic.images.binned import ArraySource
from ddic.images.camera import CameraMapping, identity, similarity
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.kinematics.camera import CameraKinematics, CameraSetup, MotionKind, place_before_camera
from ddic.kinematics.kinematics import Kinematics
from ddic.kinematics.nodal import NodalKinematics
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


def view_of(mapping: CameraMapping, motion: MotionKind, f: NDArray[np.float64], g: NDArray[np.float64],
            n_others: int = 0) -> FrameView:
    """A mesh of 4 x 3 cells in the middle of the image, seen by a camera; n_others: unknowns of another's motion."""
    middle = mapping.to_specimen(np.array([[SIDE / 2, SIDE / 2]]))[0]
    mesh = grid_mesh(4, 3, (5.0, 5.0), origin=(middle[0] - 10.0, middle[1] - 7.5), seed=2, jitter=0.1)
    setup = CameraSetup(mapping, motion, middle, 20.0)
    field = NodalKinematics(mesh, np.arange(mesh.n_dofs))
    placed = place_before_camera(field, setup, mesh.n_dofs + np.arange(setup.n_motion_unknowns + n_others))
    part = read_correlation(placed.mesh, source(f), DEGREE)
    return View(part, placed, camera=1, weight=WEIGHT).open_frame(DeformedSubImage(source(g), DEGREE))


def camera_of(frame_view: FrameView) -> CameraKinematics:
    placed = frame_view.kinematics
    assert isinstance(placed, CameraKinematics)
    return placed


def hessian_of(frame_view: FrameView) -> NDArray[np.float64]:
    """M in the unknowns."""
    view = frame_view
    return np.asarray(view.project(view.assemble_hessian()).toarray())


def functional(frame_view: FrameView, g: NDArray[np.float64]) -> Callable[[NDArray[np.float64]], float]:
    """1/2 w sum (f - g)^2 pixel by pixel, g by scipy's spline, as a function of the unknowns."""
    view = frame_view
    cells = cell_pixels(view.correlation)
    f = np.concatenate([cell.f for cell in cells])
    positions = np.concatenate([np.column_stack([cell.x, cell.y]) for cell in cells])
    shapes = np.zeros((len(f), view.kinematics.mesh.n_nodes))
    for rows, cell in zip(np.split(np.arange(len(f)), np.cumsum([len(c.x) for c in cells])[:-1]), cells, strict=True):
        shapes[rows[:, None], cell.nodes] = cell.shapes
    coefficients = ndimage.spline_filter(g, DEGREE, mode="mirror")

    def value(q: NDArray[np.float64]) -> float:
        at = positions + shapes @ view.kinematics.displacement(q).reshape(-1, 2)
        moved = ndimage.map_coordinates(coefficients, at.T[::-1], order=DEGREE, mode="mirror", prefilter=False)
        return 0.5 * view.weight * float(((f - moved) ** 2).sum())

    return value


def some_directions(frame_view: FrameView) -> list[NDArray[np.float64]]:
    """Two random directions, and each unknown of the motion."""
    rng = np.random.default_rng(5)
    placed = camera_of(frame_view)
    n = placed.n_unknowns
    return [*rng.normal(size=(2, n)), *np.eye(n)[n - placed.setup.n_motion_unknowns:]]


@EVERY_MAPPING
@EVERY_MOTION
def test_b_is_minus_the_gradient_where_the_images_slopes_agree(mapping: CameraMapping, motion: MotionKind) -> None:
    # g = f + 9 has grad g = grad f, so that at rest b, which takes grad f for grad g, is exact whatever f - g.
    f = picture()
    g = f + 9.0
    seen = view_of(mapping, motion, f, g)
    placed = camera_of(seen)
    phi = functional(seen, g)
    residual = seen.compute_residual(np.zeros(placed.n_unknowns))
    b = seen.assemble_right_hand_side(residual)
    by_node = seen.correlation.assemble_right_hand_side(residual)
    for direction in some_directions(seen):
        step = 1e-4
        slope = (phi(step * direction) - phi(-step * direction)) / (2 * step)
        # grad f and coefficients are float32 (6e-8); what a motion of all nodes leaves of their terms is small.
        scale = WEIGHT * float(np.abs(by_node) @ np.abs(placed.tangent @ direction))
        assert b @ direction == pytest.approx(-slope, abs=1e-6 * scale)


@EVERY_MAPPING
@EVERY_MOTION
def test_m_is_the_second_derivative_where_the_images_agree(mapping: CameraMapping, motion: MotionKind) -> None:
    f = picture()
    seen = view_of(mapping, motion, f, f)
    phi = functional(seen, f)
    hessian = hessian_of(seen)
    for direction in some_directions(seen):
        direction = direction / np.abs(direction).max()  # noqa: PLW2901
        step = 1e-3
        # Phi(0) = 0 and Phi'(0) = 0: the mean of both sides leaves the fourth derivative times step^2.
        energy = (phi(step * direction) + phi(-step * direction)) / 2
        # The spline returns f to float32 rounding, 1e-5 grey of the 1e-2 that a step of 4e-3 px changes.
        assert energy == pytest.approx(0.5 * step**2 * direction @ hessian @ direction, rel=1e-3)


@EVERY_MAPPING
@EVERY_MOTION
def test_m_pixel_by_pixel(mapping: CameraMapping, motion: MotionKind) -> None:
    seen = view_of(mapping, motion, picture(), picture())
    tangent = camera_of(seen).tangent.toarray()
    rows = []
    for cell in cell_pixels(seen.correlation):
        slopes = np.einsum("pa,pi->pai", cell.shapes, cell.gradient).reshape(len(cell.x), -1)
        rows.append(slopes @ tangent[(2 * cell.nodes[:, None] + np.arange(2)).ravel()])
    jacobian = np.concatenate(rows)
    hessian = hessian_of(seen)
    # Rounding of sums over some thousand pixels.
    np.testing.assert_allclose(hessian, WEIGHT * jacobian.T @ jacobian, atol=1e-11 * np.abs(hessian).max())
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-14 * np.abs(hessian).max())


@EVERY_MAPPING
def test_the_columns_of_the_motion_are_m_times_a_rigid_displacement(mapping: CameraMapping) -> None:
    seen = view_of(mapping, "rigid", picture(), picture())
    setup, nodes = camera_of(seen).setup, camera_of(seen).field.mesh.nodes
    arm = (nodes - setup.centre) / setup.length
    rigid = np.zeros((nodes.size, 3))
    rigid[0::2, 0] = rigid[1::2, 1] = 1.0
    rigid[0::2, 2], rigid[1::2, 2] = -arm[:, 1], arm[:, 0]
    m = hessian_of(seen)
    n = nodes.size
    size = np.abs(m).max()
    np.testing.assert_allclose(m[:n, n:], m[:n, :n] @ rigid, atol=1e-12 * size)
    np.testing.assert_allclose(m[n:, n:], rigid.T @ m[:n, :n] @ rigid, atol=1e-10 * size)
    b = seen.assemble_right_hand_side(seen.compute_residual(np.zeros(n + 3)))
    np.testing.assert_allclose(b[n:], rigid.T @ b[:n], atol=1e-10 * np.abs(b).sum())


def test_weight_multiplies_m_and_b() -> None:
    f, g = picture(), picture(1)
    seen = view_of(MAPPINGS["homography"], "rigid", f, g)
    heavy = replace(seen, weight=4 * WEIGHT)
    zero = np.zeros(camera_of(seen).n_unknowns)
    b, m = seen.assemble_right_hand_side(seen.compute_residual(zero)), hessian_of(seen)
    np.testing.assert_allclose(heavy.assemble_right_hand_side(heavy.compute_residual(zero)), 4 * b, rtol=1e-15)
    np.testing.assert_allclose(hessian_of(heavy), 4 * m, rtol=1e-15)


def test_what_another_camera_has_leaves_m_and_b() -> None:
    f, g = picture(), picture(1)
    alone, more = (view_of(MAPPINGS["similarity"], "none", f, g, n_others=n) for n in (0, 3))
    n = camera_of(alone).n_unknowns
    q = np.random.default_rng(1).normal(size=n + 3)
    np.testing.assert_array_equal(hessian_of(more)[:n, :n], hessian_of(alone))
    assert not hessian_of(more)[n:].any()
    b = more.assemble_right_hand_side(more.compute_residual(q))
    np.testing.assert_array_equal(b[:n], alone.assemble_right_hand_side(alone.compute_residual(q[:n])))
    assert not b[n:].any()


@pytest.mark.parametrize("placed", [False, True], ids=["nodal", "identity"])
def test_the_one_camera_of_a_plain_case_is_its_correlation(placed: bool) -> None:
    mesh = grid_mesh(4, 4, (16.0, 16.0), origin=(40.0, 40.0), seed=2, jitter=0.1)
    f, g = picture(), picture(1)
    part, deformed = read_correlation(mesh, source(f), DEGREE), DeformedSubImage(source(g), DEGREE)
    kinematics: Kinematics = NodalKinematics(mesh, np.arange(mesh.n_dofs))
    if placed:
        kinematics = place_before_camera(kinematics, CameraSetup(identity(), "none", np.zeros(2), 1.0))
    seen = View(part, kinematics).open_frame(deformed)
    q = np.random.default_rng(1).normal(size=mesh.n_dofs)
    expected, found = part.compute_residual(deformed, q, all_kinds=True), seen.compute_residual(q, all_kinds=True)
    # phi(X + u) - phi(X) of the identity rounds positions of 1e2 px.
    close = {"rtol": 1e-12, "atol": 1e-9} if placed else {"rtol": 0.0, "atol": 0.0}
    np.testing.assert_allclose(kinematics.displacement(q), q, **close)
    assert seen.find_displaced_window(q) == part.find_displaced_window(q)
    np.testing.assert_allclose(hessian_of(seen), part.assemble_hessian().toarray(), **close)
    np.testing.assert_allclose(found.cell_sums.values, expected.cell_sums.values, rtol=close["rtol"], atol=1e-6)
    np.testing.assert_allclose(seen.assemble_right_hand_side(found, 0.9, 3.0),
                               part.assemble_right_hand_side(expected, 0.9, 3.0),
                               rtol=close["rtol"], atol=1e-6 if placed else 0.0)
    np.testing.assert_allclose(seen.compute_residual_image(q, 0.9, 3.0),
                               part.compute_residual_image(deformed, q, 0.9, 3.0), atol=1e-4 if placed else 0.0)


def test_pixels_that_leave_the_deformed_image_leave_m() -> None:
    f = picture()
    seen = view_of(MAPPINGS["similarity"], "translation", f, f)
    q = np.zeros(camera_of(seen).n_unknowns)
    # 20 px of the specimen are 80 px of an image that ends 40 px beyond the mesh.
    q[-2] = 20.0
    shown = seen.without_hidden(q)
    total = seen.n_pixels
    expected = int(np.isfinite(seen.compute_residual_image(q)).sum())
    assert 0 < expected < total
    assert shown.n_pixels == expected
    assert seen.without_hidden(np.zeros_like(q)).n_pixels == total
    lost = hessian_of(seen) - shown.project(shown.assemble_hessian()).toarray()
    # What is taken away is a sum of squares.
    assert np.linalg.eigvalsh(lost).min() >= -1e-12 * np.abs(lost).max()


def test_pixels_are_counted_by_cell() -> None:
    f = picture()
    seen = view_of(MAPPINGS["similarity"], "translation", f, f)
    q = np.zeros(camera_of(seen).n_unknowns)
    q[-2] = 20.0
    everything, shown = seen, seen.without_hidden(q)
    # What a cell shows is what its residual counts.
    assert everything.count_pixels().tolist() == [len(cell.x) for cell in cell_pixels(everything.correlation)]
    np.testing.assert_array_equal(shown.count_pixels(), seen.compute_residual(q).cell_sums.n_pixels)
    assert everything.count_pixels().sum() == everything.n_pixels
    assert 0 < shown.count_pixels().sum() == shown.n_pixels < everything.n_pixels


def test_a_view_held_still_has_weight_one_and_the_field_s_unknowns() -> None:
    seen = view_of(MAPPINGS["homography"], "rigid", picture(), picture(1))
    still = seen.hold_still()
    n = camera_of(seen).field.n_unknowns
    assert (still.weight, still.kinematics.n_unknowns, still.camera) == (1.0, n, 1)
    found = still.project(still.assemble_hessian()).toarray()
    np.testing.assert_allclose(WEIGHT * found, hessian_of(seen)[:n, :n], rtol=1e-13)
