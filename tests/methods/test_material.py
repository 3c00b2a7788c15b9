"""ddic compare and ddic identify: what they print and write, on any number of ranks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI

from accept.support.orthotropic_hole import OrthotropicHole
from ddic.errors import InputError
from ddic.io.mesh_file import convert_to_meshio
from ddic.io.result_reader import read_result
from ddic.mesh.structured import build_structured_mesh
from ddic.methods.material import compare_case, identify_case
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.synth.fields import Hole
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture
from support.commands import ddic

LAW = (5.0, 1.0, 0.28, 0.6, 30.0)
FIELD = OrthotropicHole(LAW, (120.0, 120.0), 32.0, (0.0, 0.02, 0.0), (0.3, -0.2))

CASE = """
[images]
reference = "f.tif"
deformed = "g.tif"
[mesh.structured]
region = [24, 24, 216, 216]
element_size = 8
circles = [{ center = [120, 120], radius = 32 }]
[solver]
method = "dual"
subdomains = 4
tolerance = 1e-10
[gauss_newton]
rms_tolerance = 1e-6
largest_tolerance = 1e-5
tolerance = 1e-9
[[region]]
name = "left"
shape = [0, 0, 120, 240]
"""

LAWS = """
[identification]
loaded = ["left", "right", "top", "bottom"]
[[identification.material]]
law = "orthotropic"
young_1 = 4.2
poisson_ratio = 0.33
shear = 0.5
angle_degrees = 30
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = None
    if MPI.COMM_WORLD.rank == 0:
        path = tmp_path_factory.mktemp("hole")
        pair = render_pair(Scene(SpeckleTexture(3), FIELD, Hole((120.0, 120.0), 32.0)),
                           Picture(240, 240, Digitiser(32, 1.0)))
        tifffile.imwrite(path / "f.tif", pair.reference)
        tifffile.imwrite(path / "g.tif", pair.deformed)
        (path / "case.toml").write_text(CASE + LAWS)
        mesh = build_structured_mesh((16.0, 16.0, 224.0, 224.0), 4.0, circles=[((120.0, 120.0), 32.0)])
        moved = FIELD.displacement(mesh.nodes) + np.array([5.0, -3.0])
        for name, u in (("right", moved), ("wrong", 0.8 * moved)):
            convert_to_meshio(mesh, {"U": np.pad(u, ((0, 0), (0, 1)))}).write(path / f"{name}.vtu")
    return MPI.COMM_WORLD.bcast(path)


@pytest.mark.parallel([1, 2, 3])
def test_parameters_are_found_and_the_same_on_any_ranks(folder: Path) -> None:
    summary = identify_case(Team.world(), folder / "case.toml", Silence())
    table = summary.identification
    values, deviations = np.array(table["value"]), np.array(table["deviation"])
    assert table["parameter"] == ["young_1", "poisson_ratio", "shear"]
    # Four standard deviations, and what elements a quarter of the hole's radius leave, as the warning says.
    allowed = 4.0 * deviations + 2.0 * np.abs(table["by_halving"])
    assert (np.abs(values - np.array(LAW)[[0, 2, 3]]) < allowed).all()
    # FEMU from the field says the same.
    assert (np.abs(values - table["by_fields"]) < 0.5 * deviations).all()
    # Four subdomains, on one rank or several: rounding of sums.
    alone = _identify_alone(folder)
    assert values == pytest.approx(alone, rel=1e-9)
    result = read_result(folder / "result.vtkhdf") if MPI.COMM_WORLD.rank == 0 else None
    if result is not None:
        assert result.identified["value"] == pytest.approx(values)
        assert "normalised_difference" in result.point_data


def _identify_alone(folder: Path) -> list[float]:
    """What rank 0 finds by itself, on all ranks."""
    found = None
    if MPI.COMM_WORLD.rank == 0:
        path = folder / "one.toml"
        path.write_text(CASE + LAWS + '[output]\nfile = "one.vtkhdf"\n')
        found = list(identify_case(Team.alone(), path, Silence()).identification["value"])
    return list(MPI.COMM_WORLD.bcast(found))


@pytest.mark.parallel([1, 2])
def test_a_right_simulation_and_a_wrong_one(folder: Path) -> None:
    team = Team.world()
    found = {}
    for name in ("right", "wrong"):
        summary = compare_case(team, folder / "case.toml", {"file": folder / f"{name}.vtu"}, Silence())
        table = summary.comparison
        assert list(table["region"]) == ["whole field", "left", "rest"]
        found[name] = np.array(table["chi_squared"]), np.array(table["scatter"])
    (chi, scatter), (of_wrong, _) = found["right"], found["wrong"]
    # The rigid motion that the simulation has more is fitted. What the elements do not follow at the hole is levelled.
    assert (np.abs(chi - 1.0) < 5.0 * scatter + 0.1).all()
    assert (of_wrong > 5.0).all()


@pytest.mark.parallel([1, 2])
def test_what_is_missing_is_told(folder: Path) -> None:
    team = Team.world()
    path = folder / "plain.toml"
    if team.is_root:
        path.write_text(CASE)
    MPI.COMM_WORLD.barrier()
    with pytest.raises(InputError, match="identification: this section is missing"):
        identify_case(team, path, Silence())
    with pytest.raises(InputError, match="simulation: this section is missing"):
        compare_case(team, path, {}, Silence())
    with pytest.raises(InputError, match="holds no step 3; steps are 1"):
        compare_case(team, path, {"file": folder / "right.vtu", "step": 3}, Silence())


@pytest.mark.program
def test_the_commands(folder: Path) -> None:
    done = ddic("compare", folder / "case.toml", folder / "right.vtu", "--fit", "motion", ranks=2)
    assert done.code == 0, done.errors
    assert "chi^2" in done.out
    done = ddic("identify", folder / "case.toml")
    assert done.code == 0, done.errors
    assert "identified: young_1 = " in done.out
    refused = ddic("compare", folder / "case.toml", folder / "right.vtu", "--step", "0")
    assert refused.code == 2
    assert len(refused.errors) == 1
