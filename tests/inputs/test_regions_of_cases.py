"""Regions that are no boxes, from the case file to the field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import ddic
from ddic.case.loader import load_case
from ddic.check.case import check_case
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.inputs.mesh_source import build_meshes, is_plain_grid
from ddic.mesh.structured import build_structured_mesh
from support.cases import WAVES, write_case, write_images

VERTICES = [[30, 40], [150, 24], [165, 120], [96, 90], [60, 168], [24, 110]]
POLYGON = f"region = {{ vertices = {VERTICES} }}"
CIRCLE = "region = { center = [96, 90], radius = 62 }"
HOLES = "\ncircles = [{ center = [110, 66], radius = 16 }]"
REGULARIZED = """
[regularization]
cut_off_wavelength = 64
not_controlled = ["left", "right", "top", "bottom", "hole_0"]
[solver]
method = "dual"
subdomains = 4
[gauss_newton]
tolerance = 1e-13
rms_tolerance = 1e-11
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_images(tmp_path)
    return tmp_path


def problems(path: Path) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        check_case(load_case(path))
    return caught.value.problems


def test_a_case_gives_the_mesh_of_the_python_interface(folder: Path) -> None:
    for text, region in ((POLYGON, np.array(VERTICES, float)), (CIRCLE, ((96.0, 90.0), 62.0))):
        case = load_case(write_case(folder, region=text + HOLES)).case
        assert not is_plain_grid(case)
        mesh, _ = build_meshes(case, Window.of_size(192, 192))
        expected = build_structured_mesh(region, 16, circles=[((110.0, 66.0), 16.0)])
        np.testing.assert_array_equal(mesh.nodes, expected.nodes)
        np.testing.assert_array_equal(mesh.cells, expected.cells)
        assert {name: nodes.tolist() for name, nodes in mesh.node_sets.items()} == {
            name: nodes.tolist() for name, nodes in expected.node_sets.items()}


def test_a_box_still_needs_no_whole_mesh(folder: Path) -> None:
    assert is_plain_grid(load_case(write_case(folder)).case)


def test_unstructured_meshes_of_cases(folder: Path) -> None:
    pytest.importorskip("gmsh")
    path = write_case(folder, '[regularization]\neta = 1.0\nnot_controlled = ["top", "hole_0"]',
                      region=CIRCLE + HOLES)
    path.write_text(path.read_text().replace("mesh.structured", "mesh.unstructured"))
    report = check_case(load_case(path))
    assert set(report.cell_counts) == {"T3"}
    assert set(report.node_sets) == {"left", "right", "top", "bottom", "hole_0"}
    mesh, _ = build_meshes(load_case(path).case, Window.of_size(192, 192))
    n_free = len(np.union1d(mesh.node_sets["top"], mesh.node_sets["hole_0"]))
    assert report.n_controlled_dofs == 2 * (mesh.n_nodes - n_free)


@pytest.mark.parametrize("kind", ["structured", "unstructured"])
@pytest.mark.parametrize(("region", "line"), [
    ("region = { center = [150, 90], radius = 62 }", "mesh.KIND: the mesh lies outside the image: nodes from"),
    ("region = { vertices = [[30, 40], [150, 150], [150, 40], [30, 150]] }",
     "mesh.KIND.region: the polygon crosses or touches itself; list its vertices in the order"),
    (CIRCLE + "\npolygons = [{ vertices = [[80, 90], [180, 80], [180, 100]] }]",
     "mesh.KIND: hole_0 leaves the region; move it inside, or draw its notch as part of mesh.KIND.region, a polygon"),
    (CIRCLE + "\npolygons = [{ vertices = [[80, 80], [110, 110], [110, 80], [80, 110]] }]",
     "mesh.KIND.polygons[0]: the polygon crosses or touches itself"),
])
def test_impossible_regions_are_told_in_a_line(folder: Path, kind: str, region: str, line: str) -> None:
    if kind == "unstructured":
        pytest.importorskip("gmsh")
    path = write_case(folder, region=region)
    path.write_text(path.read_text().replace("mesh.structured", f"mesh.{kind}"))
    (found,) = problems(path)
    assert found.startswith(line.replace("KIND", kind))


def test_a_set_that_is_not_there_is_told_with_those_that_are(folder: Path) -> None:
    path = write_case(folder, '[regularization]\neta = 1.0\nnot_controlled = ["hole_1"]', region=CIRCLE + HOLES)
    assert problems(path) == (
        f'{path}: regularization.not_controlled: no node set is named "hole_1"; did you mean "hole_0"? The mesh has: '
        '"bottom", "hole_0", "left", "right", "top"; other nodes are chosen by regularization.boxes',)
    path = write_case(folder, '[regularization]\neta = 1.0\nnot_controlled = ["grips"]')
    assert problems(path) == (
        f'{path}: regularization.not_controlled: no node set is named "grips"; the mesh has: "bottom", "left", '
        '"right", "top"; other nodes are chosen by regularization.boxes',)


def test_pgd_measures_boxes(folder: Path) -> None:
    (line,) = problems(write_case(folder, "[pgd]", region=CIRCLE))
    assert "mesh.structured.region: [pgd] measures whole rectangles; give [x0, y0, x1, y1]" in line


@pytest.mark.parallel([2])
@pytest.mark.parametrize("region", [POLYGON + HOLES, CIRCLE], ids=["polygon", "circle"])
def test_the_field_is_that_of_one_rank(shared_path: Path, region: str) -> None:
    path = shared_path / "case.toml"
    if MPI.COMM_WORLD.rank == 0:
        write_images(shared_path)
        write_case(shared_path, REGULARIZED if "vertices" in region else REGULARIZED.replace(', "hole_0"', ""),
                   region=region)
    MPI.COMM_WORLD.barrier()
    found = ddic.measure(path)
    alone = ddic.measure(path, comm=MPI.COMM_SELF)
    np.testing.assert_array_equal(found.mesh.nodes, alone.mesh.nodes)
    # What tolerances of 1e-13 and sums in another order leave.
    np.testing.assert_allclose(found.displacement, alone.displacement, rtol=0, atol=1e-9)
    error = found.displacement - WAVES.displacement(found.mesh.nodes)
    # 8 bits of grey, 16-px elements and a cut-off of 64 px on waves of 256 px and more.
    assert np.sqrt((error**2).mean()) < 0.02
