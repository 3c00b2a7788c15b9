"""Measurements that start from an earlier result, from a table of points, or from a few pairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from mpi4py import MPI

import ddic
from ddic.cli.check import check
from ddic.cli.run import run
from ddic.errors import InputError, is_collective
from ddic.methods.run import run_case
from ddic.parallel.team import Team
from ddic.synth.fields import Affine, DisplacementField
from support.cases import Ears
from support.pictures import pair_of

SIDE = 512
CENTRE = (255.5, 255.5)
FIRST = Affine(((0.01, 0.0), (0.0, -0.003)), (3.0, -2.0), CENTRE)
LATER = Affine(((0.014, 0.0), (0.0, -0.0042)), (43.0, -12.0), CENTRE)
TIGHT = "[gauss_newton]\ntolerance = 1e-13\nrms_tolerance = 1e-9\n"
SOLVER = "[solver]\nsubdomains = 4\ntolerance = 1e-12\ninexact = false\n" + TIGHT
WITHIN = 0.03
"""Pixels RMS: rounding of grey levels on elements of 16 px."""


def _write_images(folder: Path) -> None:
    """f.tif, first.tif, later.tif."""
    for field, name in ((FIRST, "first"), (LATER, "later")):
        pair = pair_of(field, SIDE, 8)
        tifffile.imwrite(folder / "f.tif", pair.reference)
        tifffile.imwrite(folder / f"{name}.tif", pair.deformed)


def _write(folder: Path, deformed: str, start: str = "", region: str = "160, 160, 352, 352",
           more: str = SOLVER) -> Path:
    path = folder / f"{deformed}_case.toml"
    path.write_text(f'[images]\nreference = "f.tif"\ndeformed = "{deformed}.tif"\n[mesh.structured]\n'
                    f"region = [{region}]\nelement_size = 16\n{more}\n[start]\n{start}\n"
                    f'[output]\nfile = "{deformed}.vtkhdf"\n', encoding="utf-8")
    return path


def _run(folder: Path, deformed: str, start: str = "", region: str = "160, 160, 352, 352",
         more: str = SOLVER) -> tuple[ddic.Result, list[str]]:
    """The result and what the log says; images are written once."""
    team = Team(MPI.COMM_WORLD)
    if team.is_root:
        if not (folder / "f.tif").exists():
            _write_images(folder)
        _write(folder, deformed, start, region, more)
    team.wait_for_all()
    ears = Ears()
    run_case(team, folder / f"{deformed}_case.toml", ears)
    team.wait_for_all()
    return ddic.open(folder / f"{deformed}.vtkhdf"), ears.notes


def _error(result: ddic.Result, field: DisplacementField) -> float:
    return float(np.sqrt(((result.displacement - field.displacement(result.mesh.nodes))**2).mean()))


def _write_table(folder: Path, points: np.ndarray, field: DisplacementField) -> None:
    rows = [f"{x},{y},{u:.2f},{v:.2f}" for (x, y), (u, v) in zip(points, field.displacement(points), strict=True)]
    if MPI.COMM_WORLD.rank == 0:
        (folder / "points.csv").write_text("\n".join(["x,y,u,v", *rows]), encoding="utf-8")
    MPI.COMM_WORLD.barrier()


@pytest.mark.parallel([1, 3])
def test_a_restart_goes_on_over_a_jump_on_any_number_of_ranks(shared_path: Path) -> None:
    first, _ = _run(shared_path, "first")
    later, notes = _run(shared_path, "later", 'from_result = "first.vtkhdf"')
    told = [note for note in notes if note.startswith("start: ")]
    assert told[0] == f"start: displacement of {(shared_path / 'first.vtkhdf').resolve()}"
    assert "searching on" in told[1]
    assert "moved on by (40." in told[2]
    assert _error(first, FIRST) <= WITHIN
    assert _error(later, LATER) <= WITHIN
    # The same field as from nothing; Gauss-Newton stops at corrections of 1e-9 px.
    from_nothing, _ = _run(shared_path, "later")
    np.testing.assert_allclose(later.displacement, from_nothing.displacement, atol=1e-7)


@pytest.mark.parallel([1, 3])
def test_nodes_beyond_the_earlier_mesh_are_extrapolated(shared_path: Path) -> None:
    _run(shared_path, "first", region="208, 208, 304, 304")
    if MPI.COMM_WORLD.rank == 0:
        (shared_path / "first.vtkhdf").rename(shared_path / "small.vtkhdf")
    MPI.COMM_WORLD.barrier()
    # Without independent subdomains and iterations nothing but the start brings nodes there; those at the edge see it.
    start = 'from_result = "small.vtkhdf"\nindependent = false'
    later, notes = _run(shared_path, "first", start)
    # The meshes' corners lie 48 px apart along x and y: 169 nodes less 49.
    assert (f"start: 120 nodes lie outside the mesh of {(shared_path / 'small.vtkhdf').resolve()}, by 67.9 px at most; "
            "displacement extrapolated by equilibrium") in notes
    assert not any("searching on" in note for note in notes)
    assert _error(later, FIRST) <= WITHIN
    # An affine map is extrapolated as exactly as it was measured: the first correction is as small.
    assert later.gauss_newton["rms_correction_px"][0] <= 0.1


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("stages", ["", "pyramid = false\nrigid = false\n"])
def test_points_of_a_table_start_a_measurement(shared_path: Path, stages: str) -> None:
    points = np.random.default_rng(0).uniform(165, 345, (60, 2)).round(1)
    _write_table(shared_path, points, LATER)
    result, notes = _run(shared_path, "later", f'{stages}from_points = "points.csv"')
    assert [note for note in notes if note.startswith("start: displ")] == [
        f"start: displacement at 60 points of {(shared_path / 'points.csv').resolve()}"]
    # Hundredths of pixels are borne out.
    assert not any("searching on" in note for note in notes)
    assert _error(result, LATER) <= WITHIN


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("n_pairs", [1, 2, 3])
def test_few_pairs_are_gone_on_from(shared_path: Path, n_pairs: int) -> None:
    points = np.array([[180.0, 190.0], [330.0, 200.0], [250.0, 340.0]])[:n_pairs]
    # Off by 3 px, as one clicks: Gauss-Newton alone does not come from there.
    pairs = np.hstack([points, points + LATER.displacement(points) + (3.0, -3.0)])
    start = f"features = false\npoints = {pairs.round(1).tolist()}"
    result, notes = _run(shared_path, "later", start)
    assert any("searching on" in note for note in notes)
    assert _error(result, LATER) <= WITHIN


@pytest.mark.parallel([1, 3])
def test_products_start_from_points_too(shared_path: Path) -> None:
    points = np.array([[180.0, 190.0], [330.0, 200.0], [250.0, 340.0]])
    pairs = np.hstack([points, points + LATER.displacement(points) + (3.0, -3.0)])
    result, notes = _run(shared_path, "later", f"points = {pairs.round(1).tolist()}", more="[pgd]\n")
    assert "start: displacement at 3 points of start.points" in notes
    assert _error(result, LATER) <= 2 * WITHIN


@pytest.mark.parallel([1, 3])
def test_a_result_of_another_place_is_refused(shared_path: Path) -> None:
    _run(shared_path, "first", region="160, 160, 208, 208")
    with pytest.raises(InputError, match="holds no node of this measurement's") as caught:
        _run(shared_path, "later", 'from_result = "first.vtkhdf"', region="256, 256, 352, 352")
    assert is_collective(caught.value)


@pytest.mark.parametrize(("start", "words"), [
    ("points = [[200, 200, 240, 190], [600, 20, 640, 10]]",
     "later_case.toml: start.points[1]: (600, 20) lies outside the reference image of 512 x 512 px"),
    ("points = [[20, 20, 60, 10]]", "later_case.toml: start.points: none of 1 points lies in the mesh"),
    ("points = [[20, 20, 60]]", "later_case.toml: start.points[0] = [20, 20, 60]: expected at least 4 items"),
    ("points = []", "start.points: the list is empty"),
    ('points = [[20, 20, 60, "a"]]', 'start.points[0][3] = "a": expected a number'),
    ('from_points = "none.csv"', "none.csv: cannot read this table of points"),
    ('from_points = "bad.csv"', 'bad.csv: row 3, column u: "?" is no finite number'),
    ('from_points = "far.csv"', "far.csv: row 3: (700, 200) lies outside the reference image"),
    ('from_points = "far.csv"\npoints = [[200, 200, 240, 190]]',
     "start: start.from_points and start.points: give one of them"),
    ('from_points = "far.csv"\nfrom_result = "a.vtkhdf"', "start.from_result and start.from_points: give one of them"),
])
@pytest.mark.parametrize("command", [check, run])
def test_wrong_starts_are_one_clear_line(tmp_path: Path, start: str, words: str, command: object) -> None:
    _write_images(tmp_path)
    (tmp_path / "bad.csv").write_text("x,y,u,v\n200,200,1,1\n210,200,?,1\n")
    (tmp_path / "far.csv").write_text("x,y,u,v\n200,200,1,1\n700,200,1,1\n")
    ran = CliRunner().invoke(command, [str(_write(tmp_path, "later", start))])  # type: ignore[arg-type]
    assert ran.exit_code == 2
    assert len(ran.output.strip().splitlines()) == 1, ran.output
    assert words in ran.output
    assert "Traceback" not in ran.output
