"""``ddic mesh``: the mesh of a case is read back the same."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from click.testing import CliRunner, Result

from ddic.case.loader import load_case
from ddic.cli.app import command_line
from ddic.images.window import Window
from ddic.inputs.mesh_source import build_meshes
from ddic.io.mesh_file import write_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from support.cases import write_images

IMAGES = '[images]\nreference = "f.tif"\ndeformed = "g.tif"\n'
CIRCLE = "region = { center = [96.3, 90.1], radius = 60.7 }\nelement_size = 11\n"
KINDS = {
    "box": "[mesh.structured]\nregion = [24, 24, 168, 168]\nelement_size = 16\n",
    "circle": f"[mesh.structured]\n{CIRCLE}circles = [{{ center = [96, 90], radius = 20 }}]\n",
    "triangles of gmsh": f"[mesh.unstructured]\n{CIRCLE}",
    "file with a mapping": '[mesh]\nfile = "given.inp"\nmapping = { scale = 1.7, rotation_degrees = 3.3, '
                           "translation = [20.1, 18.7], y_up = false }\n",
    "pgd": "[mesh.structured]\nregion = [24, 24, 168, 168]\nelement_size = 16\n[pgd]\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_images(tmp_path)
    write_mesh(tmp_path / "given.inp", build_structured_mesh((0, 0, 60, 60), 10, circles=[((30.0, 30.0), 12.0)]))
    return tmp_path


def write(folder: Path, mesh: str, name: str = "case") -> Path:
    path = folder / f"{name}.toml"
    path.write_text(IMAGES + mesh)
    return path


def call(*words: object) -> Result:
    return CliRunner().invoke(command_line, [str(word) for word in words])


def mesh_of(path: Path) -> Mesh:
    return build_meshes(load_case(path).case, Window.of_size(192, 192))[0]


@pytest.mark.parametrize("suffix", [".vtu", ".inp"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_mesh_is_read_back_the_same(folder: Path, kind: str, suffix: str) -> None:
    if "gmsh" in kind:
        pytest.importorskip("gmsh")
    case, output = write(folder, KINDS[kind]), folder / f"plate{suffix}"
    for _ in range(2):
        # The second time it replaces its own file.
        done = call("mesh", case, "-o", output)
        assert done.exit_code == 0, done.stderr
    mesh, read = mesh_of(case), mesh_of(write(folder, f'[mesh]\nfile = "{output.name}"\n', "again"))
    np.testing.assert_array_equal(read.nodes, mesh.nodes)
    np.testing.assert_array_equal(read.types, mesh.types)
    np.testing.assert_array_equal(read.cells, mesh.cells)
    assert {name: nodes.tolist() for name, nodes in read.node_sets.items()} == {
        name: nodes.tolist() for name, nodes in mesh.node_sets.items()}
    assert f"{mesh.n_nodes} nodes, {mesh.n_cells} cells" in done.output
    assert f"left ({len(mesh.node_sets['left'])} nodes)" in done.output


@pytest.mark.parametrize(("name", "words"), [
    ("plate.msh", "node sets would be lost; give a name that ends in .vtu or .inp"),
    ("none/plate.vtu", "does not exist"), ("linked.inp", "would overwrite the input"),
    ("other.vtu", "is there already, and no mesh that ddic wrote"),
    ("of_meshio.vtu", "is there already, and no mesh that ddic wrote"),
])
def test_bad_outputs_are_refused_in_a_line(folder: Path, name: str, words: str) -> None:
    (folder / "other.vtu").write_text("my own")
    meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])]).write(folder / "of_meshio.vtu")
    os.link(folder / "given.inp", folder / "linked.inp")
    before = {path: path.read_bytes() for path in folder.iterdir()}
    done = call("mesh", write(folder, KINDS["file with a mapping"]), "-o", folder / name)
    assert done.exit_code == 2
    (line,) = done.stderr.strip().splitlines()
    assert words in line
    assert {path: path.read_bytes() for path in before} == before


def test_without_gmsh_the_exit_code_is_2(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gmsh", None)
    for command in (["mesh", "-o", str(folder / "plate.vtu")], ["check"]):
        done = call(command[0], write(folder, KINDS["triangles of gmsh"]), *command[1:])
        assert done.exit_code == 2
        (line,) = done.stderr.strip().splitlines()
        assert "pip install gmsh" in line
