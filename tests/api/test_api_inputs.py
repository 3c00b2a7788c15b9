"""What is wrong is told in one clear line, before anything is measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.case.loader import load_case
from ddic.check.case import check_case_file
from ddic.errors import is_collective

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]
NAN = np.where(np.arange(160 * 140).reshape(140, 160) == 60 + 50 * 160, np.nan, 100.0)


def told(call: Callable[[], object]) -> str:
    """The line that a call is refused with."""
    with pytest.raises(ddic.InputError) as caught:
        call()
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 400
    return line


@pytest.mark.parametrize(("image", "words"), [
    (np.ones((140, 160, 3)), "shape (140, 160, 3), (height, width) expected; convert colours to grey levels first"),
    (np.ones(160), "shape (160,), (height, width) expected"),
    (np.ones((0, 160)), "holds no pixel"),
    (np.ones((140, 160), dtype=bool), "an array of bool, grey levels of an integer or float type expected"),
    (np.ones((140, 160), dtype=complex), "an array of complex128"),
    (np.array([["a"]]), "grey levels of an integer or float type expected"),
    (None, "no array of grey levels"),
    ([[1, 2], [3]], "rows of different lengths"),
    (NAN, "1 pixel(s) are NaN or infinite, the first at (x, y) = (60, 50); leave them out with a mask"),
    ("no_such.tif", "no_such.tif: no such image file"),
    (Path("no_such.tif"), "no_such.tif: no such image file"),
])
def test_images(pair: Pair, mesh: ddic.Mesh, image: Any, words: str) -> None:
    for place, given in (("reference image", (image, pair[1])), ("deformed image", (pair[0], image))):
        line = told(lambda given=given: ddic.measure(given, mesh))
        assert words in line
        assert line.startswith(place) or "no_such.tif" in line


def test_images_of_two_sizes(pair: Pair, mesh: ddic.Mesh) -> None:
    assert told(lambda: ddic.measure((pair[0], pair[1][:100]), mesh)) == (
        "deformed image: 160 x 100 px, but the reference image has 160 x 140 px; give images of one size")


@pytest.mark.parametrize(("mask", "words"), [
    (np.ones((5, 160)), "its mask has shape (5, 160), the image (140, 160); give one value for each pixel"),
    (np.ones(()), "its mask has shape ()"),
    ("no_such.png", "no_such.png: no such image file"),
    ([[1], [1, 2]], "mask: rows of different lengths"),
])
def test_masks(pair: Pair, mesh: ddic.Mesh, mask: Any, words: str) -> None:
    assert words in told(lambda: ddic.measure((ddic.Image(pair[0], mask), pair[1]), mesh))
    assert words in told(lambda: ddic.measure((pair[0], ddic.Image(pair[1], mask)), mesh))


@pytest.mark.parametrize(("source", "words"), [
    ((1,), "1 are given, two expected: the reference image and the deformed one"),
    ((1, 2, 3), "3 are given, two expected"),
    (np.ones((140, 160)), "one array is given, a pair expected"),
    (None, "images.reference: this key is missing; give a case file, a pair of images, or"),
    (ddic.Image(np.ones((140, 160))), "Image given; give a case file"),
    ({"images": 1}, "images: a mapping is given; give the sections of a case as arguments, ddic.measure(**case)"),
])
def test_pairs(mesh: ddic.Mesh, source: Any, words: str) -> None:
    assert words in told(lambda: ddic.measure(source, mesh))


def change(of_nodes: Callable[[Any], Any] = lambda nodes: nodes, of_cells: Callable[[Any], Any] = lambda cells: cells,
           ) -> Callable[[ddic.Mesh], Any]:
    return lambda mesh: (of_nodes(mesh.nodes), of_cells(mesh.cells))


@pytest.mark.parametrize(("given", "words"), [
    (lambda mesh: None, "mesh: none is given; ddic.structured_mesh makes one, meshio reads one"),
    (lambda mesh: "no_such.msh", "no_such.msh: no such mesh file"),
    (lambda mesh: 3, "mesh: int is no mesh"),
    (lambda mesh: (mesh.nodes,), "a tuple of 1, two arrays expected"),
    (lambda mesh: (mesh.nodes, mesh.cells, 1), "a tuple of 3, two arrays expected"),
    (lambda mesh: (mesh.cells, mesh.nodes), "nodes of shape (30, 4) and type int64, numbers of shape (n_nodes, 2)"),
    (change(lambda nodes: nodes.T), "nodes of shape (2, 42)"),
    (change(lambda nodes: nodes * np.nan), "have coordinates that are not finite numbers"),
    (change(lambda nodes: nodes + 100), "the mesh lies outside the image"),
    (change(lambda nodes: [["a", "b"]]), "numbers of shape (n_nodes, 2) expected"),
    (change(of_cells=lambda cells: cells.astype(float)), "cells of shape (30, 4) and type float64, whole numbers"),
    (change(of_cells=lambda cells: cells[:, [0, 1]]), "(n_cells, 3 or 4) expected"),
    (change(of_cells=lambda cells: [[0, 1, 2], [0, 1, 2, 3]]), "cells in rows of different lengths"),
    (change(of_cells=lambda cells: cells + 1), "name nodes that do not exist"),
    (change(of_cells=lambda cells: cells - 1), "name nodes that do not exist"),
    (change(of_cells=lambda cells: cells[:0]), "the mesh has no cell"),
    (change(of_cells=lambda cells: cells[:, [0, 2, 1, 3]]), "are flat, crossed or not convex"),
    (lambda mesh: ddic.structured_mesh((20, 20, 24, 24), 0.4), "hold no pixel"),
    (lambda mesh: meshio.Mesh(np.eye(4, 3), [("tetra", [[0, 1, 2, 3]])]), "only linear triangles and quadrilaterals"),
    (lambda mesh: meshio.Mesh(np.c_[mesh.nodes, mesh.nodes[:, 0]], [("quad", mesh.cells)]), "the mesh is not plane"),
])
def test_meshes(pair: Pair, mesh: ddic.Mesh, given: Callable[[ddic.Mesh], Any], words: str) -> None:
    assert words in told(lambda: ddic.measure(pair, given(mesh)))


def test_grid_of_pyvista(pair: Pair, mesh: ddic.Mesh) -> None:
    pytest.importorskip("pyvista")
    grid = ddic.measure(pair, mesh).to_pyvista()
    assert "UnstructuredGrid is no mesh; give one of ddic.structured_mesh or meshio" in told(
        lambda: ddic.measure(pair, grid))


@pytest.mark.parametrize(("arguments", "words"), [
    (((0, 0, 10, 10), 0), "a size above 0"),
    (((10, 0, 0, 10), 2), "expected x0 < x1, y0 < y1"),
    (((0, 0, 10), 2), "expected (x0, y0, x1, y1) and a size"),
    (((0, 0, np.nan, 10), 2), "finite numbers"),
    (((0, 0, 10, 10), "a"), "finite numbers"),
    (((0, 0, 10, 10), 2, "Q8"), 'cell = "Q8": expected "Q4" or "T3"'),
    (((0, 0, 10, 10), 2, "Q4", [((5, 5), -3)]), "circles[0]: radius = -3: expected more than 0"),
    (((0, 0, 10, 10), 2, "Q4", (), (), np.ones(3)), "a mask of shape (3,), (height, width) expected"),
    (((0, 0, 10, 10), 2, "Q4", (), (), np.zeros((10, 10))), "no cell is left"),
])
def test_structured_meshes(arguments: Any, words: str) -> None:
    assert words in told(lambda: ddic.structured_mesh(*arguments))


def test_mask_of_a_structured_mesh_may_be_an_image() -> None:
    mask = np.zeros((100, 100), dtype=np.uint8)
    mask[:, :50] = 255
    assert ddic.structured_mesh((0, 0, 99, 99), 11, mask=mask).nodes[:, 0].max() < 60


@pytest.mark.parametrize(("sections", "words"), [
    ({"regularisation": {}}, 'regularisation: unknown argument; did you mean "regularization"?'),
    ({"msh": 3}, 'msh: unknown argument; did you mean "mesh"?'),
    ({"discontinuity": "find"}, 'discontinuity = "find": write "detect", or [[discontinuity]] sections'),
    ({"discontinuity": {"vertices": []}}, "one section is given, a list of them expected: [[discontinuity]], or [{"),
    ({"kinematic": None}, 'kinematic: unknown argument; did you mean "kinematics"?'),
    ({"options": {}}, "options: unknown argument; valid here: title, images, volumes, near, mesh, discontinuity"),
    ({"regularization": {"cutoff": 3}}, "regularization.cutoff: unknown key; valid here: cut_off_wavelength, eta"),
    ({"solver": {"subdomains": "4"}}, 'solver.subdomains = "4": expected a whole number'),
    ({"solver": {"subdomains": {1}}}, "a value of type set; give numbers, texts, lists and mappings"),
    ({"solver": {"subdomains": 1000}}, "the mesh has only 30 cells; ask for fewer subdomains"),
    ({"solver": 3}, "solver = 3: expected a section"),
    ({"solver": {("a", "b"): 4}}, "keys must be str"),
    ({"regularization": {"cut_off_wavelength": np.nan}}, "cut_off_wavelength = nan: expected a finite number"),
    ({"regularization": {"cut_off_wavelength": -3}}, "expected more than 0"),
    ({"regularization": {"cut_off_wavelength": 30}}, "carries no wave shorter than 3 elements; give at least 60"),
    ({"regularization": {"cut_off_wavelength": 1e6}}, "give at most 2e+04"),
    ({"regularization": {"cut_off_wavelength": 80, "not_controlled": ["lefft"]}}, 'did you mean "left"?'),
    ({"near": [{}]}, "near fields need a case"),
    ({"series": {}}, "[series] goes with several images.deformed"),
    ({"images": {"reference": "a"}}, "images.reference: images are the first argument, too; leave one of them out"),
    ({"images": {"frame_interval": 2}}, "images.frame_interval goes with several images.deformed"),
    ({"images": 3}, "images = 3: expected a section"),
    ({"output": {"flip_y": 3}}, "output.flip_y = 3: expected true or false"),
    ({"start": {"from_result": 3}}, "start: int given; give a result"),
    ({"start": {"from_result": 3, "from_points": 4}}, "start.from_result and start.from_points: give one of them"),
    ({"start": {"from_result": "no_such.vtkhdf"}}, "no_such.vtkhdf: no such result file"),
    ({"solver": {"partition": "file", "partition_file": "no_such.txt"}}, "no_such.txt: cannot read"),
    ({"comm": 3}, "comm: int given; give a communicator of mpi4py"),
])
def test_sections(pair: Pair, mesh: ddic.Mesh, sections: dict[str, Any], words: str) -> None:
    assert words in told(lambda: ddic.measure(pair, mesh, **sections))


@pytest.mark.parametrize(("mesh", "words"), [
    ({"structured": {"element_size": 20}}, "mesh.structured.region: this key is missing"),
    ({"structured": {"region": [20, 20, 140, 120], "element_size": 20, "cel": "T3"}}, 'did you mean "cell"?'),
    ({"structured": {"region": [20, 20, 240, 120], "element_size": 20}}, "the mesh lies outside the image"),
    ({"file": "no_such.msh"}, "no_such.msh: no such mesh file"),
    ({"mapping": {"scale": 3}}, "mesh: none is given"),
    ({"file": ([[0, 0]], [[0]]), "structured": {"region": [0, 0, 9, 9], "element_size": 3}},
     "mesh.structured stands for the mesh; leave one of them out"),
    ({"file": ([[0, 0]], [[0, 0, 0]]), "mapping": {"scale": 0}}, "mesh.mapping.scale = 0: expected more than 0"),
])
def test_sections_of_a_mesh(pair: Pair, mesh: Any, words: str) -> None:
    assert words in told(lambda: ddic.measure(pair, mesh))


def test_several_images_are_a_series(pair: Pair, mesh: ddic.Mesh) -> None:
    images = {"reference": pair[0], "deformed": ["a.tif", "b.tif"]}
    assert "images.deformed: several images; run a case file" in told(lambda: ddic.measure(images=images, mesh=mesh))


def test_what_a_mesh_of_sections_is_refused_for(pair: Pair) -> None:
    """As that of a case file, whether its cells are made one by one or not."""
    for more in ({}, {"circles": [{"center": [80, 70], "radius": 15}]}):
        mesh = {"structured": {"region": [20, 20, 140, 120], "element_size": 20, **more}}
        assert "carries no wave shorter than 3 elements" in told(
            lambda mesh=mesh: ddic.measure(pair, mesh, regularization={"cut_off_wavelength": 30}))
        assert 'did you mean "left"?' in told(
            lambda mesh=mesh: ddic.prepare(pair[0], mesh, regularization={"eta": 3.0, "not_controlled": ["lefft"]}))


def test_keys_that_change_nothing_are_warned_of(pair: Pair, mesh: ddic.Mesh) -> None:
    with pytest.warns(UserWarning, match=r"^arguments: solver.recycle changes nothing here: it goes with"):
        ddic.measure(pair, mesh, solver={"method": "assembled", "recycle": False})


def test_all_wrong_keys_are_told_at_once(pair: Pair, mesh: ddic.Mesh) -> None:
    with pytest.raises(ddic.InputError) as caught:
        ddic.measure(pair, mesh, solver={"subdomain": 4, "threads": 0})
    assert len(caught.value.problems) == 2
    assert all(line.startswith("arguments: solver.") for line in caught.value.problems)


@pytest.mark.parametrize(("kinematics", "words"), [
    (3, "kinematics: int given; give a function that makes it of the mesh"),
    (lambda mesh: None, "the function returned NoneType; return a ddic.RegionKinematics"),
    (lambda mesh: ddic.NodalRegion(ddic.structured_mesh((0, 0, 9, 9), 3)), "made of another mesh"),
    (lambda mesh: ddic.LinearRegion(mesh, np.eye(3)), "the matrix has 3 rows, the mesh 84 displacements"),
    (lambda mesh: ddic.LinearRegion(mesh, np.zeros((mesh.n_dofs, 2))), "unknown 0 displaces no node"),
    (lambda mesh: ddic.LinearRegion(mesh, np.full((mesh.n_dofs, 1), np.nan)), "entries that are not finite"),
    (lambda mesh: ddic.LinearRegion(mesh, "abc"), "str is no matrix of numbers"),
])
def test_own_kinematics(pair: Pair, mesh: ddic.Mesh, kinematics: Any, words: str) -> None:
    assert words in told(lambda: ddic.measure(pair, mesh, kinematics=kinematics))


def test_matrix_of_kinematics_needs_its_mesh(pair: Pair, mesh: ddic.Mesh) -> None:
    made = ddic.NodalRegion(mesh)
    assert "give a function that makes it of the mesh" in told(
        lambda: ddic.measure(pair, mesh, kinematics=made))  # type: ignore[arg-type]


def same_columns(n: int) -> Callable[[ddic.Mesh], ddic.LinearRegion]:
    return lambda given: ddic.LinearRegion(given, np.ones((given.n_dofs, n)))


@pytest.mark.parametrize("method", ["dual", "assembled", "monolithic"])
def test_unknowns_that_do_the_same_have_no_factor(pair: Pair, mesh: ddic.Mesh, method: str) -> None:
    with pytest.raises((ddic.InputError, ddic.SingularSubdomainError)):
        ddic.measure(pair, mesh, kinematics=same_columns(2), solver={"method": method})


def test_unknowns_that_do_the_same_share_the_displacement_by_conjugate_gradients(pair: Pair, mesh: ddic.Mesh) -> None:
    # Nothing is factorised: the displacement is determined, though the unknowns are not.
    settings = {"solver": {"method": "conjugate_gradient", "tolerance": 1e-12}, "gauss_newton": {"tolerance": 1e-10}}
    once, twice = (ddic.measure(pair, mesh, kinematics=same_columns(n), **settings) for n in (1, 2))
    np.testing.assert_allclose(twice.displacement, once.displacement, atol=1e-8)


def test_errors_of_the_users_own_function_come_through(pair: Pair, mesh: ddic.Mesh) -> None:
    with pytest.raises(ZeroDivisionError):
        ddic.measure(pair, mesh, kinematics=lambda given: 1 / 0)  # type: ignore[arg-type,return-value]


@pytest.mark.parametrize(("output", "words"), [
    ("no_such_folder/r.vtkhdf", "there is no folder no_such_folder; make it first"),
    (".", "is a folder; give the name of a file"),
    (3, "int given, the name of a file expected"),
    ({"file": 3}, "int given, the name of a file expected"),
    ({"fil": "r.vtkhdf"}, 'output.fil: unknown key; did you mean "file"?'),
])
def test_outputs(pair: Pair, mesh: ddic.Mesh, output: Any, words: str) -> None:
    assert words in told(lambda: ddic.measure(pair, mesh, output=output))


def test_output_does_not_overwrite_an_image(files: tuple[Path, Path], mesh: ddic.Mesh) -> None:
    for path in files:
        said = told(lambda path=path: ddic.measure(files, mesh, output=path))
        assert f"output: {path} would overwrite the input {path}" in said
        assert path.stat().st_size > 20_000


def test_cases(case_file: Path, pair: Pair, mesh: ddic.Mesh) -> None:
    assert "no_such.toml: cannot read this case file" in told(lambda: ddic.measure("no_such.toml"))
    assert "no_such.toml: cannot read this case file" in told(lambda: ddic.prepare("no_such.toml"))
    assert "a case says its mesh and settings itself" in told(lambda: ddic.measure(case_file, mesh))
    assert "a case says its mesh and settings itself" in told(lambda: ddic.measure(case_file, solver={}))
    assert "there is no folder" in told(lambda: ddic.measure(case_file, output="no_such_folder/r.vtkhdf"))
    case_file.write_text(case_file.read_text().replace("deformed.tif", "missing.tif"))
    assert "missing.tif: no such image file" in told(lambda: ddic.measure(case_file))


@pytest.mark.parametrize("call", [ddic.measure, ddic.prepare])
def test_all_mistakes_of_a_case_file_are_told_at_once(case_file: Path, call: Callable[[Path], object]) -> None:
    text = case_file.read_text().replace("subdomains = 4", 'subdomain = 4\nmethod = "fast"')
    text = text.replace("deformed.tif", "no_such.tif") + "[regularization]\ncut_off_wavelength = 30\n"
    case_file.write_text(text, encoding="utf-8")
    with pytest.raises(ddic.InputError) as caught:
        call(case_file)
    problems = "\n".join(caught.value.problems)
    for words in ("solver.subdomain", "solver.method", "no_such.tif: no such", "no wave shorter than 3 elements"):
        assert words in problems
    # What ddic check says, but for the output: that of the case is not written here.
    with pytest.raises(ddic.InputError) as checked:
        check_case_file(case_file)
    others = [line for line in checked.value.problems if "output.file" not in line]
    assert list(caught.value.problems) == others
    assert len(others) == len(checked.value.problems) - 1


@pytest.mark.parallel([2])
@pytest.mark.parametrize("in_memory", [False, True])
def test_too_many_ranks_hide_no_other_mistake(case_file: Path, *, in_memory: bool) -> None:
    if MPI.COMM_WORLD.rank == 0:
        case_file.write_text(case_file.read_text().replace("subdomains = 4", "subdomains = 1"))
        case_file.with_name("deformed.tif").unlink()
    MPI.COMM_WORLD.barrier()
    with pytest.raises(ddic.InputError) as caught:
        ddic.measure(load_case(case_file) if in_memory else case_file)
    assert is_collective(caught.value)
    missing, ranks = caught.value.problems
    assert "deformed.tif: no such image file" in missing
    assert "1 subdomains for 2 MPI ranks" in ranks


def test_sessions(pair: Pair, mesh: ddic.Mesh) -> None:
    assert "mesh: none is given" in told(lambda: ddic.prepare(pair[0]))
    assert "mesh: none is given" in told(lambda: ddic.prepare("reference.tif"))
    for given in ({"start": ([[50.0, 50.0]], [[0.0, 0.0]])}, {"output": "r.vtkhdf"}, {"images": {"deformed": pair[1]}}):
        assert "give it to session.measure, of each" in told(lambda given=given: ddic.prepare(pair[0], mesh, **given))
    session = ddic.prepare(pair[0], mesh)
    assert told(lambda: session.measure(pair[1], from_last=True)) == (
        "from_last: this session has measured nothing yet")
    session.close()
    session.close()
    assert "session: it is closed" in told(lambda: session.measure(pair[1]))
    assert "session: it is closed" in told(lambda: session.n_factorized)


@pytest.mark.parametrize(("read", "what"), [
    (ddic.load_case, "case file"), (ddic.load_probes, "file of probes"), (ddic.open, "result"),
    (ddic.open_series, "result"), (ddic.choose_regularization, "case")])
@pytest.mark.parametrize("given", [None, 3])
def test_no_name_of_a_file(read: Callable[[Any], object], what: str, given: object) -> None:
    assert told(lambda: read(given)) == f"{what}: {type(given).__name__} given, the name of a file expected"


def test_results(pair: Pair, mesh: ddic.Mesh, tmp_path: Path) -> None:
    assert "no such result file" in told(lambda: ddic.open("no_such.vtkhdf"))
    assert "no such result file" in told(lambda: ddic.open(tmp_path))
    assert "not a readable ddic result file" in told(lambda: ddic.open(__file__))
    assert "int given, the name of a file expected" in told(lambda: ddic.open(3))  # type: ignore[arg-type]
    result = ddic.measure(pair, mesh)
    assert told(lambda: result.plot("strain", numbr="xx")) == 'numbr: unknown argument; did you mean "number"?'
    for points in (np.zeros(2), np.zeros((4, 3)), np.zeros((2, 2, 2))):
        assert "(n, 2) expected: x and y of each point" in told(lambda points=points: result.at(points))


@pytest.mark.parametrize(("arguments", "words"), [
    ((np.zeros_like, (0, 30)), "must be at least 1x1 pixels"),
    ((np.zeros_like, (30.5, 30)), "whole numbers of pixels"),
    ((np.zeros_like, 30), "expected (width, height)"),
    ((3, (30, 30)), "int given, a function of points (n, 2) expected"),
    ((lambda points: points[:, 0], (30, 30)), "returned an array of shape (900,) for points of shape (900, 2)"),
    ((lambda points: -1.5 * points * [1, 0], (30, 30)), "folds the image"),
])
def test_synthetic_pairs(arguments: Any, words: str) -> None:
    assert words in told(lambda: ddic.make_synthetic_pair(*arguments))


@pytest.mark.parametrize(("hole", "words"), [
    (((5, 5), 3), "expected a circle, {"),
    ({"center": (5, 5)}, "expected a circle, {"),
    ({"center": (5, 5), "radius": 3, "radious": 3}, 'hole.radious: unknown key; did you mean "radius"?'),
    ({"center": (5, 5), "radius": -3}, "hole: radius = -3: must be positive"),
])
def test_holes_of_synthetic_pairs(hole: Any, words: str) -> None:
    assert words in told(lambda: ddic.make_synthetic_pair(np.zeros_like, (30, 30), hole=hole))
