"""What a camera sees of displacements in the specimen's frame, and the motion of its set-up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.images.camera import CameraMapping, identity, similarity
from ddic.kinematics.camera import CameraKinematics, CameraSetup, MotionKind, place_before_camera, see_mesh
from ddic.kinematics.nodal import NodalKinematics
from support.random_meshes import grid_mesh

CENTRE = np.array([390.0, 225.0])
LENGTH = 140.0
TILTED = np.array([[4.9, -0.3, -1300.0], [0.4, 5.1, -900.0], [2e-5, -1.5e-5, 1.0]])
MAPPINGS = {
    "identity": identity(),
    "similarity": similarity(4.0, 12.0, (-1100.0, -900.0)),
    "homography": CameraMapping(TILTED),
    "distortion": CameraMapping(TILTED, np.array([520.0, 380.0]), 868.0, np.array([-0.03, 0.004])),
}
MOTIONS: list[MotionKind] = ["none", "translation", "rigid"]
EVERY_MAPPING = pytest.mark.parametrize("mapping", MAPPINGS.values(), ids=MAPPINGS)
EVERY_MOTION = pytest.mark.parametrize("motion", MOTIONS)
MESH = grid_mesh(6, 5, (20.0, 16.0), origin=(330.0, 180.0), seed=1, jitter=0.15)
NODES = MESH.nodes
FIELD = NodalKinematics(MESH, np.arange(MESH.n_dofs))

coordinates = st.floats(-500.0, 500.0)
points_of_any_kind = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=6).map(np.array)


def set_up(mapping: CameraMapping, motion: MotionKind) -> CameraSetup:
    return CameraSetup(mapping, motion, CENTRE, LENGTH)


def place(mapping: CameraMapping, motion: MotionKind, n_others: int = 0) -> CameraKinematics:
    """The mesh before a camera; n_others: unknowns of another camera's motion after its own."""
    setup = set_up(mapping, motion)
    n_motion = setup.n_motion_unknowns + n_others
    return place_before_camera(FIELD, setup, NODES.size + np.arange(n_motion))


def some_unknowns(n_motion: int, seed: int = 0) -> NDArray[np.float64]:
    """Displacements of a pixel or so, and a motion of a few."""
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.normal(size=NODES.size), rng.normal(size=n_motion) * 4])


@pytest.mark.parametrize(("motion", "n"), [("none", 0), ("translation", 2), ("rigid", 3)])
def test_number_of_unknowns_of_a_motion(motion: MotionKind, n: int) -> None:
    placed = place(identity(), motion)
    assert placed.setup.n_motion_unknowns == n
    assert placed.n_unknowns == NODES.size + n
    assert placed.tangent.shape == (NODES.size, NODES.size + n)
    assert placed.numbers.tolist() == list(range(NODES.size + n))


@EVERY_MAPPING
@EVERY_MOTION
def test_at_rest_nothing_moves(mapping: CameraMapping, motion: MotionKind) -> None:
    placed = place(mapping, motion)
    np.testing.assert_array_equal(placed.mesh.nodes, mapping.to_image(NODES))
    # X0 + (X - X0) rounds to 1e-13 px, five pixels of the image each.
    np.testing.assert_allclose(placed.displacement(np.zeros(placed.n_unknowns)), 0.0, atol=1e-11)


@EVERY_MAPPING
@EVERY_MOTION
def test_displacement_is_that_of_the_definition(mapping: CameraMapping, motion: MotionKind) -> None:
    placed = place(mapping, motion)
    q = some_unknowns(placed.setup.n_motion_unknowns)
    u, unknowns = q[:NODES.size].reshape(-1, 2), np.zeros(3)
    unknowns[:placed.setup.n_motion_unknowns] = q[NODES.size:]
    # T(Y) = X0 + R(theta) (Y - X0) + alpha with R from x towards y, written with complex numbers.
    y = (NODES + u - CENTRE) @ [1, 1j]
    turned = y * np.exp(1j * unknowns[2] / LENGTH)
    moved = CENTRE + unknowns[:2] + np.column_stack([turned.real, turned.imag])
    # Rounding of positions of about 1e3 px.
    np.testing.assert_allclose(placed.displacement(q).reshape(-1, 2), mapping.to_image(moved) - mapping.to_image(NODES),
                               atol=1e-11)


@EVERY_MAPPING
@EVERY_MOTION
def test_tangent_is_the_derivative_at_rest(mapping: CameraMapping, motion: MotionKind) -> None:
    placed = place(mapping, motion, n_others=2)
    n = placed.tangent.shape[1]
    step = 1e-3
    numeric = np.stack([(placed.displacement(step * e) - placed.displacement(-step * e)) / (2 * step)
                        for e in np.eye(n)], axis=1)
    # Rounding of positions of 1e3 px over the step gives 1e-10; third derivatives times step^2 are less.
    np.testing.assert_allclose(placed.tangent.toarray(), numeric, atol=2e-9)
    assert not placed.tangent[:, n - 2:].toarray().any()


@EVERY_MAPPING
def test_what_another_camera_has_does_not_move_this_one(mapping: CameraMapping) -> None:
    alone, more = (place(mapping, "none", n_others=n) for n in (0, 3))
    q = some_unknowns(3)
    np.testing.assert_array_equal(more.displacement(q), alone.displacement(q[:NODES.size]))
    assert more.tangent.shape == (NODES.size, NODES.size + 3)


@EVERY_MAPPING
@EVERY_MOTION
def test_unknowns_invert_the_displacement(mapping: CameraMapping, motion: MotionKind) -> None:
    placed = place(mapping, motion)
    q = some_unknowns(placed.setup.n_motion_unknowns, 3)
    found = placed.fit_with_motion(placed.displacement(q), q[NODES.size:])
    # Image positions of 1e3 px round to 1e-13 px; the distortion is undone to some multiples of that.
    np.testing.assert_allclose(found, q, atol=1e-10)


@EVERY_MAPPING
@EVERY_MOTION
def test_without_a_motion_the_field_explains_everything(mapping: CameraMapping, motion: MotionKind) -> None:
    placed = place(mapping, motion)
    q = some_unknowns(placed.setup.n_motion_unknowns, 4)
    found = placed.fit(placed.displacement(q))
    assert not found[NODES.size:].any()
    # Image positions of 1e3 px, inverted as above, five pixels of the image for each of the specimen.
    np.testing.assert_allclose(placed.displacement(found), placed.displacement(q), atol=1e-9)


@EVERY_MAPPING
@EVERY_MOTION
def test_a_set_up_that_is_held_still_has_the_field_s_unknowns(mapping: CameraMapping, motion: MotionKind) -> None:
    placed = place(mapping, motion, n_others=1)
    still = placed.hold_still()
    u = some_unknowns(0, 5)
    assert still.numbers.tolist() == FIELD.numbers.tolist()
    np.testing.assert_array_equal(still.displacement(u), place(mapping, "none").displacement(u))
    np.testing.assert_array_equal(still.tangent.toarray(), placed.tangent.toarray()[:, :NODES.size])


@given(points=points_of_any_kind, x=st.floats(-20, 20), y=st.floats(-20, 20), turn=st.floats(-200, 200))
def test_moving_back_inverts_moving(points: NDArray[np.float64], x: float, y: float, turn: float) -> None:
    for motion in MOTIONS:
        setup = set_up(identity(), motion)
        unknowns = np.array([x, y, turn])[:setup.n_motion_unknowns]
        np.testing.assert_allclose(setup.move_back(setup.move(points, unknowns), unknowns), points, atol=1e-11)
        np.testing.assert_allclose(setup.move(setup.move_back(points, unknowns), unknowns), points, atol=1e-11)


@given(points=points_of_any_kind, x=st.floats(-20, 20), y=st.floats(-20, 20), turn=st.floats(-200, 200))
def test_a_motion_is_rigid(points: NDArray[np.float64], x: float, y: float, turn: float) -> None:
    moved = set_up(identity(), "rigid").move(np.vstack([CENTRE, points]), np.array([x, y, turn]))
    np.testing.assert_allclose(moved[0], CENTRE + np.array([x, y]), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(moved[1:] - moved[0], axis=1), np.linalg.norm(points - CENTRE, axis=1),
                               atol=1e-11)
    plain = set_up(identity(), "translation").move(points, np.array([x, y]))
    np.testing.assert_array_equal(plain, points + np.array([x, y]))


def test_a_rotation_turns_x_towards_y_by_the_unknown_over_the_length() -> None:
    angle = 0.02
    arm = CENTRE + np.array([100.0, 0.0])
    moved = set_up(identity(), "rigid").move(arm[None], np.array([0.0, 0.0, angle * LENGTH]))
    np.testing.assert_allclose(moved[0] - CENTRE, [100 * np.cos(angle), 100 * np.sin(angle)], atol=1e-12)


@EVERY_MOTION
def test_motion_columns_are_the_derivative_of_the_motion(motion: MotionKind) -> None:
    setup = set_up(identity(), motion)
    step = 1e-3
    numeric = [(setup.move(NODES, step * e) - setup.move(NODES, -step * e)).ravel() / (2 * step)
               for e in np.eye(setup.n_motion_unknowns)]
    # Rounding of 1e3 px over the step; the third derivative is (step / LENGTH)^2 of the first.
    np.testing.assert_allclose(setup.motion_columns(NODES), np.array(numeric).reshape(-1, NODES.size).T, atol=2e-10)


def test_the_mesh_in_the_cameras_pixels() -> None:
    seen = see_mesh(MESH, set_up(MAPPINGS["similarity"], "none"))
    np.testing.assert_array_equal(seen.nodes, MAPPINGS["similarity"].to_image(NODES))
    np.testing.assert_array_equal(seen.connectivity, MESH.connectivity)
    np.testing.assert_array_equal(seen.types, MESH.types)
