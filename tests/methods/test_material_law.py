"""The regularization's material: plastic over a series, and stiffer or softer by regions; on any number of ranks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI

from accept.support.plastic_neck import GridField, draw_strip
from ddic.case.loader import load_case
from ddic.check.case import check_case_file
from ddic.errors import InputError
from ddic.functionals.plasticity import PlasticLaw
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.inputs.mesh_source import weigh_stiffness
from ddic.io.series_reader import SeriesResult, read_series
from ddic.mesh.structured import build_structured_mesh
from ddic.methods.run import run_file
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture
from support.interrupted import interrupt

LAW = PlasticLaw(0.3, 0.002, 0.05)
ELONGATIONS = np.array([0.6, 1.2, 2.0])
WIDTH, HEIGHT, RADIUS = 160.0, 96.0, 28.0

CASE = """
[images]
reference = "f.tif"
deformed = ["g0.tif", "g1.tif", "g2.tif"]
[mesh.structured]
region = [8, 8, 152, 88]
element_size = 8
circles = [{{ center = [80, 0], radius = 28 }}, {{ center = [80, 96], radius = 28 }}]
[regularization]
cut_off_wavelength = 96
{law}
[solver]
method = "{method}"
subdomains = {subdomains}
tolerance = 1e-12
[gauss_newton]
tolerance = 1e-9
rms_tolerance = 1e-9
largest_tolerance = 1e-8
[output]
file = "{name}.vtkhdf"
"""

PLASTIC = "yield_strain = 0.002\nhardening_ratio = 0.05"


@pytest.fixture(scope="module")
def fields() -> list[GridField]:
    return draw_strip(LAW, (0.0, 0.0, WIDTH, HEIGHT), RADIUS, ELONGATIONS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, fields: list[GridField]) -> Path:
    path = None
    if MPI.COMM_WORLD.rank == 0:
        path = tmp_path_factory.mktemp("neck")
        for number, field in enumerate(fields):
            pair = render_pair(Scene(SpeckleTexture(3), field), Picture(161, 97, Digitiser(16, 1.0)))
            tifffile.imwrite(path / "f.tif", pair.reference)
            tifffile.imwrite(path / f"g{number}.tif", pair.deformed)
    return MPI.COMM_WORLD.bcast(path)


def _write(folder: Path, name: str, law: str, method: str = "dual", subdomains: int = 4, *,
           alone: bool = False) -> Path:
    path = folder / f"{name}.toml"
    if MPI.COMM_WORLD.rank == 0:
        path.write_text(CASE.format(law=law, method=method, subdomains=subdomains, name=name))
    if not alone:
        MPI.COMM_WORLD.barrier()
    return path


def _run(path: Path, team: Team) -> SeriesResult:
    run_file(team, path, Silence())
    return read_series(path.with_suffix(".vtkhdf"))


def _sort(nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    return values[np.lexsort(nodes.T)]


def _measure_error(result: SeriesResult, fields: list[GridField]) -> float:
    squares = [((frame.displacement[:, :2] - field.displacement(frame.mesh.nodes))**2).mean()
               for frame, field in zip(result, fields, strict=True)]
    return float(np.sqrt(np.mean(squares)))


def test_a_plastic_law_is_twice_as_near_as_elasticity(folder: Path, fields: list[GridField]) -> None:
    elastic, plastic = (_run(_write(folder, name, law), Team.alone()) for name, law in (("elastic", ""),
                                                                                       ("plastic", PLASTIC)))
    assert _measure_error(plastic, fields) < 0.5 * _measure_error(elastic, fields)


@pytest.mark.parallel([1, 2, 3])
def test_a_plastic_neck_is_the_same_on_any_ranks_and_subdomains(folder: Path) -> None:
    team = Team.world()
    _run(_write(folder, "dual", PLASTIC), team)
    if team.is_root:
        _run(_write(folder, "whole", PLASTIC, "assembled", 1, alone=True), Team.alone())
        spread, whole = (list(read_series(folder / f"{name}.vtkhdf"))[-1] for name in ("dual", "whole"))
        assert spread.cell_data["plastic_strain"].max() > 0.01
        # Both come to rest at 1e-8 px, and what they differ by there grows with each frame's flow.
        np.testing.assert_allclose(_sort(spread.mesh.nodes, spread.displacement),
                                   _sort(whole.mesh.nodes, whole.displacement), atol=1e-6)
    team.wait_for_all()


@pytest.mark.parallel([1, 2])
def test_a_resumed_series_has_the_history_of_the_frames_before(folder: Path) -> None:
    _run(_write(folder, "unbroken", PLASTIC), Team.world())
    path = _write(folder, "broken", PLASTIC)
    interrupt(path, 3)
    summary = run_file(Team.world(), path, Silence(), resume=True)
    assert summary.n_resumed == 2
    if Team.world().is_root:
        broken, unbroken = (list(read_series(folder / f"{name}.vtkhdf"))[-1] for name in ("broken", "unbroken"))
        np.testing.assert_array_equal(broken.displacement, unbroken.displacement)
        np.testing.assert_array_equal(broken.cell_data["plastic_strain"], unbroken.cell_data["plastic_strain"])
    Team.world().wait_for_all()


@pytest.mark.parametrize(("keys", "told"), [
    ('hardening_ratio = 0.1', "regularization.hardening_ratio goes with regularization.yield_strain"),
    ('yield_strain = 0.002\nplane = "strain"', "plasticity is that of an isotropic material in plane stress"),
    ('[[regularization.stiffness]]\nregion = "inclusion"\nratio = 3', 'no \\[\\[region\\]\\] has this name'),
    ('yield_strain = 0.002\n[output]\nuncertainty = true\n[series]', "does not go with output.uncertainty"),
])
def test_laws_that_cannot_be_followed_are_refused(folder: Path, keys: str, told: str) -> None:
    path = _write(folder, "refused", keys)
    if "uncertainty" in keys:
        path.write_text(path.read_text().replace('[output]\nfile = "refused.vtkhdf"\n', ""))
    with pytest.raises(InputError, match=told):
        load_case(path)


def test_bars_of_other_stiffness_share_a_displacement(tmp_path: Path) -> None:
    """Three bars in a row, of which mechanics alone know the middle one, half as stiff: it takes twice the strain."""
    mesh = build_structured_mesh((0.0, 0.0, 96.0, 16.0), 8.0)
    relative = np.where(np.abs(mesh.centroids[:, 0] - 48.0) < 16.0, 0.5, 1.0)
    stiffness = assemble_stiffness(mesh, Material(0.0, "stress"), relative)
    # Equal forces along all bars: with nu = 0 the field is piecewise linear.
    x = mesh.nodes[:, 0]
    strain = 1e-3
    u = strain * (np.minimum(x, 32.0) + 2.0 * np.clip(x - 32.0, 0.0, 32.0) + np.maximum(x - 64.0, 0.0))
    forces = (stiffness @ np.column_stack([u, np.zeros(len(u))]).ravel()).reshape(-1, 2)
    inner = (x > 0) & (x < 96)
    np.testing.assert_allclose(forces[inner], 0.0, atol=1e-16)
    assert np.abs(forces[~inner, 0]).sum() == pytest.approx(2 * strain * 16.0)


def test_a_part_without_cells_is_refused(folder: Path) -> None:
    keys = """
[[regularization.stiffness]]
region = "beside"
ratio = 3
[[region]]
name = "beside"
shape = [400, 400, 480, 496]
"""
    with pytest.raises(InputError, match=r'stiffness.region = "beside": holds no cell'):
        check_case_file(_write(folder, "beside", keys))


def test_a_case_weighs_the_stiffness_of_its_regions(folder: Path) -> None:
    keys = """
[[regularization.stiffness]]
region = "left half"
ratio = 3
[[region]]
name = "left half"
shape = [0, 0, 80, 96]
"""
    case = load_case(_write(folder, "regions", keys)).case
    mesh = build_structured_mesh((8.0, 8.0, 152.0, 88.0), 8.0)
    np.testing.assert_array_equal(weigh_stiffness(case, mesh), np.where(mesh.centroids[:, 0] < 80.0, 3.0, 1.0))
