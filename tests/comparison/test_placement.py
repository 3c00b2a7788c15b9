"""Where a simulation lies, and how the specimen moved with the machine, told by the field."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.comparison.placement import PlacedField, fit_placement, fit_rigid_motion_to
from ddic.errors import InputError
from ddic.mesh.rotation import build_rotation
from ddic.mesh.structured import build_structured_mesh
from support.random_meshes import box_mesh

MESH = build_structured_mesh((20.0, 20.0, 380.0, 300.0), 5.0)
POINTS = build_structured_mesh((60.0, 60.0, 340.0, 260.0), 10.0).nodes
MIDDLE = np.array([200.0, 160.0])


def _about_a_hole(points: np.ndarray) -> np.ndarray:
    """A field whose place is seen."""
    x, y = (points - MIDDLE).T
    r2 = x**2 + y**2 + 60.0**2
    return np.stack([0.01 * x + 20.0 * x * y**2 / r2**1.5, -0.003 * y + 8.0 * x * y / r2], axis=1)


def _move(points: np.ndarray, turn: float, shift: tuple[float, float], b: float, s: tuple[float, float]) -> np.ndarray:
    """The same at another place, with a rigid motion about the origin."""
    back, forth = build_rotation(-turn), build_rotation(turn)
    u = _about_a_hole((points - MIDDLE - shift) @ back.T + MIDDLE) @ forth.T
    return (points + u) @ build_rotation(b).T + s - points


def test_a_rigid_motion_is_found_whatever_the_turn() -> None:
    measured = _move(POINTS, 0.0, (0.0, 0.0), 0.4, (30.0, -50.0))
    placed = fit_rigid_motion_to(PlacedField.as_given(MESH, _about_a_hole(MESH.nodes)), POINTS, measured)
    # Interpolation on elements of 5 px, of a field with second derivatives of 1e-3 / px.
    assert np.abs(placed.at(POINTS) - measured).max() < 5e-3
    assert placed.rotation.angle == pytest.approx(0.4, abs=1e-5)
    assert "rigid motion" in placed.describe()


def test_a_place_is_found_from_some_elements_off() -> None:
    measured = _move(POINTS, 0.05, (4.0, -3.0), 0.01, (1.0, 2.0))
    placed = fit_placement(PlacedField.as_given(MESH, _about_a_hole(MESH.nodes)), POINTS, measured)
    assert placed.turn.angle == pytest.approx(0.05, abs=2e-4)
    # The simulation's middle came to its own place, shifted.
    assert placed.turn.apply(MIDDLE[None])[0] + placed.offset == pytest.approx(np.array([204.0, 157.0]), abs=0.05)
    # As above, where second derivatives at the hole are 3e-3 / px.
    assert np.abs(placed.at(POINTS) - measured).max() < 2e-2
    assert placed.describe().startswith("placed ")


def test_a_uniform_strain_does_not_tell_its_place() -> None:
    strain = np.array([[0.01, 0.002], [0.002, -0.003]])
    placed = PlacedField.as_given(MESH, MESH.nodes @ strain)
    with pytest.raises(InputError, match="changes too little from place to place"):
        fit_placement(placed, POINTS, POINTS @ strain)


def test_a_simulation_elsewhere_is_refused() -> None:
    placed = PlacedField.as_given(MESH, _about_a_hole(MESH.nodes))
    with pytest.raises(InputError, match=r"covers 0 of \d+ nodes"):
        fit_rigid_motion_to(placed, POINTS + 1000.0, POINTS)


def test_a_volume_is_placed_too() -> None:
    mesh = box_mesh(4, "Hex8")
    rng = np.random.default_rng(0)
    u = rng.uniform(-0.1, 0.1, mesh.nodes.shape)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    measured = (mesh.nodes + u) @ turn.T + [1.0, 2.0, 3.0] - mesh.nodes
    placed = fit_rigid_motion_to(PlacedField.as_given(mesh, u), mesh.nodes, measured)
    assert placed.at(mesh.nodes) == pytest.approx(measured, abs=1e-9)
