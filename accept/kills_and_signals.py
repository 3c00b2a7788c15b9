"""Runs that are killed or signalled at random times: whether all of them ends, and what is left."""

from __future__ import annotations

import random
import shutil
import signal
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from accept.support.ended_job import DDIC, LONGEST, Ended, Job, list_hidden, prepare_case
from accept.table import Scale
from bench.support.rows import Row, append_result
from ddic.errors import DdicError
from ddic.io.result_reader import read_result

N_TRIALS, N_SMOKE_TRIALS = 100, 3

STOPPING = (signal.SIGTERM, signal.SIGUSR1, signal.SIGXCPU)
ENDING = (signal.SIGINT, signal.SIGHUP)
SIGNALS = (signal.SIGKILL, *STOPPING, *ENDING)

STARTING, COMPUTING, WRITING = MOMENTS = ("the first two seconds", "computing", "writing")

_SEED = 18
_POLL = 0.002


@dataclass(frozen=True)
class _Trial:
    """What is done to a run: signal, to which rank of how many (0: ddic alone), in which moment, seconds into it."""

    n_ranks: int
    number: signal.Signals
    rank: int
    moment: str
    delay: float

    def describe(self) -> str:
        return f"{self.number.name} to rank {self.rank} of {self.n_ranks}, {self.moment}, {self.delay:.2f} s"


def measure_kills_and_signals(scale: Scale) -> list[Row]:
    """Kill or signal runs over an older result at random times.

    Parameters
    ----------
    scale : Scale
        A smoke run does a trial in each moment.

    Returns
    -------
    list of Row
        One row.
    """
    folder = scale.folder("kills_and_signals")
    prepare_case(folder)
    _clear(folder)
    older = _measure_older(folder)
    draw = random.Random(_SEED)
    faults, slowest, codes, n_dirty = list[str](), 0.0, Counter[str](), 0
    for number in range(N_SMOKE_TRIALS if scale.smoke else N_TRIALS):
        trial = _draw(draw, MOMENTS[number % len(MOMENTS)])
        ended = _try(trial, folder)
        slowest = max(slowest, ended.seconds)
        codes[f"{trial.number.name} {ended.code}"] += 1
        found = _judge(trial, ended, folder, older)
        if list_hidden(folder):
            n_dirty += 1
            found += _run_again(folder)
        faults += [f"{trial.describe()}: {fault}" for fault in found]
        _clear(folder)
        (folder / "result.vtkhdf").write_bytes(older)
    append_result("kills_and_signals", {"faults": faults, "codes": dict(codes), "slowest_s": slowest})
    told = ", ".join(f"{name}: {count}" for name, count in sorted(codes.items()))
    what = f"{sum(codes.values())} kills and signals, a third each in {', '.join(MOMENTS)}, alone and on 1-4 ranks"
    return [Row(what,
                f"all processes gone within {LONGEST:g} s, result whole or absent, the older one intact, exit codes as "
                "documented, one line; the next run leaves the folder clean",
                f"slowest {slowest:.1f} s; {len(faults)} faults{'; '.join(['', *faults[:3]])}; {n_dirty} left "
                f"something for the next run to remove; codes {told}", not faults)]


def _draw(draw: random.Random, moment: str) -> _Trial:
    n_ranks = draw.choice((0, 1, 2, 3, 4))
    longest = {STARTING: 2.0, COMPUTING: 1.0, WRITING: 0.05}[moment]
    return _Trial(n_ranks, draw.choice(SIGNALS), draw.randrange(max(n_ranks, 1)), moment, draw.uniform(0.0, longest))


def _clear(folder: Path) -> None:
    """Remove all that runs have left."""
    for path in (*folder.glob("result*"), *folder.glob(".*")):
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def _measure_older(folder: Path) -> bytes:
    """The result of a run that nothing disturbs; it stays in the folder."""
    with Job(0, [*DDIC, "run", "case.toml"], folder) as job:
        done = job.wait()
    if done.code != 0:
        raise RuntimeError(f"an undisturbed run ended with {done.code}: {done.lines}")
    return (folder / "result.vtkhdf").read_bytes()


def _try(trial: _Trial, folder: Path) -> Ended:
    """Run, and signal one rank."""
    with Job(trial.n_ranks, [*DDIC, "run", "case.toml"], folder) as job:
        while job.is_running() and not _has_come(trial, job, folder):
            time.sleep(_POLL)
        time.sleep(trial.delay)
        ranks = job.list_ranks()
        if trial.rank < len(ranks):
            with suppress(psutil.NoSuchProcess):
                ranks[trial.rank].send_signal(trial.number)
        return job.wait()


def _has_come(trial: _Trial, job: Job, folder: Path) -> bool:
    """Whether the moment has come after which a signal is sent."""
    if trial.moment == STARTING:
        return len(job.list_ranks()) >= max(trial.n_ranks, 1)
    if trial.moment == WRITING:
        return bool(list_hidden(folder))
    # The libraries are there, and a second of the processor has been spent: imports take as much.
    ranks = job.list_ranks()
    try:
        return bool(ranks) and sum(ranks[0].cpu_times()[:2]) > 1.0
    except psutil.NoSuchProcess:
        return False


def _judge(trial: _Trial, ended: Ended, folder: Path, older: bytes) -> list[str]:
    """What is wrong after a trial."""
    faults = []
    if ended.seconds > LONGEST:
        faults.append(f"gone after {ended.seconds:.1f} s")
    if ended.code not in _list_codes(trial):
        faults.append(f"exit code {ended.code}")
    if len(ended.lines) > 1 or any("Traceback" in line for line in ended.lines):
        faults.append(f"{len(ended.lines)} lines, the first: {ended.lines[0][:80]}")
    return [*faults, *_judge_results(folder, older, ended.code)]


def _list_codes(trial: _Trial) -> tuple[int, ...]:
    """Exit codes that are documented: 0 where the run was over, and the system's own before ddic has begun."""
    of_system = {128 + trial.number, -trial.number}
    ended = () if trial.number == signal.SIGKILL else (3,) if trial.number in STOPPING else (130,)
    return (0, *ended, *(of_system if trial.number == signal.SIGKILL or trial.moment == STARTING else ()))


def _judge_results(folder: Path, older: bytes, code: int) -> list[str]:
    """What is wrong with results: each is whole, and the older one is there where no new one replaces it."""
    faults = []
    for path in sorted(folder.glob("result*.vtkhdf")):
        if "residual" in path.name:
            continue
        try:
            read_result(path)
        except DdicError as error:
            faults.append(f"{path.name} cannot be read: {error}")
    places = [folder / name for name in ("result.vtkhdf", "result.earlier.vtkhdf")]
    is_older_there = any(path.is_file() and path.read_bytes() == older for path in places)
    if not is_older_there and not (code == 0 or (folder / "result.json").is_file()):
        faults.append("the older result is gone, and no new one is there")
    return faults


def _run_again(folder: Path) -> list[str]:
    """What is wrong with a run after one that has left something."""
    left = list_hidden(folder)
    with Job(0, [*DDIC, "run", "case.toml"], folder) as job:
        done = job.wait()
    faults = [] if done.code == 0 else [f"the next run ended with {done.code}: {done.lines[:1]}"]
    still = list_hidden(folder)
    return [*faults, *([f"the next run leaves {still} of {left}"] if still else [])]
