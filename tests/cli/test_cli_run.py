"""``ddic run`` from outside: exit codes, messages, and what is left in the folder."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from ddic.parallel.stop_request import REPEATED_AFTER
from support.cases import write_case, write_images
from support.commands import LIMIT, Finished, ddic, driven, finished, started, wait_for

pytestmark = pytest.mark.program

INPUTS = ["case.toml", "f.tif", "g.tif"]
OUTPUTS = ["result.json", "result.residual.vtkhdf", "result.vtkhdf"]
FOUR = '[solver]\nmethod = "dual"\nsubdomains = 4\n'
SECONDS_TO_END = 20.0
"""A job that fails takes two or three seconds, most of them to start; one that hangs takes LIMIT."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inner = tmp_path / "run"
    inner.mkdir()
    write_images(inner)
    write_case(inner, FOUR)
    return inner


def _names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def _refused(folder: Path, job: Finished, code: int, *words: str) -> None:
    """One line that says what is wrong, an exit code, and nothing written."""
    assert job.code == code, job.err
    assert len(job.errors) == 1, job.err
    for word in words:
        assert word in job.errors[0]
    assert not set(_names(folder)) & set(OUTPUTS)
    assert not [name for name in _names(folder) if name.startswith(".")]
    assert job.seconds < SECONDS_TO_END


@pytest.mark.parametrize("ranks", [0, 1, 2, 4])
def test_a_good_case(folder: Path, ranks: int) -> None:
    write_case(folder, FOUR + "[regularization]\ncut_off_wavelength = 48.0\n")
    job = ddic("run", folder / "case.toml", ranks=ranks)
    assert job.code == 0, job.err
    assert job.errors == []
    assert _names(folder) == sorted(INPUTS + OUTPUTS)
    summary = json.loads((folder / "result.json").read_text())
    assert summary["n_ranks"] == max(ranks, 1)
    assert summary["converged"] is True
    assert 0 < summary["noise_floor_px"] < 0.02  # rounding to 8 bit alone: 0.3 grey levels, on gradients of tens
    assert f"noise floor: {summary['noise_floor_px']:.2g} px RMS a component" in job.out
    with h5py.File(folder / "result.vtkhdf") as file:
        assert file["case"].attrs["noise_floor_px"] == summary["noise_floor_px"]
    # A batch log: plain lines, one table row per iteration, no escape codes.
    assert "\x1b" not in job.out
    assert "\r" not in job.out
    lines = job.out.splitlines()
    head = next(n for n, line in enumerate(lines) if "|dq|/|q|" in line)
    rows = [line.split() for line in lines[head + 1: head + 1 + summary["iterations"]]]
    assert [int(row[0]) for row in rows] == list(range(1, summary["iterations"] + 1))
    assert [int(row[6]) for row in rows] == summary["krylov_iterations"]
    assert f"result: {folder / 'result.vtkhdf'}" in lines


@pytest.mark.parametrize("ranks", [0, 2])
def test_a_warning_is_told_once(folder: Path, ranks: int) -> None:
    f = tifffile.imread(folder / "f.tif")
    tifffile.imwrite(folder / "f.tif", np.dstack([f, f, f]), photometric="rgb")
    job = ddic("run", folder / "case.toml", ranks=ranks)
    assert job.code == 0, job.err
    assert len(job.errors) == 1
    assert job.errors[0].startswith(f"warning: {folder / 'f.tif'}: colour image, turned to grey")


@pytest.mark.parametrize("command", ["run", "check"])
def test_bad_keys_do_not_hide_bad_files(folder: Path, command: str) -> None:
    more = '[solver]\nsubdomain = 4\n[regularization]\neta = 1.0\nnot_controlled = ["lefft"]\n'
    write_case(folder, more, deformed="h.tif", region="region = [24, 24, 300, 168]")
    job = ddic(command, folder / "case.toml")
    assert job.code == 2
    words = ["solver.subdomain: unknown key", "h.tif: no such image file", "the mesh lies outside the image",
             'no node set is named "lefft"']
    assert len(job.errors) == len(words)
    for line, word in zip(job.errors, words, strict=True):
        assert word in line


BAD = {
    "unknown key": (FOUR.replace("subdomains", "subdomain"), {}, ("case.toml", "solver.subdomain", "subdomains")),
    "missing file": ("", {"deformed": "h.tif"}, ("h.tif", "no such image file")),
    "sizes": ("", {"deformed": "small.tif"}, ("small.tif", "100x90", "192x192")),
    "outside": ("", {"region": "region = [24, 24, 300, 168]"}, ("outside",)),
    "NaN": ("", {"deformed": "nan.tif"}, ("nan.tif", "1 pixel(s) are NaN", "(x, y) = (30, 40)")),
    "output": ('[output]\nfile = "no/such/place.vtkhdf"\n', {}, ("output.file", "no folder")),
}


@pytest.mark.parametrize(("what", "ranks"), [*((what, 0) for what in BAD), ("unknown key", 2), ("NaN", 2)])
def test_bad_input_exits_with_2_and_one_line(folder: Path, what: str, ranks: int) -> None:
    more, sections, words = BAD[what]
    f = tifffile.imread(folder / "f.tif")
    tifffile.imwrite(folder / "small.tif", f[:90, :100])
    spoilt = f.astype(np.float32)
    spoilt[40, 30] = np.nan
    tifffile.imwrite(folder / "nan.tif", spoilt)
    write_case(folder, more, **sections)
    _refused(folder, ddic("run", folder / "case.toml", ranks=ranks), 2, *words)


def test_more_ranks_than_subdomains(folder: Path) -> None:
    write_case(folder, "[solver]\nsubdomains = 2\n")
    _refused(folder, ddic("run", folder / "case.toml", ranks=3), 2, "2 subdomains for 3 MPI ranks", "solver.subdomains")


def test_a_blank_area_is_marked_and_the_rest_measured(folder: Path) -> None:
    f = tifffile.imread(folder / "f.tif")
    f[90:, 90:] = 128
    tifffile.imwrite(folder / "f.tif", f)
    write_case(folder, '[solver]\npartition = "blocks"\nblocks = [2, 2]\n')
    job = ddic("run", folder / "case.toml", ranks=2)
    assert job.code == 0, job.err
    assert re.search(r"cells (show something else than the reference|have no texture) and are excluded", job.out)


def test_a_blank_area_is_a_singular_subdomain_where_all_pixels_count(folder: Path) -> None:
    f = tifffile.imread(folder / "f.tif")
    f[90:, 90:] = 128
    tifffile.imwrite(folder / "f.tif", f)
    write_case(folder, '[solver]\nmethod = "dual"\npartition = "blocks"\nblocks = [2, 2]\n'
                       '[correlation]\nspoilt_pixels = "keep"\n')
    _refused(folder, ddic("run", folder / "case.toml", ranks=2), 1, "subdomain 3", "too little texture")


@pytest.mark.parametrize("ranks", [0, 2])
def test_non_convergence(folder: Path, ranks: int) -> None:
    write_case(folder, FOUR + "[gauss_newton]\nmax_iterations = 1\n[start]\nrigid = false\npyramid = false\n"
                              "independent = false\n")
    _refused(folder, ddic("run", folder / "case.toml", ranks=ranks), 1, "did not converge in 1 iterations")


def test_petsc_options_pass_through(folder: Path) -> None:
    job = ddic("run", folder / "case.toml", "-dual_ksp_monitor")
    assert job.code == 0, job.err
    assert "KSP Residual norm" in job.out
    for name in OUTPUTS:
        (folder / name).unlink()
    # To its full tolerance: an inexact first step is content with one iteration here.
    write_case(folder, FOUR + "inexact = false\n")
    job = ddic("run", folder / "case.toml", "-dual_ksp_max_it", "1", ranks=2)
    _refused(folder, job, 1, "interface problem did not converge in 1 Krylov iterations", "solver.max_iterations")


FAILS = "[gauss_newton]\nmax_iterations = 1\n[start]\nrigid = false\npyramid = false\nindependent = false\n"


@pytest.mark.parametrize("ranks", [2])
def test_a_failed_run_says_where_its_field_is_and_other_commands_say_what_it_is(folder: Path, ranks: int) -> None:
    write_case(folder, FOUR)
    assert ddic("run", folder / "case.toml", ranks=ranks).code == 0
    write_case(folder, FOUR + FAILS)
    job = ddic("run", folder / "case.toml", ranks=ranks)
    field = folder / "result.not_converged.vtkhdf"
    assert job.code == 1
    assert len(job.errors) == 1
    assert f"the last field, not converged, is in {field}; " in job.errors[0]
    assert job.errors[0].endswith(f"is now {folder / 'result.earlier.vtkhdf'}")
    # No name that a script looks for is that of a result.
    assert not set(_names(folder)) & set(OUTPUTS)
    warning = f"warning: {field}: this field did not converge (Gauss-Newton did not converge in 1 iterations"
    told = ddic("info", field)
    assert told.code == 0
    assert told.errors[0].startswith(warning)
    assert any(line.startswith("status ") and "NOT CONVERGED: Gauss-Newton" in line for line in told.out.splitlines())
    assert "NOT CONVERGED" not in ddic("info", folder / "result.earlier.vtkhdf").out
    drawn = ddic("plot", field, "--kind", "deformed")
    assert (drawn.code, len(drawn.errors)) == (0, 1)
    assert drawn.errors[0].startswith(warning)
    assert (folder / "result.not_converged.deformed.png").is_file()
    write_case(folder, FOUR + '[start]\nfrom_result = "result.not_converged.vtkhdf"\n')
    restarted = ddic("run", folder / "case.toml", ranks=ranks)
    assert restarted.code == 0
    assert len(restarted.errors) == 1
    assert restarted.errors[0].startswith(warning)


@pytest.mark.parametrize("words", [["other.toml"], ["-dual_ksp_rtol", "1e-9", "other"],
                                   ["-dual_ksp_monitor", "other.toml"], ["-dual_ksp_rtol", "-1", "2"]])
def test_a_word_too_many_is_refused(folder: Path, words: list[str]) -> None:
    job = ddic("run", folder / "case.toml", *words)
    assert job.code == 2
    assert f"{words[-1]} is one word too many" in job.err
    assert _names(folder) == INPUTS


@pytest.mark.parametrize("ranks", [0, 2])
def test_an_option_that_petsc_never_asks_for_is_told(folder: Path, ranks: int) -> None:
    words = ["-dual_ksp_monitr", "-dual_ksp_rtol", "1e-9", "-options_left", "no", "-log_view", ":/dev/null"]
    job = ddic("run", folder / "case.toml", *words, ranks=ranks)
    assert job.code == 0
    # Not of one that another rank, or PETSc's own beginning or end, asks for.
    assert len(job.errors) == 1
    assert job.errors[0].startswith("warning: PETSc's option -dual_ksp_monitr was never asked for")


def test_a_key_without_effect_is_told(folder: Path) -> None:
    write_case(folder, '[solver]\nmethod = "assembled"\nrecycle = true\n')
    job = ddic("run", folder / "case.toml")
    assert job.code == 0
    assert len(job.errors) == 1
    assert job.errors[0].startswith(f"warning: {folder / 'case.toml'}: solver.recycle changes nothing here")


def test_options_that_are_not_petscs_are_refused(folder: Path) -> None:
    job = ddic("run", folder / "case.toml", "--verbose")
    assert job.code == 2
    assert "no such option: --verbose" in job.err
    assert _names(folder) == INPUTS


ON_RANK_1 = """
from mpi4py import MPI
import ddic.problem.linear_solver as linear_solver, ddic.problem.reference_problem as reference_problem
import ddic.visibility.solved_frame as solved_frame
import ddic.solvers.dual.dual_problem as schur_operator
from ddic.errors import InputError
def fail(*arguments, **options):
    raise {error}
if MPI.COMM_WORLD.rank == {rank}:
    {where} = fail
"""


PRODUCT = "schur_operator.DualSchurOperator.mult"


@pytest.mark.parametrize(("where", "error", "message", "rank"), [
    ("reference_problem.read_reference_views", "InputError('f.tif: cut short')", "f.tif: cut short", 1),
    ("linear_solver.LocalOperator", "MemoryError('no room')", "MemoryError: no room", 1),
    (PRODUCT, "KeyError(7)", "KeyError: 7", 0),
    (PRODUCT, "KeyError(7)", "KeyError: 7", 1),
    ("solved_frame.average_copies", "KeyError(8)", "KeyError: 8", 1),
], ids=["input", "memory", "inside PETSc on the root", "inside PETSc", "before a collective"])
def test_a_failure_on_one_rank_ends_all(folder: Path, where: str, error: str, message: str, rank: int) -> None:
    job = finished(driven(ON_RANK_1.format(where=where, error=error, rank=rank), folder), ranks=2)
    assert job.code == (2 if "InputError" in error else 1)
    assert job.seconds < SECONDS_TO_END
    # One message, however many ranks were told, which says where it happened.
    if "InputError" in error:
        assert job.errors == [message]
    else:
        assert sum(message in line for line in job.errors) == 1, job.err
        assert any(f"rank {rank}" in line for line in job.errors)
        assert "in fail" in job.err
    assert _names(folder) == INPUTS


def test_a_rank_that_breaks_after_a_failure_ends_all(folder: Path) -> None:
    # While the last field is made ready: the others wait for this rank in a sum.
    write_case(folder, FOUR + FAILS)
    driver = ON_RANK_1.format(where="solved_frame.average_copies", error="KeyError(8)", rank=1)
    job = finished(driven(driver, folder), 2)
    assert job.code == 1
    assert job.seconds < SECONDS_TO_END
    assert sum("KeyError: 8" in line for line in job.errors) == 1, job.err
    assert _names(folder) == INPUTS


def test_a_full_disk_leaves_no_file(folder: Path) -> None:
    driver = """
import ddic.io.result_writer as writer
def full(*arguments):
    raise OSError(28, "No space left on device")
writer.ResultWriter.write_table = full
"""
    job = finished(driven(driver, folder), ranks=2)
    assert job.code == 1
    assert "No space left on device" in job.err
    assert _names(folder) == INPUTS


SLOW = """
import os, time
import ddic.io.result_writer as writer
from pathlib import Path
folder = Path({folder!r})
# MPI is not imported here: ddic blocks signals before its threads begin.
(folder / f"pid{{os.environ.get('OMPI_COMM_WORLD_RANK', 0)}}").write_text(str(os.getpid()))
ordinary = writer.ResultWriter.create_mesh
def slow(*arguments):
    layout = ordinary(*arguments)
    (folder / "writing").touch()
    time.sleep(100)
    return layout
writer.ResultWriter.create_mesh = slow
"""


@pytest.mark.parametrize(("ranks", "number"), [
    (0, signal.SIGINT), (0, signal.SIGTERM), (0, signal.SIGHUP), (2, signal.SIGINT), (2, signal.SIGTERM)])
def test_an_interrupted_run_leaves_nothing(folder: Path, ranks: int, number: signal.Signals) -> None:
    signs = folder.parent
    with started(driven(SLOW.format(folder=str(signs)), folder), ranks) as process:
        wait_for(signs / "writing")
        assert [name for name in _names(folder) if name.endswith(".tmp")]  # there is something to leave behind
        process.send_signal(number)
        if ranks == 0 and number == signal.SIGTERM:
            # The first one asks the run to finish what it does; mpiexec, which sends it too, kills one second later.
            time.sleep(1.5 * REPEATED_AFTER)
            assert process.poll() is None
            process.send_signal(number)
        _, err = process.communicate(timeout=LIMIT)
    assert process.returncode != 0
    assert "Traceback" not in err
    if ranks == 0:
        assert process.returncode == 130
        assert err.splitlines() == ["interrupted; no result was written"]
    assert _names(folder) == INPUTS


def test_a_killed_rank_ends_the_job_without_a_result(folder: Path) -> None:
    signs = folder.parent
    with started(driven(SLOW.format(folder=str(signs)), folder), 2) as process:
        wait_for(signs / "writing")
        os.kill(int((signs / "pid1").read_text()), signal.SIGKILL)
        process.communicate(timeout=LIMIT)
    assert process.returncode != 0
    assert not set(_names(folder)) & set(OUTPUTS)


def test_a_killed_run_leaves_an_earlier_result_alone(folder: Path) -> None:
    (folder / "result.vtkhdf").write_text("an earlier result")
    signs = folder.parent
    with started(driven(SLOW.format(folder=str(signs)), folder)) as process:
        wait_for(signs / "writing")
        process.kill()
    assert (folder / "result.vtkhdf").read_text() == "an earlier result"
    assert not (folder / "result.json").exists()
