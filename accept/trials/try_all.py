"""Tries bad inputs and damaged files one after the other, and judges whether each command ended as it should."""

from __future__ import annotations

import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from accept.support.ended_job import drop_launcher_lines
from accept.trials.trial import Trial, make_good_folder
from accept.trials.watched_worker import HUNG, LIMIT_S, Ended, Worker
from bench.support.runs import environment

MOST_BYTES = 2 << 30
"""Memory of a command."""

REFUSED, MEASURED, NOT_CONVERGED = 2, 0, 1
WANTED: Mapping[str, tuple[int, ...]] = {
    "refused": (REFUSED,), "refused or measured": (REFUSED, MEASURED), "may fail": (REFUSED, MEASURED, NOT_CONVERGED),
}
MOST_CHARACTERS = 6000
"""Of all that is said of one mistake: a name may be 4096 long."""

State = Mapping[str, tuple[int, int]]


def look_at(folder: Path) -> State:
    """List what a folder holds."""
    return {str(path.relative_to(folder)): (path.lstat().st_size, path.lstat().st_mtime_ns)
            for path in folder.rglob("*")}


def judge_end(ended: Ended) -> list[str]:
    """Find what no command may do, whatever it is given."""
    if ended.code == HUNG:
        return [f"still there after {LIMIT_S:g} s"]
    if ended.code < 0:
        return [f"ended by signal {-ended.code}"]
    faults = [f"exit code {ended.code}"] if ended.code not in (REFUSED, MEASURED, NOT_CONVERGED) else []
    if "Traceback" in ended.stderr or "Traceback" in ended.stdout:
        last = next((line for line in reversed(ended.stderr.splitlines()) if line.strip()), "")
        faults.append(f"a traceback: {last[:200]}")
    if ended.peak > MOST_BYTES:
        faults.append(f"{ended.peak / 2**30:.1f} GiB")
    return faults


def judge_refusal(trial: Trial, ended: Ended, before: State, after: State) -> list[str]:
    """Find what is wrong with a refusal."""
    faults = []
    lines = list_mistakes(ended.stderr)
    if not 1 <= len(lines) <= trial.n_mistakes:
        faults.append(f"{len(lines)} lines: {' | '.join(line[:120] for line in lines[:4])}")
    if len(ended.stderr) > MOST_CHARACTERS:
        faults.append(f"{len(ended.stderr)} characters are said")
    changed = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
    if ended.code == REFUSED and changed:
        faults.append(f"written: {', '.join(changed[:5])}")
    return faults


def list_mistakes(stderr: str) -> list[str]:
    """List the lines that tell of a mistake: not warnings."""
    return [line for line in stderr.splitlines() if line.strip() and not line.startswith("warning: ")]


def judge_codes(trial: Trial, codes: Sequence[int]) -> Iterable[str]:
    """Find whether commands agree with what is expected and with one another."""
    if trial.expected == "ends":
        return
    for command, code in zip(trial.commands, codes, strict=False):
        wanted = WANTED[trial.expected]
        if code not in wanted and code >= 0:
            yield f"{command[0]}: exit code {code}, {' or '.join(map(str, wanted))} expected"
    by_name = {command[0]: code for command, code in zip(trial.commands, codes, strict=False)}
    if "check" in by_name and "run" in by_name and (by_name["check"] == REFUSED) != (by_name["run"] == REFUSED):
        yield f"check ends with {by_name['check']}, run with {by_name['run']}"


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
    """Try inputs in processes that stay, several at a time."""
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
    """Try inputs as a user does, each command as processes of its own."""
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
    """Try one input in a fresh copy of the good case."""
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
