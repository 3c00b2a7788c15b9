"""SIGTERM and SIGUSR1 end ``ddic run`` after the iteration at hand, whichever rank they reach, whenever they come."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

import ddic
from support.cases import write_case, write_images
from support.commands import LIMIT, Finished, driven, finished, started, wait_for
from support.patient import ENDLESS, FOUR, patient

pytestmark = pytest.mark.program


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inner = tmp_path / "run"
    inner.mkdir()
    write_images(inner)
    write_case(inner, FOUR + ENDLESS)
    return inner


def _send(process: subprocess.Popen[str], folder: Path, number: signal.Signals, to: int | None) -> None:
    """Signal a rank, or the launcher."""
    pid = process.pid if to is None else int((folder.parent / f"pid{to}").read_text())
    os.kill(pid, number)


# Serial; mpiexec forwards SIGUSR1; a batch system may signal any of the ranks.
@pytest.mark.parametrize(("ranks", "to", "number"), [
    (0, 0, signal.SIGTERM), (0, 0, signal.SIGXCPU), (2, 1, signal.SIGTERM), (3, None, signal.SIGUSR1)])
def test_the_last_field_is_kept(folder: Path, ranks: int, to: int | None, number: signal.Signals) -> None:
    (folder / "result.vtkhdf").write_text("an earlier result")
    with started(patient(folder), ranks) as process:
        wait_for(folder.parent / "iterating*", max(ranks, 1))
        _send(process, folder, number, to)
        out, err = process.communicate(timeout=LIMIT)
        job = Finished(process.returncode, out, err, 0.0)
    assert job.code == 3
    assert len(job.errors) == 1, job.err
    assert job.errors[0].startswith("stopped by a signal after iteration ")
    kept = folder / "result.not_converged.vtkhdf"
    assert str(kept) in job.errors[0]
    assert (folder / "result.earlier.vtkhdf").read_text() == "an earlier result"
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    _check_kept_field(kept)


def test_what_looks_at_the_material_stops_too(folder: Path) -> None:
    law = '[identification]\nloaded = ["left"]\n[[identification.material]]\nlaw = "isotropic"\npoisson_ratio = 0.3\n'
    write_case(folder, FOUR + ENDLESS + law)
    with started(patient(folder, command="identify"), 2) as process:
        wait_for(folder.parent / "iterating*", 2)
        _send(process, folder, signal.SIGTERM, 1)
        out, err = process.communicate(timeout=LIMIT)
        job = Finished(process.returncode, out, err, 0.0)
    assert job.code == 3
    assert len(job.errors) == 1, job.err
    assert job.errors[0].startswith("stopped by a signal after iteration ")
    _check_kept_field(folder / "result.not_converged.vtkhdf")


def _check_kept_field(kept: Path) -> None:
    """It is whole, and marked."""
    with pytest.warns(UserWarning, match="this field did not converge .stopped by a signal"):
        result = ddic.open(kept)
    assert not result.converged
    summary = json.loads(kept.with_suffix(".json").read_text())
    assert summary["converged"] is False
    # The start is found to tenths of a pixel and better; the waves have an amplitude of half a pixel.
    assert np.isfinite(result.displacement).all()
    assert 0 < np.abs(result.displacement).max() < 1.5


@pytest.mark.parametrize("ranks", [2])
def test_it_goes_on_from_where_it_was_stopped(folder: Path, ranks: int) -> None:
    with started(patient(folder), ranks) as process:
        wait_for(folder.parent / "iterating*", max(ranks, 1))
        _send(process, folder, signal.SIGUSR1, None)
        process.communicate(timeout=LIMIT)
    assert process.returncode == 3
    write_case(folder, FOUR + '[start]\nfrom_result = "result.not_converged.vtkhdf"\n')
    job = finished(driven("", folder), ranks)
    assert job.code == 0, job.err
    assert ddic.open(folder / "result.vtkhdf").converged


def test_a_stop_before_the_first_iteration_leaves_no_field(folder: Path) -> None:
    early = """
import os, signal, time
import ddic.methods.run as run_pair
ordinary = run_pair.open_inputs
def open_and_signal(team, *arguments):
    os.kill(os.getpid(), signal.SIGTERM)
    while not team.stop.asked:  # another thread notes it, on a busy machine later than an iteration takes
        time.sleep(0.01)
    return ordinary(team, *arguments)
run_pair.open_inputs = open_and_signal
"""
    job = finished(driven(early, folder), 0)
    assert job.code == 3, job.err
    assert job.errors == ["stopped by a signal before the first iteration"]
    assert sorted(path.name for path in folder.iterdir()) == ["case.toml", "f.tif", "g.tif"]


def test_separated_corrections_stop_too(folder: Path) -> None:
    write_case(folder, "[pgd]\ntolerance = 1e-300\nrms_tolerance = 1e-300\nstop_at_noise = false\n")
    third = """
import os, signal, time
import ddic.methods.pgd_dic as pgd_dic
ordinary = pgd_dic.SeparatedSession._report
def report_and_signal(session, record):
    if record.number == 3:
        os.kill(os.getpid(), signal.SIGUSR1)
        while not session._problem.team.stop.asked:
            time.sleep(0.01)
    ordinary(session, record)
pgd_dic.SeparatedSession._report = report_and_signal
"""
    job = finished(driven(third, folder), 0)
    assert job.code == 3, job.err
    assert job.errors[0].startswith("stopped by a signal after correction 3,")
    _check_kept_field(folder / "result.not_converged.vtkhdf")


# Anywhere between the start and some ten iterations, on an idle machine; drawn, but the same every day.
@pytest.mark.parametrize("seed", [0])
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_a_signal_at_any_time_ends_the_run(folder: Path, ranks: int, seed: int) -> None:
    draw = random.Random(10 * ranks + seed)
    number, to = draw.choice([(signal.SIGUSR1, None), (signal.SIGUSR1, ranks - 1), (signal.SIGTERM, 0),
                              (signal.SIGTERM, ranks - 1)])
    with started(patient(folder, 0.02), ranks) as process:
        wait_for(folder.parent / "pid*", ranks)
        time.sleep(draw.uniform(0.0, 2.0))
        if process.poll() is None:
            _send(process, folder, number, to)
        _, err = process.communicate(timeout=LIMIT)
    names = {path.name for path in folder.iterdir()}
    assert process.returncode in (0, 3), err  # 0: the signal came after the last iteration
    assert ("result.vtkhdf" in names) == (process.returncode == 0)
    assert ("stopped by a signal" in err) == (process.returncode == 3)
    assert not [name for name in names if name.startswith(".")]
    assert ("result.not_converged.vtkhdf" in names) == ("the last field" in err)
