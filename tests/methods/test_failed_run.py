"""What a run that does not converge leaves: its last field, marked, and an earlier result out of the way."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from mpi4py import MPI

import ddic
from ddic.errors import ConvergenceError, DdicError, InputError, SingularSubdomainError, is_collective
from ddic.io.result_writer import ResultWriter
from ddic.methods.run import run_case
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from support.cases import Ears, write_case, write_images
from support.near_far_cases import SOLVER, near_section, write_pairs
from support.near_far_cases import case_text as near_far_text

RANKS = [1, 3]
REGULARIZED = "[regularization]\ncut_off_wavelength = 48.0\n"
TIGHT = "[solver]\nsubdomains = 4\ntolerance = 1e-12\ninexact = false\n"
GOOD = TIGHT + REGULARIZED
NO_START = "[start]\nrigid = false\npyramid = false\nindependent = false\n"
FAILS = GOOD + "[gauss_newton]\nmax_iterations = 2\n" + NO_START
FAILING_PGD = "[pgd]\nmax_corrections = 1\nstop_at_noise = false\n[start]\npyramid = false\n"
SAME_PX = 1e-8
"""The interface problem is solved to 1e-12 of a pixel or so; two iterations of Gauss-Newton do not enlarge it."""


def _write(folder: Path, more: str, **sections: str) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        folder.mkdir(exist_ok=True)
        write_images(folder)
        write_case(folder, more, **sections)
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


def _fail(team: Team, path: Path, kind: type[DdicError] = ConvergenceError) -> DdicError:
    with pytest.raises(kind) as caught:
        run_case(team, path, Silence())
    team.comm.barrier()
    return caught.value


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name not in ("case.toml", "f.tif", "g.tif"))


def _of(stem: str) -> list[str]:
    return [f"{stem}.json", f"{stem}.residual.vtkhdf", f"{stem}.vtkhdf"]


@pytest.mark.filterwarnings("ignore:.*did not converge:UserWarning")
@pytest.mark.parallel(RANKS)
def test_last_field_is_that_of_the_last_iteration_on_any_number_of_ranks(shared_path: Path) -> None:
    team, ears = Team.world(), Ears()
    path = _write(shared_path / "all", FAILS)
    with pytest.raises(ConvergenceError, match="did not converge in 2 iterations") as caught:
        run_case(team, path, ears)
    assert is_collective(caught.value)
    # Who reads only the message finds the file.
    kept = path.parent.resolve() / "result.not_converged.vtkhdf"
    assert str(caught.value).endswith(f"; the last field, not converged, is in {kept}")
    assert "\n" not in str(caught.value)
    alone = None
    if team.is_root:
        (shared_path / "one").mkdir()
        write_images(shared_path / "one")
        with pytest.raises(ConvergenceError):
            run_case(Team.alone(), write_case(shared_path / "one", FAILS), Silence())
        alone = ddic.open(shared_path / "one" / "result.not_converged.vtkhdf").displacement
    alone = team.broadcast(alone)
    team.comm.barrier()
    found = ddic.open(kept)
    assert np.abs(found.displacement - alone).max() < SAME_PX
    assert [record.number for record in ears.records] == found.gauss_newton["iteration"].tolist() == [1, 2]
    # Its residual is that of the field itself, hence smaller than those before its corrections.
    assert np.nanstd(found.residual_image) < found.gauss_newton["residual_std_grey"].min()
    assert set(found.fields) >= {"doubtful", "equivalent_error", "strain_green_lagrange"}


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("more", "reason"), [(FAILS, "Gauss-Newton did not converge in 2 iterations"),
                                              (FAILING_PGD, "PGD-DIC does not converge")], ids=["dual", "pgd"])
def test_status_is_in_name_file_and_summary(shared_path: Path, more: str, reason: str) -> None:
    path = _write(shared_path, more)
    _fail(Team.world(), path)
    assert _names(shared_path) == _of("result.not_converged")
    with h5py.File(shared_path / "result.not_converged.vtkhdf") as file:
        assert file.attrs["status"] == "not converged"
        assert file.attrs["failure"].startswith(reason)
    summary = json.loads((shared_path / "result.not_converged.json").read_text())
    assert summary["converged"] is False
    assert summary["failure"].startswith(reason)
    assert summary["result_file"] == str(shared_path.resolve() / "result.not_converged.vtkhdf")
    with pytest.warns(UserWarning, match=f"this field did not converge .{reason}"):
        result = ddic.open(shared_path / "result.not_converged.vtkhdf")
    assert not result.converged
    assert "NOT CONVERGED" in repr(result)
    assert summary["iterations"] == (2 if result.separated is None else 1)


@pytest.mark.parallel([1, 3])
def test_an_earlier_result_is_moved_whole_and_a_later_one_removes_the_failed_field(shared_path: Path) -> None:
    team = Team.world()
    path = _write(shared_path, GOOD)
    assert run_case(team, path, Silence()).converged
    team.comm.barrier()
    before = ddic.open(shared_path / "result.vtkhdf")
    image = before.residual_image
    team.comm.barrier()
    error = _fail(team, _write(shared_path, FAILS))
    assert str(error).endswith(f"now {shared_path.resolve() / 'result.earlier.vtkhdf'}")
    assert _names(shared_path) == sorted(_of("result.earlier") + _of("result.not_converged"))
    earlier = ddic.open(shared_path / "result.earlier.vtkhdf")
    assert earlier.converged
    assert np.array_equal(earlier.displacement, before.displacement)
    summary = json.loads((shared_path / "result.earlier.json").read_text())
    assert summary["result_file"].endswith("result.earlier.vtkhdf")
    with h5py.File(shared_path / "result.earlier.residual.vtkhdf") as file:
        # What leads to the residual image leads to the moved one.
        np.testing.assert_array_equal(file["VTKHDF/PointData/residual"][...], image)
    # A second failure has no result to move, and leaves the earlier one alone.
    _fail(team, path)
    assert _names(shared_path) == sorted(_of("result.earlier") + _of("result.not_converged"))
    run_case(team, _write(shared_path, GOOD), Silence())
    team.comm.barrier()
    assert _names(shared_path) == sorted(_of("result") + _of("result.earlier"))


@pytest.mark.filterwarnings("ignore:.*did not converge:UserWarning")
@pytest.mark.parallel([1, 3])
def test_a_restart_from_a_failed_field_goes_on_and_keeps_it(shared_path: Path) -> None:
    team = Team.world()
    path = _write(shared_path, FAILS)
    _fail(team, path)
    more = GOOD + '[start]\nfrom_result = "result.not_converged.vtkhdf"\nindependent = false\n'
    path = _write(shared_path, more)
    from_failed = run_case(team, path, Silence())
    # The case that starts from it can be run again.
    assert run_case(team, path, Silence()).iterations == from_failed.iterations
    team.comm.barrier()
    from_scratch = run_case(team, _write(shared_path, GOOD + NO_START), Silence())
    # It starts two iterations further on.
    assert from_failed.iterations <= from_scratch.iterations - 2


@pytest.mark.parallel([1, 3])
def test_a_failure_without_a_field_moves_an_earlier_result_too(shared_path: Path) -> None:
    team = Team.world()
    run_case(team, _write(shared_path, GOOD), Silence())
    _fail(team, _write(shared_path, FAILS))
    run_case(team, _write(shared_path, GOOD), Silence())
    team.comm.barrier()
    hidden = _write(shared_path, TIGHT, images='deformed_mask = "none.tif"')
    if team.is_root:
        # A mask of next to nothing is refused before anything is measured; this one hides all that lies about the mesh.
        mask = np.zeros((192, 192), np.uint8)
        mask[:12, :12] = 255
        tifffile.imwrite(shared_path / "none.tif", mask)
    team.comm.barrier()
    with pytest.raises((ConvergenceError, SingularSubdomainError), match=r"now .*result\.earlier\.vtkhdf"):
        run_case(team, hidden, Silence())
    team.comm.barrier()
    assert _names(shared_path) == sorted(["none.tif", *_of("result.earlier")])


@pytest.mark.parallel([1, 3])
def test_refused_inputs_touch_nothing(shared_path: Path) -> None:
    team = Team.world()
    run_case(team, _write(shared_path, GOOD), Silence())
    team.comm.barrier()
    _fail(team, _write(shared_path, GOOD, deformed="none.tif"), InputError)
    assert _names(shared_path) == _of("result")


@pytest.mark.filterwarnings("ignore:.*did not converge:UserWarning")
@pytest.mark.parallel([1, 3])
def test_several_cameras_leave_all_their_images_and_motions(shared_path: Path) -> None:
    team = Team.world()
    if team.is_root:
        write_pairs(shared_path)
        fails = "[gauss_newton]\nmax_iterations = 1\nlargest_tolerance = 1e-12\n"
        (shared_path / "case.toml").write_text(near_far_text(near_section(), more=SOLVER + fails), encoding="utf-8")
    team.comm.barrier()
    _fail(team, shared_path / "case.toml")
    (path,) = shared_path.glob("*.not_converged.vtkhdf")
    result = ddic.open(path)
    assert not result.converged
    assert np.isfinite(result.attributes["near_1"]["alpha_px"]).all()
    assert path.with_name(f"{path.stem}.near_1.residual.vtkhdf").is_file()
    summary = json.loads(path.with_suffix(".json").read_text())
    assert set(summary["images"]) == {"reference", "deformed", "near_1_reference", "near_1_deformed"}


@pytest.mark.parallel([1, 3])
def test_a_full_disk_does_not_hide_why_the_run_failed(shared_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path = _write(shared_path, FAILS)
    monkeypatch.setattr(ResultWriter, "write_table", full)
    error = _fail(Team.world(), path)
    assert str(error).startswith("Gauss-Newton did not converge in 2 iterations")
    assert "No space left on device" in str(error)
    assert is_collective(error)
    assert _names(shared_path) == []


@pytest.mark.parallel([1, 3])
def test_an_earlier_result_that_does_not_move_whole_hides_nothing(shared_path: Path) -> None:
    path = _write(shared_path, FAILS)
    if MPI.COMM_WORLD.rank == 0:
        (shared_path / "result.vtkhdf").write_text("an earlier result")
        (shared_path / "result.residual.vtkhdf").write_text("nothing that leads to a residual image")
    error = _fail(Team.world(), path)
    assert str(error).startswith("Gauss-Newton did not converge in 2 iterations")
    assert f"the last field, not converged, is in {shared_path.resolve()}" in str(error)
    assert "; an earlier result could not be moved whole from " in str(error)
    assert "result.vtkhdf" not in _names(shared_path)
    assert (shared_path / "result.earlier.vtkhdf").read_text() == "an earlier result"
