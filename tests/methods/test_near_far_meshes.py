"""Whole measurements with a near mesh of its own: an affine field, the matching mesh's result, wrong inputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from mpi4py import MPI

from ddic.case.loader import load_case
from ddic.check.case import check_case
from ddic.cli.app import command_line
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.inputs.cameras import assign_cells, open_cameras
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import build_meshes
from ddic.io.image_file import open_image
from ddic.io.result_reader import read_result
from ddic.kinematics.linear import TiedKinematics
from ddic.methods.run import run_case
from ddic.parallel.team import Team
from ddic.partition.split import find_cameras_at_nodes
from ddic.problem.region_mesh import build_region_mesh, scatter_region, split_region
from ddic.synth.speckle import SpeckleTexture
from support.cases import Ears

RATIO, OFFSET = 3.0, (-160.0, -130.0)
ALPHA = (0.8, -0.6)
GRADIENT, SHIFT = np.array([[0.004, 0.002], [-0.003, -0.002]]), np.array([0.35, -0.2])
FAR, NEAR = (150, 130), (190, 170)
NEAR_MESH = "[near.mesh.structured]\nregion = [64, 52, 104, 84]\nelement_size = {size}\n"
TIGHT = "[gauss_newton]\ntolerance = 1e-9\nrms_tolerance = 1e-10\n"


def displacement(x: np.ndarray) -> np.ndarray:
    return x @ GRADIENT.T + SHIFT


def _grid(size: tuple[int, int]) -> np.ndarray:
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    return np.column_stack([x.ravel(), y.ravel()]).astype(float)


def _write_images(folder: Path) -> None:
    """32-bit images of speckles of 5 far px, of an affine field u: g(T(x + u(x))) = f(x)."""
    texture = SpeckleTexture(3)
    inverse = np.linalg.inv(np.eye(2) + GRADIENT)
    for name, size, ratio, offset, alpha in (("far", FAR, 1.0, (0.0, 0.0), (0.0, 0.0)),
                                             ("near", NEAR, RATIO, OFFSET, ALPHA)):
        seen = (_grid(size) - offset) / ratio
        for state, points in (("f", seen), ("g", (seen - alpha - SHIFT) @ inverse.T)):
            grey = 255 * texture.grey(*points.T)
            tifffile.imwrite(folder / f"{name}_{state}.tif", grey.reshape(size[::-1]).astype(np.float32))


def write(folder: Path, more: str = "", near: str = "", name: str = "case") -> Path:
    if MPI.COMM_WORLD.rank == 0:
        if not (folder / "far_f.tif").exists():
            _write_images(folder)
        (folder / f"{name}.toml").write_text(
            '[images]\nreference = "far_f.tif"\ndeformed = "far_g.tif"\nnoise = 1.0\n'
            f'[[near]]\nreference = "near_f.tif"\ndeformed = "near_g.tif"\nratio = {RATIO}\noffset = {list(OFFSET)}\n'
            f'margin = 2.0\nnoise = 1.0\n{near}'
            "[mesh.structured]\nregion = [24, 20, 128, 108]\nelement_size = 8\n"
            f'{more}[output]\nfile = "{name}.vtkhdf"\nresidual_image = false\n', encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return folder / f"{name}.toml"


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("more", "near"), [
    ("", ""), ("[regularization]\ncut_off_wavelength = 40\n", ""), ("", 'use_far = true\nmotion = "rigid"\n')])
def test_an_affine_field_is_measured(shared_path: Path, more: str, near: str) -> None:
    team = Team(MPI.COMM_WORLD)
    path = write(shared_path, more + "[solver]\nsubdomains = 6\n", near + NEAR_MESH.format(size=3.4))
    summary = run_case(team, path, Ears())

    def check() -> None:
        result = read_result(shared_path / "case.vtkhdf")
        # 13 x 11 far cells, of which 5 x 4 make way for 12 x 9; slaves are stored beside their masters.
        assert result.mesh.n_cells == 13 * 11 - 5 * 4 + 12 * 9
        assert summary.n_dofs == 2 * (14 * 12 - 4 * 3 + 11 * 8)
        error = result.displacement - displacement(result.mesh.nodes)
        near = result.mesh.create_submesh(np.flatnonzero(result.cell_data["Camera"] == 1))[1]
        # Cubic interpolation of speckles of 5 px on elements of 8 px leaves some thousandths of a far pixel, most of it
        # at corners of the far mesh; the near image shows the same speckles in nine times as many pixels, but tied
        # nodes have the far ones' error.
        assert np.sqrt((error**2).mean()) <= 5e-3
        assert np.sqrt((error[near]**2).mean()) <= 2e-3
        np.testing.assert_allclose(summary.near[0].alpha_px, ALPHA, atol=2e-3)
        assert abs(summary.near[0].theta_rad) <= 1e-4
        camera = result.cell_data["Camera"]
        assert int((camera == 1).sum()) == 12 * 9

    team.on_root(check)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("method", ["dual", "assembled"])
def test_the_far_mesh_as_near_mesh_gives_the_same(shared_path: Path, method: str) -> None:
    """Elements of 8 px in both: one to one, hence today's system in another order of nodes."""
    team = Team(MPI.COMM_WORLD)
    more = (f'[regularization]\neta = 1e4\n{TIGHT}[solver]\nmethod = "{method}"\nsubdomains = 5\ntolerance = 1e-12\n'
            "inexact = false\n")
    own = write(shared_path, more, NEAR_MESH.format(size=8), "own")
    plain = write(shared_path, more, "region = [64, 52, 104, 84]\n", "plain")
    summaries = [run_case(team, path, Ears()) for path in (own, plain)]

    def check() -> None:
        found, expected = (read_result(shared_path / f"{name}.vtkhdf") for name in ("own", "plain"))
        places = {tuple(np.round(x, 6)): u for x, u in zip(expected.mesh.nodes, expected.displacement, strict=True)}
        wanted = np.array([places[tuple(np.round(x, 6))] for x in found.mesh.nodes])
        # Gauss-Newton stops at corrections of 1e-10 px.
        assert np.abs(found.displacement - wanted).max() <= 2e-9
        assert np.abs(np.array(summaries[0].near[0].alpha_px) - summaries[1].near[0].alpha_px).max() <= 2e-9
        assert summaries[0].n_dofs == summaries[1].n_dofs

    team.on_root(check)


@pytest.mark.parallel([1, 3])
def test_the_result_starts_another_run(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    more = f"{TIGHT}[solver]\nsubdomains = 5\ntolerance = 1e-12\ninexact = false\n"
    run_case(team, write(shared_path, more, NEAR_MESH.format(size=3.4)), Ears())
    ears = Ears()
    again = write(shared_path, f'[start]\nfrom_result = "case.vtkhdf"\nindependent = false\n{more}',
                  NEAR_MESH.format(size=3.4), "again")
    run_case(team, again, ears)
    # Every node, and those that are tied, are where the first run left them.
    assert ears.records[0].size.rms <= 1e-8


@pytest.mark.parametrize(("near", "message"), [
    (NEAR_MESH.format(size=3.4).replace("[64,", "[66,"), r"near, entry 1: the outline of its mesh cuts 4 far elements"),
    ("[near.mesh.structured]\nregion = [74, 62, 78, 66]\nelement_size = 2\n", "no boundary in common"),
    ("[near.mesh.structured]\nregion = [40, 52, 104, 84]\nelement_size = 4\n",
     "near, entry 1: its images do not show all of near.mesh, for instance column 44, row 56"),
    ("region = [64, 52, 104, 84]\n" + NEAR_MESH.format(size=4), "near.region chooses elements of"),
    ('[near.mesh]\nfile = "nowhere.msh"\n', "nowhere.msh"),
])
def test_wrong_near_meshes_are_refused(tmp_path: Path, near: str, message: str) -> None:
    path = write(tmp_path, near=near)
    with pytest.raises(InputError, match=message):
        check_case(load_case(path))


def test_near_fields_with_and_without_a_mesh(tmp_path: Path) -> None:
    """The second sees columns 78 to 140, of which it measures far elements only."""
    second = (f'[[near]]\nreference = "near_f.tif"\ndeformed = "near_g.tif"\nratio = {RATIO}\noffset = [-232, -130]\n'
              "margin = 2.0\n")
    case = load_case(write(tmp_path, "[solver]\nsubdomains = 9\n", NEAR_MESH.format(size=3.4) + second)).case
    mesh, tying = build_meshes(case, Window.of_size(*FAR))
    cameras = open_cameras(case, open_image)
    labels = assign_cells(cameras, mesh, tying)
    np.testing.assert_array_equal(labels == 1, tying.cameras == 1)
    far = tying.cameras == 0
    low = np.minimum.reduceat(mesh.nodes[mesh.connectivity], mesh.offsets[:-1], axis=0)
    high = np.maximum.reduceat(mesh.nodes[mesh.connectivity], mesh.offsets[:-1], axis=0)
    seen = (RATIO * low - (232, 130) >= 2).all(axis=1) & (RATIO * high - (232, 130) <= np.array(NEAR) - 3).all(axis=1)
    np.testing.assert_array_equal(labels[far], 2 * seen[far])
    region_mesh = build_region_mesh(Inputs(case, cameras, lambda: (mesh, tying)))
    subdomains, _ = scatter_region(Team.alone(), region_mesh.inputs, region_mesh, split_region(region_mesh, 1))
    assert [s.camera for s in subdomains] == sorted(labels[s.cell_ids[0]] for s in subdomains)
    assert {s.camera for s in subdomains} == {0, 1, 2}
    assert {s.camera for s in subdomains if isinstance(s.kinematics, TiedKinematics)} == {1}
    # The right side of the near mesh touches elements of the second near field.
    masters = np.unique(tying.weights[tying.n_unknown_nodes:].indices)
    right = masters[mesh.nodes[masters, 0] == 104]
    assert len(right) == 5
    at_nodes = find_cameras_at_nodes(mesh, labels, 3, tying.weights)
    assert at_nodes[right].sum(axis=1).min() > 1


def test_a_coarse_near_mesh_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, near=NEAR_MESH.format(size=13))
    with pytest.raises(InputError, match="use smaller near elements than far ones"):
        run_case(Team(MPI.COMM_SELF), path, Ears())


def test_the_report_counts_unknowns(tmp_path: Path) -> None:
    report = check_case(load_case(write(tmp_path, "[regularization]\ncut_off_wavelength = 40\n",
                                          NEAR_MESH.format(size=3.4))))
    n_unknown_nodes = 14 * 12 - 4 * 3 + 11 * 8
    assert report.n_dofs == 2 * n_unknown_nodes
    assert report.n_controlled_dofs == 2 * (n_unknown_nodes - 2 * (13 + 11))
    assert report.n_nodes == n_unknown_nodes + 2 * (12 + 9)


def test_meshes_that_do_not_match_are_not_written(tmp_path: Path) -> None:
    case = write(tmp_path, near=NEAR_MESH.format(size=3))
    done = CliRunner().invoke(command_line, ["mesh", str(case), "-o", str(tmp_path / "mesh.vtu")])
    assert done.exit_code == 2
    assert done.stderr.strip() == (f"{case}: near.mesh: meshes that do not match are not one that mesh.file could "
                                   "read; leave near.mesh out")
    assert not (tmp_path / "mesh.vtu").exists()
