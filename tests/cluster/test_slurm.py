"""The batch script under a real Slurm of one machine: ``make test-slurm``.

Needs Debian's slurm-wlm, munge and libpmix-dev (without which Slurm's PMIx plugin finds no PMIx library).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import ddic
from accept.series_runs import find_unequal_datasets
from accept.slurm_job import Slurm, edit_job_script, one_machine_slurm
from support.cases import write_case, write_images
from support.commands import ddic as run_ddic
from support.commands import wait_for
from support.patient import ENDLESS, FOUR, patient

pytestmark = pytest.mark.skipif("DDIC_TEST_SLURM" not in os.environ, reason="make test-slurm runs it")

LAUNCHERS = ["mpirun", "srun --mpi=pmix"]
LIMIT = 120.0
"""Seconds after which a job counts as hanging; the longest is asked to stop within a minute."""


@pytest.fixture(scope="module")
def slurm() -> Iterator[Slurm]:
    with one_machine_slurm() as running:
        yield running


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inner = tmp_path / "run"
    inner.mkdir()
    write_images(inner)
    write_case(inner, FOUR)
    return inner


def _export(launcher: str) -> str:
    return f"--export=ALL,DDIC_LAUNCH={launcher}"


def _patient_program(folder: Path, seconds: float) -> str:
    """A program that stands for ddic and iterates slowly."""
    program = folder.parent / "slow_ddic"
    program.write_text("#!/bin/sh\nexec " + " ".join(patient(folder, seconds)) + "\n", encoding="utf-8")
    program.chmod(0o755)
    return str(program)


def _check_stopped(state: dict[str, str], folder: Path) -> None:
    log = next(folder.glob("ddic-*.log")).read_text(encoding="utf-8")
    assert state["ExitCode"] == "3:0", log
    assert log.count("stopped by a signal after iteration") == 1
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    with pytest.warns(UserWarning, match="did not converge"):
        assert not ddic.open(folder / "result.not_converged.vtkhdf").converged


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_a_job_gives_the_result_of_mpirun(slurm: Slurm, folder: Path, launcher: str) -> None:
    outside = folder.with_name("outside")
    shutil.copytree(folder, outside)
    assert run_ddic("run", outside / "case.toml", ranks=2).code == 0
    job = slurm.submit(edit_job_script("slurm", folder / "case.toml"), _export(launcher))
    state = slurm.wait(job, LIMIT)
    log = (folder / f"ddic-{job}.log").read_text(encoding="utf-8")
    assert (state["JobState"], state["ExitCode"]) == ("COMPLETED", "0:0"), log
    assert "on 2 ranks" in log
    assert all(character == "\n" or character.isprintable() for character in log)
    n_compared, unequal = find_unequal_datasets(outside / "result.vtkhdf", folder / "result.vtkhdf")
    assert n_compared > 30
    assert unequal == []


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_a_signal_to_the_batch_shell_stops_the_run(slurm: Slurm, folder: Path, launcher: str) -> None:
    write_case(folder, FOUR + ENDLESS)
    script = edit_job_script("slurm", folder / "case.toml", program=_patient_program(folder, 0.5))
    job = slurm.submit(script, _export(launcher))
    wait_for(folder.parent / "iterating*")
    slurm.ask("scancel", "--batch", "--signal=USR1", str(job))
    _check_stopped(slurm.wait(job, LIMIT), folder)


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_the_signal_ahead_of_the_limit_stops_the_run(slurm: Slurm, folder: Path, launcher: str) -> None:
    write_case(folder, FOUR + ENDLESS)
    # Some twenty iterations and more, hence over a minute; Slurm looks every 30 s, hence signals after 10 to 40 s.
    script = edit_job_script("slurm", folder / "case.toml", {"#SBATCH --time=01:00:00": "#SBATCH --time=00:01:00",
                                                             "B:USR1@180": "B:USR1@20"},
                             program=_patient_program(folder, 4.0))
    job = slurm.submit(script, _export(launcher))
    _check_stopped(slurm.wait(job, LIMIT), folder)


def test_what_slurm_sends_at_the_limit_itself_stops_the_steps_of_srun(slurm: Slurm, folder: Path) -> None:
    write_case(folder, FOUR + ENDLESS)
    script = edit_job_script("slurm", folder / "case.toml", program=_patient_program(folder, 0.5))
    job = slurm.submit(script, _export("srun --mpi=pmix"))
    wait_for(folder.parent / "iterating*")
    # SIGTERM to all steps, as at the limit; SIGKILL follows after KillWait.
    slurm.ask("scancel", "--signal=TERM", str(job))
    _check_stopped(slurm.wait(job, LIMIT), folder)


def test_a_refused_case_fails_the_job_with_its_exit_code(slurm: Slurm, folder: Path) -> None:
    write_case(folder, FOUR.replace("subdomains", "subdomain"))
    job = slurm.submit(edit_job_script("slurm", folder / "case.toml"))
    assert slurm.wait(job, LIMIT)["ExitCode"] == "2:0"
