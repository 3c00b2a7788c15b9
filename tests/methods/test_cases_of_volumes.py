"""Cases with volumes through what cases alone have: mesh files, a sweep, a reference that is updated, large turns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import ddic
from ddic.case.loader import load_case
from ddic.cli.app import command_line
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.inputs.mesh_source import build_meshes
from ddic.io.mesh_file import write_mesh
from ddic.mesh.cell_type import TET4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh
from support.random_meshes import WAYS, grid_mesh
from support.volumes import GRADIENT, TRANSLATION, displace, make_pair

SIZE = 32
LINES = np.array([4.0, 12.0, 20.0, 28.0])
# Of cubic interpolation on waves of 6 px and more (test_measure_volumes.py).
BIAS = 0.01


def write_case(folder: Path, mesh: str, more: str = "", deformed: str = '"g_1.tif"') -> Path:
    path = folder / "case.toml"
    path.write_text(f'[volumes]\nreference = "f.tif"\ndeformed = {deformed}\n{mesh}\n{more}'
                    '[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    return path


def write_volumes(folder: Path, n_frames: int = 1) -> None:
    """Frames that move on as far each as the first one."""
    for number in range(1, n_frames + 1):
        f, g = make_pair(SIZE, number * GRADIENT, number * TRANSLATION)
        tifffile.imwrite(folder / "f.tif", f)
        tifffile.imwrite(folder / f"g_{number}.tif", g)


def build_cells(kind: str) -> Mesh:
    cubes = GridLines((LINES,) * 3).build_mesh()
    return cubes if kind == "Hex8" else build_mesh(cubes.nodes, {TET4: cubes.cells[:, WAYS].reshape(-1, 4)})


@pytest.mark.parametrize("kind", ["Hex8", "Tet4"])
def test_a_mesh_file_is_measured(tmp_path: Path, kind: str) -> None:
    write_volumes(tmp_path)
    # In units of two voxels, from a corner at (4, 4, 4).
    mesh = build_cells(kind)
    write_mesh(tmp_path / "mesh.vtu", build_mesh((mesh.nodes - 4.0) / 2.0,
                                                 {block.type: block.nodes for block in mesh.cell_blocks}))
    case = write_case(tmp_path, '[mesh]\nfile = "mesh.vtu"\n[mesh.mapping]\nscale = 2.0\ntranslation = [4, 4, 4]')
    result = ddic.measure(case)
    assert result.mesh.n_cells == mesh.n_cells
    np.testing.assert_allclose(result.displacement, displace(result.mesh.nodes, SIZE), atol=BIAS)


def test_a_plane_mesh_file_is_refused(tmp_path: Path) -> None:
    write_volumes(tmp_path)
    write_mesh(tmp_path / "mesh.vtu", grid_mesh(2, 2, (8.0, 8.0), origin=(4.0, 4.0)))
    loaded = load_case(write_case(tmp_path, '[mesh]\nfile = "mesh.vtu"'))
    with pytest.raises(InputError, match="holds no tetrahedron and no hexahedron"):
        build_meshes(loaded.case, Window.of_size(SIZE, SIZE, SIZE))


BOX = "[mesh.structured]\nregion = [4, 4, 4, 28, 28, 28]\nelement_size = 8"


def test_a_sweep_writes_its_table(tmp_path: Path) -> None:
    write_volumes(tmp_path)
    write_case(tmp_path, BOX)
    words = ["sweep", str(tmp_path / "case.toml"), "--lengths", "0", "--elements", "8,12"]
    done = CliRunner().invoke(command_line, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    table = (tmp_path / "case.sweep.csv").read_text(encoding="utf-8").splitlines()
    assert sum(not line.startswith("#") for line in table) == 3


def test_a_reference_that_is_updated_gives_fields_since_the_first(tmp_path: Path) -> None:
    write_volumes(tmp_path, 2)
    case = write_case(tmp_path, BOX, '[series]\nincremental = "always"\n', '["g_1.tif", "g_2.tif"]')
    done = CliRunner().invoke(command_line, ["run", str(case)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    last = ddic.open_series(tmp_path / "result.vtkhdf")[1]
    expected = displace(last.mesh.nodes, SIZE, 2 * GRADIENT, 2 * TRANSLATION)
    # The bias of two measurements, the second of which is interpolated between nodes.
    np.testing.assert_allclose(last.displacement, expected, atol=3 * BIAS)


def test_masks_and_updates_do_not_go_together(tmp_path: Path) -> None:
    write_volumes(tmp_path, 2)
    tifffile.imwrite(tmp_path / "mask.tif", np.full((SIZE,) * 3, 255, np.uint8))
    case = write_case(tmp_path, BOX, '[series]\nincremental = "always"\n', '["g_1.tif", "g_2.tif"]\nmask = "mask.tif"')
    done = CliRunner().invoke(command_line, ["run", str(case)])
    assert done.exit_code == 2
    assert "masks of volumes do not move with the specimen; leave volumes.mask out" in done.stderr
