"""Meshes by gmsh."""

from __future__ import annotations

import signal
import sys
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ddic
from ddic.mesh.holes import Polygon
from ddic.mesh.quality import measure_areas, measure_cell_size, measure_shape_quality
from ddic.mesh.repair import check_joints, repair
from ddic.mesh.topology import find_boundary_nodes
from ddic.mesh.unstructured import build_unstructured_mesh
from support.regions import SHAPES, SIDES, Array, area_of, assert_sets, is_in_one_piece, simple_polygons, turned

gmsh = pytest.importorskip("gmsh")

Cell = Literal["T3", "Q4"]
CELLS = pytest.mark.parametrize("cell", ["T3", "Q4"])


def assert_sound(mesh: ddic.Mesh, cell: str, size: float) -> None:
    assert {block.type.name for block in mesh.cell_blocks} == {cell}
    assert measure_areas(mesh).min() > 0
    # 6 degrees; the worst of 100 random polygons had a sine of 0.2.
    assert measure_shape_quality(mesh).min() > 0.1
    assert is_in_one_piece(mesh)
    check_joints(repair(mesh))
    # Equilateral triangles of this side have sqrt(3)/4 of its square, squares all of it.
    assert measure_cell_size(mesh) / size == pytest.approx(0.66 if cell == "T3" else 1, rel=0.35)


@pytest.mark.parametrize("name", SHAPES)
@CELLS
def test_polygons_are_covered_exactly(name: str, cell: Cell) -> None:
    outline = turned(name, 20)
    mesh = build_unstructured_mesh(outline, 12, cell)
    assert_sound(mesh, cell, 12)
    on_edge = mesh.nodes[find_boundary_nodes(mesh)]
    assert np.abs(Polygon(outline).measure_distance(on_edge)).max() < 1e-9
    assert measure_areas(mesh).sum() == pytest.approx(area_of(outline), rel=1e-12)
    assert np.linalg.norm(mesh.nodes[:, None] - outline, axis=2).min(axis=0).max() < 1e-9
    assert_sets(mesh, [])


@CELLS
def test_a_disk_with_a_round_hole(cell: Cell) -> None:
    outer, hole = ((100.3, 90.1), 70.0), ((110.0, 80.0), 25.0)
    mesh = build_unstructured_mesh(outer, 10, cell, circles=[hole])
    assert_sound(mesh, cell, 10)
    assert set(mesh.node_sets) == {*SIDES, "hole_0"}
    for name, nodes in mesh.node_sets.items():
        center, radius = hole if name == "hole_0" else outer
        np.testing.assert_allclose(np.hypot(*(mesh.nodes[nodes] - center).T), radius, rtol=0, atol=1e-9)
    # Chords of 10 px leave out chord^2 / (6 radius^2) of the disk's area, and as much of the hole's.
    lost = np.pi * (70**2 - 25**2) - measure_areas(mesh).sum()
    assert abs(lost) < np.pi * 10**2 / 6


def test_holes_may_cross_each_other() -> None:
    square = np.array([(80, 60), (120, 60), (120, 100), (80, 100)], float)
    mesh = build_unstructured_mesh((20, 20, 180, 150), 8, circles=[((80.0, 80.0), 20.0)], polygons=[square])
    assert set(mesh.node_sets) == {*SIDES, "hole_0", "hole_1"}
    # The square, and what is left of the disk: half of it.
    assert measure_areas(mesh).sum() == pytest.approx(160 * 130 - 1600 - np.pi * 200, rel=0.002)


@settings(max_examples=15, deadline=None)
@given(outline=simple_polygons(), cell=st.sampled_from(["T3", "Q4"]))
def test_random_outlines(outline: Array, cell: Cell) -> None:
    mesh = build_unstructured_mesh(outline, 12, cell)
    assert is_in_one_piece(mesh)
    assert measure_areas(mesh).min() > 0
    check_joints(repair(mesh))
    assert measure_areas(mesh).sum() == pytest.approx(area_of(outline), rel=1e-9)
    assert_sets(mesh, [])


def test_gmsh_says_nothing_and_leaves_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    before = signal.getsignal(signal.SIGINT)
    first, again = (build_unstructured_mesh((0, 0, 60, 50), 9) for _ in range(2))
    assert capfd.readouterr() == ("", "")
    assert signal.getsignal(signal.SIGINT) is before
    assert not gmsh.isInitialized()
    np.testing.assert_array_equal(first.nodes, again.nodes)
    np.testing.assert_array_equal(first.connectivity, again.connectivity)


def test_a_session_of_the_users_own_is_left_alone() -> None:
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        with pytest.raises(ddic.InputError, match=r"gmsh is in use in this process; call gmsh.finalize\(\) first"):
            build_unstructured_mesh((0, 0, 60, 50), 9)
        assert gmsh.isInitialized()
    finally:
        gmsh.finalize()


def test_without_gmsh_a_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(ddic.InputError, match=r"gmsh makes this mesh.*install gmsh, or ddic.*\[gmsh\]") as caught:
        build_unstructured_mesh((0, 0, 60, 50), 9)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)


def test_what_gmsh_refuses_is_told_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: object) -> None:
        raise Exception("Impossible to recover edge 3\n")  # noqa: TRY002 - as gmsh does

    monkeypatch.setattr(gmsh.model.mesh, "generate", fail)
    with pytest.raises(ddic.InputError, match=r"mesh.unstructured: gmsh cannot mesh .* \(Impossible to") as caught:
        build_unstructured_mesh((0, 0, 60, 50), 9)
    assert "\n" not in str(caught.value)
    assert not gmsh.isInitialized()


@pytest.mark.parametrize(("arguments", "words"), [
    (((0, 0, 60, 50), 9, "Q8"), 'mesh.unstructured: cell = "Q8"'),
    (((0, 0, 60, 50), 0), "a size above 0"),
    (((0, 0, 0, 60, 50, 40), 9), "a plane one, (x0, y0, x1, y1), is meshed"),
    (((60, 0, 0, 50), 9), "expected x0 < x1"),
    (((0, 0, 60, 50), 9, "T3", [((30, 25), -1)]), "mesh.unstructured.circles[0]: radius = -1"),
    (((0, 0, 60, 50), 9, "T3", [((30, 25), 25)]), "mesh.unstructured: hole_0 leaves the region"),
    (([(0, 0), (60, 60), (60, 0), (0, 60)], 9), "mesh.unstructured.region: the polygon crosses"),
])
def test_impossible_arguments(arguments: Any, words: str) -> None:
    with pytest.raises(ddic.InputError) as caught:
        build_unstructured_mesh(*arguments)
    assert words in str(caught.value)
