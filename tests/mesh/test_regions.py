"""Structured meshes of circles and polygons; node sets of their boundaries."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ddic
from ddic.mesh.holes import Polygon
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import is_simple_polygon
from ddic.mesh.quality import measure_areas, measure_shape_quality
from ddic.mesh.repair import check_joints, repair
from ddic.mesh.structured import SMALLEST_SINE, build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from support.regions import SHAPES, SIDES, Array, area_of, assert_sets, is_in_one_piece, simple_polygons, turned

Cell = Literal["Q4", "T3"]
CELLS = pytest.mark.parametrize("cell", ["Q4", "T3"])
def assert_sound(mesh: Mesh) -> None:
    assert measure_areas(mesh).min() > 0
    assert measure_shape_quality(mesh).min() >= SMALLEST_SINE
    assert is_in_one_piece(mesh)
    check_joints(repair(mesh))


@settings(max_examples=20, deadline=None)
@given(center=st.tuples(st.floats(60, 140), st.floats(60, 140)), radius=st.floats(25, 80), size=st.floats(5, 12),
       cell=st.sampled_from(["Q4", "T3"]))
def test_circles(center: tuple[float, float], radius: float, size: float, cell: Cell) -> None:
    mesh = build_structured_mesh((center, radius), size, cell)
    assert_sound(mesh)
    away = np.hypot(*(mesh.nodes[find_boundary_nodes(mesh)] - center).T)
    np.testing.assert_allclose(away, radius, rtol=0, atol=1e-9)
    # Chords leave out chord^2 / (6 radius^2) of the area; none of 600 circles had one above 1.7 sides of an element,
    # which covers the diameter a whole number of times.
    lost = 1 - measure_areas(mesh).sum() / (np.pi * radius**2)
    assert 0 < lost < (1.75 * 2 / round(2 * radius / size)) ** 2 / 6
    assert set(mesh.node_sets) == set(SIDES)


@pytest.mark.parametrize("name", SHAPES)
@CELLS
def test_usual_shapes_are_covered_exactly(name: str, cell: Cell) -> None:
    sizes = (11.3, 6.0, 8.0, 11.3, 8.0, 6.0, 16.0)
    for degrees, size in zip((0, 7, 20, 33, 45, 62, 81), sizes, strict=True):
        outline = turned(name, degrees)
        mesh = build_structured_mesh(outline, size, cell)
        assert_sound(mesh)
        away = np.abs(Polygon(outline).measure_distance(mesh.nodes[find_boundary_nodes(mesh)]))
        assert away.max() < 1e-9
        # Corners are nodes, sides are straight.
        assert np.linalg.norm(mesh.nodes[:, None] - outline, axis=2).min(axis=0).max() < 1e-9
        assert measure_areas(mesh).sum() == pytest.approx(area_of(outline), rel=1e-12)


def test_a_box_of_four_vertices_is_the_mesh_of_the_box() -> None:
    box = build_structured_mesh((10, 20, 95, 71), 8)
    polygon = build_structured_mesh(np.array([(10, 20), (95, 20), (95, 71), (10, 71), (10, 20)]), 8)
    # Rounding of the nearest point on a side.
    np.testing.assert_allclose(polygon.nodes, box.nodes, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(polygon.cells, box.cells)
    for name in SIDES:
        np.testing.assert_array_equal(polygon.node_sets[name], box.node_sets[name])


@CELLS
def test_a_box_stays_the_grid_that_it_was(cell: Cell) -> None:
    mesh = build_structured_mesh((3.5, 4.25, 43.5, 94.25), 8, cell)
    x, y = np.meshgrid(np.linspace(3.5, 43.5, 6), np.linspace(4.25, 94.25, 12))
    np.testing.assert_array_equal(mesh.nodes, np.column_stack([x.ravel(), y.ravel()]))
    numbers = np.arange(72).reshape(12, 6)
    expected = {"left": numbers[:, 0], "right": numbers[:, -1], "top": numbers[0], "bottom": numbers[-1]}
    assert list(mesh.node_sets) == list(expected)
    for name, nodes in expected.items():
        np.testing.assert_array_equal(mesh.node_sets[name], nodes)


@settings(max_examples=30, deadline=None)
@given(outline=simple_polygons(), size=st.floats(5, 11), cell=st.sampled_from(["Q4", "T3"]), has_hole=st.booleans())
def test_random_polygons(outline: Array, size: float, cell: Cell, has_hole: bool) -> None:
    assert is_simple_polygon(outline)
    # As far inside as leaves two elements around it.
    radius = Polygon(outline).measure_distance(np.array([[150.0, 150.0]]))[0] * -1 - 2.5 * size
    holes = [((150.0, 150.0), float(radius))] if has_hole and radius > size else []
    mesh = build_structured_mesh(outline, size, cell, holes)
    assert_sound(mesh)
    assert_sets(mesh, holes)
    away = np.abs(Polygon(outline).measure_distance(mesh.nodes[find_boundary_nodes(mesh)]))
    on_hole = np.zeros(mesh.n_nodes, bool)
    on_hole[mesh.node_sets.get("hole_0", [])] = True
    # Of 250 random polygons the farthest node was 0.71 elements off.
    assert away[~on_hole[find_boundary_nodes(mesh)]].max() < 1.5 * size


def test_tips_without_a_side_in_common_are_left_out_and_narrow_necks_refused() -> None:
    # A needle of 3 px at its root, at 40 degrees, that has centres of elements in it here and there.
    tip = np.array([(20, 20), (100, 20), (100, 58), (190, 133), (98, 61), (98, 100), (20, 100)], float)
    mesh = build_structured_mesh(tip, 10)
    assert is_in_one_piece(mesh)
    neck = np.array([(20, 20), (80, 20), (80, 58), (120, 58), (120, 20), (180, 20), (180, 100), (120, 100), (120, 60),
                     (80, 60), (80, 100), (20, 100)], float)
    with pytest.raises(ddic.InputError, match=r"mesh.structured.region: falls into 2 pieces .* use smaller elements"):
        build_structured_mesh(neck, 13)
    assert is_in_one_piece(build_structured_mesh(neck, 2))


NOT_SIMPLE = {
    "crossed": [(0, 0), (50, 50), (50, 0), (0, 50)],
    "touching itself": [(0, 0), (50, 0), (50, 50), (25, 0), (0, 50)],
    "folded back": [(0, 0), (50, 0), (20, 0), (20, 50)],
    "flat": [(0, 0), (25, 25), (50, 50)],
}


@pytest.mark.parametrize("name", NOT_SIMPLE)
@pytest.mark.parametrize("key", ["region", "polygons"])
def test_polygons_that_meet_themselves_are_refused(name: str, key: str) -> None:
    vertices: Any = np.array(NOT_SIMPLE[name], float)
    given = {"region": (-10, -10, 60, 60), "polygons": (), key: vertices if key == "region" else [vertices]}
    with pytest.raises(ddic.InputError, match=rf"mesh.structured.{key}.*crosses or touches itself; list its vertices"):
        build_structured_mesh(given["region"], 5, polygons=given["polygons"])


def test_a_slit_that_does_not_touch_is_simple() -> None:
    assert is_simple_polygon(np.array([(0, 0), (50, 0), (50, 24), (1e-6, 25), (50, 26), (50, 50), (0, 50)], float))
    assert not is_simple_polygon(np.array([(0, 0), (50, 0), (50, 24), (0, 25), (50, 26), (50, 50), (0, 50)], float))


@pytest.mark.parametrize("hole", [
    {"circles": [((100.0, 60.0), 30.0)]}, {"circles": [((300.0, 60.0), 30.0)]}, {"circles": [((100.0, 100.0), 1e300)]},
    {"polygons": [np.array([(90, 90), (110, 90), (110, 200), (90, 200)], float)]},
])
def test_holes_that_leave_a_circle_are_refused(hole: dict[str, Any]) -> None:
    with pytest.raises(ddic.InputError, match=r"mesh.structured: hole_0 leaves the region; move it inside, or draw"):
        build_structured_mesh(((100.0, 100.0), 60.0), 8, **hole)


def test_a_region_without_an_element_is_refused() -> None:
    needle = np.array([(10, 10), (90, 89), (90, 90)], float)
    with pytest.raises(ddic.InputError, match=r"mesh.structured.region: holds no element"):
        build_structured_mesh(needle, 40)


@pytest.mark.parametrize("region", [3, (), (1, 2, 3), ((0, 0), "a"), ((0, 0), (1, 1)), [(0, 0), (1, 1, 1), (2, 0)],
                                    ((50, 50), -3), ((50, np.nan), 3), [(0, 0), (np.nan, 50), (50, 50)]])
def test_what_is_no_region_is_refused(region: Any) -> None:
    with pytest.raises(ddic.InputError, match=r"mesh.structured.*(expected|finite numbers)"):
        build_structured_mesh(region, 5)


def test_a_notch_keeps_its_name_and_no_empty_set_is_listed() -> None:
    notched = build_structured_mesh((0, 0, 100, 100), 10, circles=[((0.0, 50.0), 25.0)])
    assert list(notched.node_sets) == [*SIDES, "hole_0"]
    assert (notched.nodes[notched.node_sets["left"], 0] == 0).all()
    swallowed = build_structured_mesh((0, 0, 100, 100), 10,
                                      polygons=[np.array([(-20, -20), (30, -20), (30, 120), (-20, 120)], float)])
    assert set(swallowed.node_sets) == {"right", "top", "bottom", "hole_0"}
