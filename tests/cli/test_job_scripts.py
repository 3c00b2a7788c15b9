"""The job scripts that need no batch system to be run; tests/cluster has Slurm's."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import pytest

import ddic
from accept.support.job_script import edit_job_script
from support.cases import write_case, write_images
from support.commands import LIMIT, started, wait_for
from support.patient import ENDLESS, FOUR, patient

PLACES = {"pbs": ("ranks=2 seconds=3420", "ranks=2 seconds={}"), "mpirun": ("ranks=2 seconds=0", "ranks=2 seconds={}")}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    inner = tmp_path / "run"
    inner.mkdir()
    write_images(inner)
    write_case(inner, FOUR)
    monkeypatch.chdir(inner)
    return inner


def _script(system: str, folder: Path, seconds: int, program: list[str] | None = None) -> list[str]:
    """The script with both ranks and its limit in seconds; a program that stands for ddic."""
    old, new = PLACES[system]
    path = None
    if program:
        path = folder.parent / "program"
        path.write_text("#!/bin/sh\nexec " + " ".join(program) + "\n", encoding="utf-8")
        path.chmod(0o755)
    script = edit_job_script(system, folder / "case.toml", {old: new.format(seconds)}, program=path and str(path))
    return ["bash", str(script)]


def _log(folder: Path) -> str:
    return next(folder.glob("ddic-*.log")).read_text(encoding="utf-8")


@pytest.mark.parametrize("system", ["slurm", *PLACES])
def test_scripts_are_bash(system: str) -> None:
    script = Path(__file__).resolve().parents[2] / "scripts" / system / "job.sh"
    subprocess.run(["bash", "-n", str(script)], check=True)


@pytest.mark.parametrize("system", PLACES)
def test_a_job_that_ends_in_time(folder: Path, system: str) -> None:
    with started(_script(system, folder, 600)) as process:
        _, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, err
    assert "on 2 ranks" in _log(folder)
    assert ddic.open(folder / "result.vtkhdf").converged


def test_the_end_of_its_time_stops_the_run(folder: Path) -> None:
    write_case(folder, FOUR + ENDLESS)
    # Twenty iterations and more of two seconds; they begin after three, or after ten on a busy machine.
    with started(_script("pbs", folder, 20, patient(folder, 2.0))) as process:
        process.communicate(timeout=LIMIT)
    _check_stopped(process.returncode, folder)


@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGTERM])
def test_a_signal_to_the_script_stops_the_run(folder: Path, number: signal.Signals) -> None:
    write_case(folder, FOUR + ENDLESS)
    with started(_script("mpirun", folder, 0, patient(folder, 0.3))) as process:
        wait_for(folder.parent / "iterating*", 2)
        process.send_signal(number)
        process.communicate(timeout=LIMIT)
    _check_stopped(process.returncode, folder)


def _check_stopped(code: int, folder: Path) -> None:
    log = _log(folder)
    assert code == 3, log
    assert log.count("stopped by a signal after iteration") == 1
    with pytest.warns(UserWarning, match="did not converge"):
        assert not ddic.open(folder / "result.not_converged.vtkhdf").converged
