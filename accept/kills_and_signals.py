"""Runs that are killed or signalled at random times, and ranks that cannot start: whether all ends, what is left."""

from __future__ import annotations

import os
import random
import shutil
import signal
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
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

MOST_LATE = 0.25
"""Share of the signals but SIGKILL after which a run may end as if there had been none, since it was past its last
iteration."""
MOST_BEFORE = 0.05
"""Share of them that may end it before it has learnt what they mean."""

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


@dataclass(frozen=True)
class _Outcome:
    """What became of a trial: the job, whether the rank ran when it was signalled, whether a new result is there."""

    ended: Ended
    was_reached: bool
    is_measured: bool


def measure_kills_and_signals(scale: Scale) -> list[Row]:
    """Kill or signal runs over an older result at random times."""
    folder = scale.folder("kills_and_signals")
    prepare_case(folder)
    _clear(folder)
    older = _measure_older(folder)
    draw = random.Random(_SEED)
    faults, slowest, codes, n_dirty = list[str](), 0.0, Counter[str](), 0
    signalled: list[int] = []
    for number in range(N_SMOKE_TRIALS if scale.smoke else N_TRIALS):
        trial = _draw(draw, MOMENTS[number % len(MOMENTS)])
        outcome = _try(trial, folder)
        ended = outcome.ended
        slowest = max(slowest, ended.seconds)
        codes[f"{trial.number.name} {ended.code}"] += 1
        if outcome.was_reached and trial.number != signal.SIGKILL:
            signalled.append(ended.code)
        found = _judge(trial, outcome, folder, older)
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
                f"all processes gone within {LONGEST:g} s, result whole or absent, the older one intact, one line; "
                "exit codes 3 (stopped), 130 (ended), 137 (killed), 0 where a new result is there, the signal's own "
                "before ddic has begun; the next run leaves the folder clean",
                f"slowest {slowest:.1f} s; {len(faults)} faults{'; '.join(['', *faults[:3]])}; {n_dirty} left "
                f"something for the next run to remove; codes {told}", not faults), _count_obeyed(signalled)]


def _count_obeyed(codes: list[int]) -> Row:
    """How many of the signals but SIGKILL that reached a rank were obeyed, by the exit codes that followed."""
    n_late, n_obeyed = codes.count(0), sum(code in (3, 130) for code in codes)
    n_before = len(codes) - n_late - n_obeyed
    return Row(f"signals but SIGKILL that reach a rank: {len(codes)}",
               f"at most {MOST_LATE:.0%} change nothing (exit code 0), at most {MOST_BEFORE:.0%} end it before it "
               "knows them (128 and the signal), all others are obeyed (3 or 130)",
               f"{n_late} change nothing, {n_before} end it before, {n_obeyed} are obeyed",
               n_late <= MOST_LATE * len(codes) and n_before <= MOST_BEFORE * len(codes), judged_small=False)


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


def _try(trial: _Trial, folder: Path) -> _Outcome:
    """Run, and signal one rank."""
    was_reached = False
    with Job(trial.n_ranks, [*DDIC, "run", "case.toml"], folder) as job:
        while job.is_running() and not _has_come(trial, job, folder):
            time.sleep(_POLL)
        time.sleep(trial.delay)
        ranks = job.list_ranks()
        if trial.rank < len(ranks):
            with suppress(psutil.NoSuchProcess):
                was_reached = ranks[trial.rank].status() != psutil.STATUS_ZOMBIE
                ranks[trial.rank].send_signal(trial.number)
        return _Outcome(job.wait(), was_reached, (folder / "result.json").is_file())


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


def _judge(trial: _Trial, outcome: _Outcome, folder: Path, older: bytes) -> list[str]:
    """What is wrong after a trial."""
    faults, ended = [], outcome.ended
    if ended.seconds > LONGEST:
        faults.append(f"gone after {ended.seconds:.1f} s")
    if ended.code not in _list_codes(trial, outcome):
        faults.append(f"exit code {ended.code}")
    if len(ended.lines) > 1 or any("Traceback" in line for line in ended.lines):
        faults.append(f"{len(ended.lines)} lines, the first: {ended.lines[0][:80]}")
    return [*faults, *_judge_results(folder, older, ended.code)]


def _list_codes(trial: _Trial, outcome: _Outcome) -> tuple[int, ...]:
    """Exit codes that are documented: 0 where the run came to its end, and the system's own before ddic has begun."""
    if not outcome.was_reached:
        return (0,)
    of_system = (128 + trial.number, -trial.number)
    if trial.number == signal.SIGKILL:
        obeyed: tuple[int, ...] = of_system
    else:
        of_ddic = 3 if trial.number in STOPPING else 130
        obeyed = (of_ddic, *of_system) if trial.moment == STARTING else (of_ddic,)
    return (0, *obeyed) if outcome.is_measured else obeyed


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


MODULES = ("click", "numpy", "petsc4py", "mpi4py", "cv2", "numba", "ddic.methods.run", "ddic.solvers.gauss_newton")
"""Before MPI begins, with it, and after it."""

SIZES_MIB = (100, 200, 300, 450, 600, 800, 1000, 1020, 1040, 1060, 1300, 2000)
"""Libraries need 1050 MiB: below, each fails in a way of its own; the last is enough."""

_BREAKING = """
import os, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["BROKEN_MODULE"]:
            raise {"ImportError": ImportError("no such library"), "MemoryError": MemoryError()}[os.environ["BROKEN_BY"]]
if os.environ.get("OMPI_COMM_WORLD_RANK") == os.environ.get("BROKEN_RANK"):
    sys.meta_path.insert(0, Finder())
"""
"""What Python runs first, as ``sitecustomize``."""


def measure_failing_starts(scale: Scale) -> list[Row]:
    """Start ddic on ranks of which one fails to import something, and within limits on the address space."""
    folder = scale.folder("failing_starts")
    prepare_case(folder)
    return [*_break_one_rank(scale, folder), *_limit_address_space(scale, folder)]


def _break_one_rank(scale: Scale, folder: Path) -> list[Row]:
    modules, ranks = (MODULES[-2:-1], (2,)) if scale.smoke else (MODULES, (2, 4))
    (folder / "first").mkdir(exist_ok=True)
    (folder / "first" / "sitecustomize.py").write_text(_BREAKING, encoding="utf-8")
    ended = {}
    for n_ranks, module, kind in product(ranks, modules, ("ImportError", "MemoryError")):
        changes = {"PYTHONPATH": _prepend(folder / "first"), "BROKEN_MODULE": module, "BROKEN_BY": kind,
                   "BROKEN_RANK": str(n_ranks - 1)}
        with Job(n_ranks, [*DDIC, "run", "case.toml"], folder, changes) as job:
            ended[f"{kind} of {module} on {n_ranks} ranks"] = job.wait()
    return _judge_starts("one rank has an ImportError or no memory while it starts", ended)


def _prepend(folder: Path) -> str:
    return os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH", "")])])


def _limit_address_space(scale: Scale, folder: Path) -> list[Row]:
    ended, n_measured = {}, 0
    for n_ranks, size in product((2,) if scale.smoke else (0, 2), SIZES_MIB[7:8] if scale.smoke else SIZES_MIB):
        limited = ["sh", "-c", f'ulimit -v {1024 * size}; exec "$@"', "sh", *DDIC, "run", "case.toml"]
        with Job(n_ranks, limited, folder) as job:
            done = job.wait()
        if done.code == 0:
            n_measured += 1
        else:
            ended[f"{size} MiB on {n_ranks} ranks"] = done
    return _judge_starts(f"ulimit -v at 12 sizes, alone and on 2 ranks ({n_measured} measured)", ended)


def _judge_starts(what: str, ended: dict[str, Ended]) -> list[Row]:
    """Whether all jobs ended with one line and exit code 1, and in time."""
    what = f"{what}: {len(ended)} that cannot start"
    wrong = [f"{name}: code {done.code}, {len(done.lines)} lines" for name, done in ended.items()
             if done.code != 1 or len(done.lines) != 1]
    slowest = max((done.seconds for done in ended.values()), default=0.0)
    append_result("failing_starts", {"what": what, "slowest_s": slowest, "wrong": wrong})
    return [Row(what, "each ends with one line and exit code 1",
                f"{len(ended) - len(wrong)} so{'; '.join(['', *wrong[:3]])}", not wrong),
            Row(f"{what}: the slowest", f"<= {LONGEST:g} s", f"{slowest:.1f} s", slowest <= LONGEST,
                judged_small=False)]
