"""Meshes from files."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from ddic.errors import InputError
from ddic.io.mesh_file import read_mesh, write_mesh
from ddic.mesh.cell_type import Q4, T3, TET4
from ddic.mesh.grid import GridBlock
from ddic.mesh.mesh import Mesh, Similarity, build_mesh
from ddic.mesh.repair import repair
from ddic.mesh.structured import build_grid_lines, build_structured_mesh

POINTS = np.array([[0, 0, 2], [1, 0, 2], [2, 0, 2], [2, 1, 2], [1, 1, 2], [0, 1, 2], [9, 9, 7]], dtype=float)
CELLS = [
    ("triangle", np.array([[1, 2, 3]])),
    ("quad", np.array([[0, 1, 4, 5]])),
    ("triangle", np.array([[1, 3, 4]])),
    ("line", np.array([[5, 0], [2, 3]])),
    ("vertex", np.array([[4]])),
]


def _write(path: Path) -> Path:
    meshio.Mesh(POINTS, CELLS).write(path)
    return path


def test_mixed_cells_keep_the_order_of_the_file(tmp_path: Path) -> None:
    mesh = read_mesh(_write(tmp_path / "a.vtu"), Similarity(), 2)
    assert mesh.types.tolist() == [T3.vtk, Q4.vtk, T3.vtk]
    assert mesh.cells.tolist() == [[1, 2, 3, -1], [0, 1, 4, 5], [1, 3, 4, -1]]
    assert mesh.nodes.shape == (7, 2)
    assert repair(mesh).n_nodes == 6


@pytest.mark.parametrize("file_format", ["gmsh", "gmsh22"])
def test_physical_groups_become_node_sets(tmp_path: Path, file_format: str) -> None:
    cells = [*CELLS[:3], ("line", np.array([[5, 0]])), ("line", np.array([[2, 3]])), CELLS[4]]
    physical = [np.array([tag]) for tag in (9, 9, 9, 1, 2, 1)]
    # Format 4.1 wants a geometrical entity for each block, named by its nodes too.
    entities = [np.array([tag]) for tag in (21, 22, 23, 11, 12, 1)]
    mesh = meshio.Mesh(
        POINTS, cells, cell_data={"gmsh:physical": physical, "gmsh:geometrical": entities},
        field_data={"left": np.array([1, 1]), "right": np.array([2, 1]), "pin": np.array([1, 0]),
                    "body": np.array([9, 2])},
        point_data={"gmsh:dim_tags": np.array([[1, 11], [2, 21], [1, 12], [2, 23], [0, 1], [1, 11], [2, 22]])})
    meshio.write(tmp_path / "a.msh", mesh, file_format=file_format, binary=False)
    read = read_mesh(tmp_path / "a.msh", Similarity(), 2)
    found = {name: sorted(map(tuple, read.nodes[nodes])) for name, nodes in read.node_sets.items()}
    # The tags 1 of dimensions 0 and 1 are different groups. Format 4.1 numbers nodes by entity: compare places.
    assert found == {"left": [(0, 0), (0, 1)], "right": [(2, 0), (2, 1)], "pin": [(1, 1)]}


def test_abaqus_sets_become_node_sets(tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text("*NODE\n1, 0., 0.\n2, 1., 0.\n3, 1., 1.\n4, 0., 1.\n*ELEMENT, TYPE=CPS4\n1, 1, 2, 3, 4\n"
                    "*NSET, NSET=grip\n1, 4\n")
    mesh = read_mesh(path, Similarity(), 2)
    assert {name.lower(): nodes.tolist() for name, nodes in mesh.node_sets.items()} == {"grip": [0, 3]}


def test_cell_sets_of_lines_become_node_sets(tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text("*NODE\n1, 0., 0.\n2, 1., 0.\n3, 1., 1.\n4, 0., 1.\n*ELEMENT, TYPE=CPS4, ELSET=body\n"
                    "1, 1, 2, 3, 4\n*ELEMENT, TYPE=T3D2, ELSET=edge\n2, 2, 3\n")
    assert len(meshio.read(path).cell_sets) == 2
    mesh = read_mesh(path, Similarity(), 2)
    assert {name.lower(): nodes.tolist() for name, nodes in mesh.node_sets.items()} == {"edge": [1, 2]}


def test_mapping_to_pixels(tmp_path: Path) -> None:
    mapping = Similarity(10.0, np.pi / 2, (100.0, 50.0))
    mesh = read_mesh(_write(tmp_path / "a.vtu"), mapping, 2)
    # A quarter turn takes (2, 1) to (-1, 2); ten pixels per unit.
    np.testing.assert_allclose(mesh.nodes[3], [90.0, 70.0], atol=1e-12)
    assert mesh.mapping == mapping


@pytest.mark.parametrize(("cells", "words"), [
    ([("triangle6", np.array([[0, 1, 2, 3, 4, 5]]))], "holds 1 triangle6"),
    ([("tetra", np.array([[0, 1, 4, 6]])), ("triangle", np.array([[0, 1, 4]]))], "holds 1 tetra, 1 triangle"),
    ([("line", np.array([[0, 1]]))], "holds no triangle and no quadrilateral"),
])
def test_other_cells_are_refused(tmp_path: Path, cells: list[tuple[str, np.ndarray]], words: str) -> None:
    meshio.Mesh(POINTS, cells).write(tmp_path / "a.vtu")
    with pytest.raises(InputError, match=words):
        read_mesh(tmp_path / "a.vtu", Similarity(), 2)


@pytest.mark.parametrize(("cells", "words"), [
    ([("wedge", np.array([[0, 1, 2, 3, 4, 5]]))], "only linear tetrahedra and hexahedra.* holds 1 wedge"),
    ([("triangle", np.array([[0, 1, 4]]))], "holds no tetrahedron and no hexahedron"),
])
def test_cells_that_are_not_measured_in_a_volume_are_refused(tmp_path: Path, cells: list[tuple[str, np.ndarray]],
                                                             words: str) -> None:
    meshio.Mesh(POINTS, cells).write(tmp_path / "a.vtu")
    with pytest.raises(InputError, match=words):
        read_mesh(tmp_path / "a.vtu", Similarity(), 3)


def test_faces_name_node_sets_in_a_volume(tmp_path: Path) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    cells = [("tetra", np.array([[0, 1, 2, 3]])), ("triangle", np.array([[0, 2, 1], [0, 1, 3]]))]
    meshio.Mesh(points, cells, cell_sets={"bottom": [np.zeros(0, int), np.array([0])]}).write(tmp_path / "a.inp")
    mesh = read_mesh(tmp_path / "a.inp", Similarity(2.0, translation=(5.0, 6.0, 7.0)), 3)
    assert {name.lower(): nodes.tolist() for name, nodes in mesh.node_sets.items()} == {"bottom": [0, 1, 2]}
    np.testing.assert_array_equal(mesh.nodes, 2 * points + [5, 6, 7])


def test_mesh_that_is_not_plane_is_refused(tmp_path: Path) -> None:
    meshio.Mesh(POINTS, [("triangle", np.array([[0, 1, 6]]))]).write(tmp_path / "a.vtu")
    with pytest.raises(InputError, match="not plane: z varies by 5"):
        read_mesh(tmp_path / "a.vtu", Similarity(), 2)


@pytest.mark.parametrize(("name", "content", "words"), [
    ("a.msh", "no mesh at all", "meshio cannot read this mesh"),
    ("a.vtu", "<VTKFile", "meshio cannot read this mesh"),
    ("a.nonsense", "x", "meshio cannot read this mesh"),
    ("a.inp", "*NODE\n1, a, b\n", "meshio cannot read this mesh"),
])
def test_unreadable_files_are_refused_quietly(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str,
                                              content: str, words: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=words) as caught:
        read_mesh(tmp_path / name, Similarity(), 2)
    assert "\n" not in str(caught.value)
    assert capsys.readouterr() == ("", "")


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such mesh file"):
        read_mesh(tmp_path / "a.msh", Similarity(), 2)


WRITTEN = {
    "quadrilaterals and triangles": build_structured_mesh(((101.7, 90.2), 60.3), 8, circles=[((100.0, 98.0), 20.0)]),
    "triangles": build_structured_mesh((0, 0, 40, 30), 10, "T3"),
    # Cells of one type after those of the other and before more, a set of one node, one of none.
    "hexahedra": build_grid_lines((0, 1, 2, 8, 13, 10), 4).cut_block(GridBlock((range(2), range(3), range(2)))).mesh,
    "tetrahedra": build_mesh(np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 5], [3, 4, 5.5]]),
                             {TET4: np.array([[0, 1, 2, 3], [1, 2, 3, 4]])}, {"tip": np.array([4])}),
    "mixed": build_mesh(POINTS[:6, :2] / 3, [(T3, np.array([[1, 2, 3]])), (Q4, np.array([[0, 1, 4, 5]])),
                                             (T3, np.array([[1, 3, 4]]))],
                        {"a pin": np.array([4]), "edge": np.array([0, 5]), "none": np.zeros(0, np.int64)}),
}


def assert_same(read: Mesh, mesh: Mesh) -> None:
    np.testing.assert_array_equal(read.nodes, mesh.nodes)
    np.testing.assert_array_equal(read.types, mesh.types)
    np.testing.assert_array_equal(read.cells, mesh.cells)
    sets = {name: nodes.tolist() for name, nodes in mesh.node_sets.items() if len(nodes)}
    assert {name: nodes.tolist() for name, nodes in read.node_sets.items()} == sets


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("suffix", [".vtu", ".inp", ".VTU"])
def test_what_is_written_is_read_back_the_same(tmp_path: Path, name: str, suffix: str,
                                               capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"mesh{suffix}"
    write_mesh(path, WRITTEN[name])
    assert_same(read_mesh(path, Similarity(), WRITTEN[name].dim), WRITTEN[name])
    assert list(tmp_path.iterdir()) == [path]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["mesh.msh", "mesh.vtk", "mesh"])
def test_formats_that_lose_node_sets_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"node sets would be lost; give a name that ends in .vtu or .inp"):
        write_mesh(tmp_path / name, WRITTEN["mixed"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("suffix", "name"), [
    (".inp", " lead"), (".inp", "a=b"), (".vtu", "a&b"), (".vtu", "a<b"), (".vtu", 'a"b')])
def test_a_set_that_a_format_cannot_name_is_refused(tmp_path: Path, suffix: str, name: str) -> None:
    """meshio writes such files, and nobody reads them."""
    mesh = build_mesh(POINTS[:3, :2], [(T3, np.array([[0, 1, 2]]))], {name: np.array([1])})
    with pytest.raises(InputError, match=f'cannot name the node set "{name}"; write a'):
        write_mesh(tmp_path / f"m{suffix}", mesh)
    assert not list(tmp_path.iterdir())


def test_a_set_that_abaqus_cannot_name_is_refused(tmp_path: Path) -> None:
    mesh = build_mesh(POINTS[:3, :2] * [1, 1], [(T3, np.array([[0, 1, 2]]))], {"a,b": np.array([1])})
    with pytest.raises(InputError, match=r'cannot name the node set "a,b"; write a .vtu file'):
        write_mesh(tmp_path / "mesh.inp", mesh)
    write_mesh(tmp_path / "mesh.vtu", mesh)
    assert read_mesh(tmp_path / "mesh.vtu", Similarity(), 2).node_sets["a,b"].tolist() == [1]


@pytest.mark.real_data
def test_open_hole_mesh(real_data: Path) -> None:
    mesh = repair(read_mesh(real_data / "openhole" / "mesh_q4_pixels.msh", Similarity(), 2))
    assert (mesh.n_nodes, mesh.n_cells) == (1500, 1404)
    assert set(mesh.types) == {Q4.vtk}
    # 32 lines on two clamped edges have 34 nodes.
    assert {name: len(nodes) for name, nodes in mesh.node_sets.items()} == {"loaded_ends": 34}
