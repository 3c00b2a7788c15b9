"""The job scripts that need no batch system to be run; tests/cluster has Slurm's."""

from __future__ import annotations

import re
import shutil
import signal
import socket
import subprocess
from itertools import takewhile
from pathlib import Path

import pytest

import ddic
from accept.slurm_job import edit_job_script
from support.cases import write_case, write_images
from support.commands import LIMIT, started, wait_for
from support.patient import ENDLESS, FOUR, patient

pytestmark = pytest.mark.program

ROOT = Path(__file__).resolve().parents[2]
PLACES = {"pbs": ("seconds=3420", "seconds={}"), "mpirun": ("ranks=2 seconds=0", "ranks=2 seconds={}")}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    inner = tmp_path / "run"
    inner.mkdir()
    write_images(inner)
    write_case(inner, FOUR)
    monkeypatch.chdir(inner)
    return inner


def _script(system: str, folder: Path, seconds: int, program: list[str] | None = None) -> Path:
    """The script with both ranks and its limit in seconds; a program that stands for ddic."""
    old, new = PLACES[system]
    path = None
    if program:
        path = folder.parent / "program"
        path.write_text("#!/bin/sh\nexec " + " ".join(program) + "\n", encoding="utf-8")
        path.chmod(0o755)
    return edit_job_script(system, folder / "case.toml", {old: new.format(seconds)}, program=path and str(path))


def _read_directives(script: Path) -> list[str]:
    """What qsub reads, by POSIX: lines of directives until the first other one, which may be a comment."""
    lines = [line for line in script.read_text(encoding="utf-8").splitlines()[1:] if line.strip()]
    return list(takewhile(lambda line: line.startswith("#PBS "), lines))


def _submit(script: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The command by which PBS runs a script: a copy of it, in another folder, with PBS's variables."""
    directives = " ".join(_read_directives(script))
    shell, chunks, ranks = (re.search(pattern, directives) for pattern in
                            (r"-S (\S+)", r"select=(\d+)", r"mpiprocs=(\d+)"))
    assert shell is not None
    assert chunks is not None
    assert ranks is not None
    spool = script.parent.parent / "spool"
    spool.mkdir()
    machines = spool / "machines"
    machines.write_text(f"{socket.gethostname()}\n" * (int(chunks[1]) * int(ranks[1])), encoding="utf-8")
    copy = Path(shutil.copy(script, spool / "7.stub.SC"))
    monkeypatch.chdir(spool)
    for name, value in (("O_WORKDIR", script.parent), ("JOBID", "7.stub"), ("NODEFILE", machines),
                        ("ENVIRONMENT", "PBS_BATCH")):
        monkeypatch.setenv(f"PBS_{name}", str(value))
    return [shell[1], str(copy)]


def _start(system: str, folder: Path, seconds: int, monkeypatch: pytest.MonkeyPatch,
           program: list[str] | None = None) -> list[str]:
    """The command that starts a job."""
    script = _script(system, folder, seconds, program)
    return _submit(script, monkeypatch) if system == "pbs" else ["bash", str(script)]


def _log(folder: Path) -> str:
    return next(folder.glob("ddic-*.log")).read_text(encoding="utf-8")


@pytest.mark.parametrize("system", ["slurm", *PLACES])
def test_scripts_are_bash(system: str) -> None:
    script = ROOT / "scripts" / system / "job.sh"
    subprocess.run(["bash", "-n", str(script)], check=True)
    checker = shutil.which("shellcheck")
    if checker is not None:
        subprocess.run([checker, str(script)], check=True)


def test_batch_systems_read_all_lines_for_them() -> None:
    """They stop at the first command; qsub may at the first comment."""
    of_pbs, of_slurm = (ROOT / "scripts" / system / "job.sh" for system in ("pbs", "slurm"))
    written = [line for line in of_pbs.read_text(encoding="utf-8").splitlines() if line.startswith("#PBS")]
    assert _read_directives(of_pbs) == written
    assert len(written) == 5
    lines = of_slurm.read_text(encoding="utf-8").splitlines()
    first = next(number for number, line in enumerate(lines) if line.strip() and not line.startswith("#"))
    assert not [line for line in lines[first:] if line.startswith("#SBATCH")]


def test_a_pbs_job_without_pbs_is_refused(folder: Path) -> None:
    ran = subprocess.run(["bash", str(_script("pbs", folder, 600))], check=False, capture_output=True, text=True,
                         timeout=LIMIT)
    assert ran.returncode != 0
    assert "submit this by qsub, or take scripts/mpirun/job.sh" in ran.stderr
    assert not list(folder.glob("ddic-*.log"))


@pytest.mark.parametrize("system", PLACES)
def test_a_job_that_ends_in_time(folder: Path, system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with started(_start(system, folder, 600, monkeypatch)) as process:
        _, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, err
    assert "on 2 ranks" in _log(folder)
    assert ddic.open(folder / "result.vtkhdf").converged


def test_the_end_of_its_time_stops_the_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_case(folder, FOUR + ENDLESS)
    # Twenty iterations and more of two seconds; they begin after three, or after ten on a busy machine.
    with started(_start("pbs", folder, 20, monkeypatch, patient(folder, 2.0))) as process:
        process.communicate(timeout=LIMIT)
    _check_stopped(process.returncode, folder)


@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGTERM])
def test_a_signal_to_the_script_stops_the_run(folder: Path, number: signal.Signals,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    write_case(folder, FOUR + ENDLESS)
    with started(_start("mpirun", folder, 0, monkeypatch, patient(folder, 0.3))) as process:
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
