"""Coarse fields that jump across lines, and what other meshes start from."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from ddic.images.rigid import build_uniform_field
from ddic.mesh.cut_mesh import CutMesh, cut_mesh, find_points_on_own_side
from ddic.mesh.structured import build_structured_mesh
from ddic.start.coarse_displacement import CutField, evaluate_at_nodes

MIDDLE = np.array([100.3, 98.7])


def _cut(element: float, angle: float, low: float = 20.0) -> CutMesh:
    mesh = build_structured_mesh((low, low, 180.0, 180.0), element)
    along = 300 * np.array([np.cos(angle), np.sin(angle)])
    return cut_mesh(mesh, [np.stack([MIDDLE - along, MIDDLE + along])])


def _jump(points: np.ndarray, sides: np.ndarray, angle: float) -> np.ndarray:
    """Linear on each side of the line, on the sides on which the other points lie."""
    left = (sides - MIDDLE) @ np.array([-np.sin(angle), np.cos(angle)]) > 0
    slope = np.where(left, 0.02, -0.01)[:, None]
    return np.asarray(np.where(left, 3.0, -2.0)[:, None] + slope * (points - MIDDLE))


@given(angle=st.floats(0.0, 3.1), coarse=st.sampled_from([40.0, 32.0, 20.0]), fine=st.sampled_from([16.0, 10.0]))
def test_linear_sides_are_prolonged_exactly(angle: float, coarse: float, fine: float) -> None:
    one, other = _cut(coarse, angle), _cut(fine, angle)
    across = np.array([-np.sin(angle), np.cos(angle)])
    # A line that comes within 1e-3 px of a node is moved off it, to either side.
    assume(min(np.abs((cut.mesh.nodes - MIDDLE) @ across).min() for cut in (one, other)) > 0.01)
    field = CutField(one.mesh, _jump(one.mesh.nodes, find_points_on_own_side(one.mesh), angle))
    found = evaluate_at_nodes(field, other.mesh)
    known = _jump(other.mesh.nodes, find_points_on_own_side(other.mesh), angle)
    # A part thinner than the distance within which a point counts as in a cell may be taken for the other side's.
    same = (np.abs(found - known) < 1e-9).all(axis=1)
    assert same.mean() > 0.99


def test_nodes_outside_take_the_nearest_node_of_their_side() -> None:
    inner, outer = _cut(16.0, 0.3, low=52.0), _cut(16.0, 0.3)
    left = (find_points_on_own_side(inner.mesh) - MIDDLE) @ np.array([-np.sin(0.3), np.cos(0.3)]) > 0
    found = evaluate_at_nodes(CutField(inner.mesh, np.where(left, 3.0, -2.0)[:, None] * np.ones(2)), outer.mesh)
    on_left = (find_points_on_own_side(outer.mesh) - MIDDLE) @ np.array([-np.sin(0.3), np.cos(0.3)]) > 0
    far = np.abs((find_points_on_own_side(outer.mesh) - MIDDLE) @ np.array([-np.sin(0.3), np.cos(0.3)])) > 16
    np.testing.assert_array_equal(found[far, 0], np.where(on_left, 3.0, -2.0)[far])


def test_continuous_fields_are_taken_at_the_nodes() -> None:
    mesh = _cut(16.0, 0.3).mesh
    found = evaluate_at_nodes(build_uniform_field((1.0, -2.0)), mesh)
    np.testing.assert_array_equal(found, [[1.0, -2.0]] * mesh.n_nodes)
