"""Tries inputs one after the other and says what was wrong with each."""

from __future__ import annotations

import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from accept.support.launcher_lines import drop_launcher_lines
from accept.trials.good_case import make_good_folder
from accept.trials.judge import judge_codes, judge_end, judge_refusal, look_at
from accept.trials.trial import Trial
from accept.trials.watched_worker import HUNG, LIMIT_S, Ended, Worker
from bench.support.runs import environment

OF_LAUNCHER_S = 20.0
"""Seconds more for what starts in processes of its own."""


@dataclass(frozen=True)
class Verdict:
    """What came of a trial.

    Attributes
    ----------
    trial : Trial
        What was tried.
    faults : tuple of str
        What was wrong; empty where it held.
    codes : tuple of int
        Exit codes of its commands.
    peak : int
        Largest memory of them, bytes.
    """

    trial: Trial
    faults: tuple[str, ...]
    codes: tuple[int, ...]
    peak: int


Run = Callable[[Path, Sequence[str], Trial], Ended]
"""Runs one command in a folder."""


def try_all(trials: Sequence[Trial], folder: Path, jobs: int = 1) -> list[Verdict]:
    """Try inputs in processes that stay, several at a time.

    Parameters
    ----------
    trials : sequence of Trial
        What to try.
    folder : Path
        For the good case and its changed copies.
    jobs : int, optional
        Processes at a time.

    Returns
    -------
    list of Verdict
        In the order of the trials.
    """
    good = make_good_folder(folder / "good")
    left: queue.SimpleQueue[tuple[int, Trial]] = queue.SimpleQueue()
    for numbered in enumerate(trials):
        left.put(numbered)
    found: dict[int, Verdict] = {}

    def work(place: Path) -> None:
        with Worker() as worker:
            def run(inside: Path, arguments: Sequence[str], trial: Trial) -> Ended:
                return worker.run(inside, arguments, trial.environment)

            while True:
                try:
                    number, trial = left.get_nowait()
                except queue.Empty:
                    return
                found[number] = try_one(trial, good, place, run)

    threads = [threading.Thread(target=work, args=(folder / f"place_{number}",)) for number in range(jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [found[number] for number in range(len(trials))]


def try_apart(trials: Sequence[Trial], folder: Path, n_ranks: int) -> list[Verdict]:
    """Try inputs as a user does, each command as processes of its own.

    Parameters
    ----------
    trials : sequence of Trial
        What to try.
    folder : Path
        For the good case and its changed copies.
    n_ranks : int
        MPI ranks of ``run``; 0 starts it without a launcher.

    Returns
    -------
    list of Verdict
        In the order of the trials.
    """
    good = make_good_folder(folder / "good")

    def run(inside: Path, arguments: Sequence[str], trial: Trial) -> Ended:
        launcher = []
        if n_ranks and arguments[0] == "run":
            launcher = [environment().get("MPIEXEC", "mpiexec"), "-n", str(n_ranks)]
        return _run_apart([*launcher, sys.executable, "-m", "ddic", *arguments], inside, trial)

    return [try_one(trial, good, folder / "place_apart", run) for trial in trials]


def _run_apart(command: Sequence[str], inside: Path, trial: Trial) -> Ended:
    began = time.perf_counter()
    try:
        done = subprocess.run(command, cwd=inside, env=environment(trial.environment), capture_output=True, check=False,
                              timeout=LIMIT_S + OF_LAUNCHER_S)
    except subprocess.TimeoutExpired:
        return Ended(HUNG, "", "", 0, time.perf_counter() - began)
    told = "\n".join(drop_launcher_lines(done.stderr.decode(errors="replace")))
    return Ended(done.returncode, done.stdout.decode(errors="replace"), told, 0, time.perf_counter() - began)


def try_one(trial: Trial, good: Path, place: Path, run: Run) -> Verdict:
    """Try one input in a fresh copy of the good case.

    Parameters
    ----------
    trial : Trial
        What to try.
    good : Path
        The good case.
    place : Path
        Folder of the copy, and of what is printed.
    run : callable
        Runs one command.

    Returns
    -------
    Verdict
        What came of it.
    """
    shutil.rmtree(place, ignore_errors=True)
    inside = place / "inside"
    shutil.copytree(good, inside)
    try:
        trial.write(inside)
    except Exception as error:
        return Verdict(trial, (f"could not be tried: {type(error).__name__}: {error}",), (), 0)
    faults, codes, peak = [], [], 0
    for command in trial.commands:
        before = look_at(inside)
        ended = run(inside, command, trial)
        wrong = judge_end(ended)
        if not wrong and ended.code != 0 and trial.expected != "ends":
            wrong = judge_refusal(trial, ended, before, look_at(inside))
        faults += [f"{command[0]}: {fault}" for fault in wrong]
        codes.append(ended.code)
        peak = max(peak, ended.peak)
        if ended.code == HUNG:
            break
    return Verdict(trial, (*faults, *judge_codes(trial, codes)), tuple(codes), peak)
