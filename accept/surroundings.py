"""What surrounds a command: streams that are closed, a folder that is gone, a clock in 2280, no room for files."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.full_disks import small_disk
from accept.support.ended_job import DDIC, LONGEST, Ended, Job, prepare_case
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import NotHereError, environment

TRIED = {"run": (0, ("run", "case.toml")), "run on 2 ranks": (2, ("run", "case.toml")),
         "check": (0, ("check", "case.toml")), "info": (0, ("info", "images/reference.tif"))}
"""Commands by name: ranks, 0 without a launcher, and words of ``ddic``."""

UNREAD = ("bash", "-c", 'set -o pipefail; "$@" | true', "sh")
CLOSED = ("sh", "-c", 'exec "$@" >&- 2>&- <&-', "sh")
GONE = ("sh", "-c", 'mkdir "gone.$$" && cd "gone.$$" && rmdir "../gone.$$" && exec "$@"', "sh")
"""What starts a command whose standard output nobody reads, whose streams are closed, whose folder is deleted."""

LIMIT_KIB = 8
"""Of a file: less than what a launcher maps, and than a result."""

DISK_KIB = 64
SAME_PX = 1e-4
"""Largest difference between fields of one case, pixels."""

LATER = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int (*get)(clockid_t, struct timespec *) = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = get(clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += 8036668800;
    return failed;
}
"""
"""A system's clock some 255 years late: in 2280."""


def measure_surroundings(scale: Scale) -> list[Row]:
    """Run commands over an older result where something around them is not as usual."""
    folder = scale.folder("surroundings")
    shutil.rmtree(folder, ignore_errors=True)
    prepare_case(folder)
    trials = _Trials(folder, dict(list(TRIED.items())[:1]) if scale.smoke else TRIED)
    rows = [
        trials.refuse("a pipe that nobody reads", UNREAD, 1, "", "exit code 1, one line at most"),
        trials.measure("closed standard streams", CLOSED),
        trials.refuse("a working directory that was deleted", GONE, 2, "the working directory cannot be found",
                      "exit code 2, one line that names it"),
        _set_clock(trials), _limit_files(trials), _fill_temporary_files(trials)]
    slowest = max(trials.taken)
    return [*rows, Row(f"all of these, {len(trials.taken)} commands: the slowest", f"<= {LONGEST:g} s",
                       f"{slowest[0]:.1f} s: {slowest[1]}", slowest[0] <= LONGEST, judged_small=False)]


class _Trials:
    """Commands that are tried in a folder with a result, whose field is known."""

    def __init__(self, folder: Path, tried: Mapping[str, tuple[int, tuple[str, ...]]]) -> None:
        self.folder, self._tried = folder, tried
        with Job(0, [*DDIC, "run", "case.toml"], folder) as job:
            ended = job.wait()
        if ended.code:
            raise RuntimeError(f"the case itself ends with {ended.code}: {ended.lines}")
        self._field = self._read_field()
        self.taken: list[tuple[float, str]] = []

    def refuse(self, what: str, starter: tuple[str, ...], code: int, named: str, bound: str) -> Row:
        """How commands end that cannot go on; where nothing is named, they may say nothing."""
        wrong = []
        for name, (n_ranks, words) in self._tried.items():
            before = _read(self.folder)
            ended = self.run(f"{what}, {name}", n_ranks, (*starter, *DDIC, *words))
            is_said = len(ended.lines) == 1 and named in ended.lines[0]
            if ended.code != code or not (is_said or (not named and not ended.lines)):
                wrong.append(f"{name}: code {ended.code}, {ended.lines[:2]}")
            wrong += [f"{name}: files have changed"] * (_read(self.folder) != before)
        return self._judge(what, f"{bound}, all files as they were", wrong)

    def measure(self, what: str, starter: tuple[str, ...]) -> Row:
        """How commands end that can go on all the same."""
        wrong = []
        for name, (n_ranks, words) in self._tried.items():
            ended = self.run(f"{what}, {name}", n_ranks, (*starter, *DDIC, *words))
            wrong += [f"{name}: {fault}" for fault in self.find_faults(ended)]
        return self._judge(what, f"exit code 0, the field is the same to {SAME_PX} px", wrong)

    def run(self, name: str, n_ranks: int, command: tuple[str, ...],
            changes: Mapping[str, str] | None = None) -> Ended:
        """Run a command in the folder, and keep how long it takes."""
        with Job(n_ranks, command, self.folder, changes) as job:
            ended = job.wait()
        self.taken.append((ended.seconds, name))
        return ended

    def find_faults(self, ended: Ended) -> list[str]:
        """What is wrong with a command that should have succeeded, and with the result."""
        if ended.code:
            return [f"code {ended.code}, {ended.lines[:2]}"]
        difference = float(np.abs(self._read_field() - self._field).max())
        return [] if difference <= SAME_PX else [f"{difference:.1e} px off"]

    def _judge(self, what: str, bound: str, wrong: list[str]) -> Row:
        return Row(f"{what}: ddic {', '.join(self._tried)}", f"{bound}, no traceback",
                   f"{len(wrong)} are not so{'; '.join(['', *wrong[:3]])}", not wrong)

    def _read_field(self) -> NDArray[np.float64]:
        return ddic.open(self.folder / "result.vtkhdf").displacement


def _set_clock(trials: _Trials) -> Row:
    """A clock beyond what Python can read, made by a library that is loaded before all others."""
    what, library = "a clock in 2280", trials.folder / "later.so"
    source = library.with_suffix(".c")
    source.write_text(LATER, encoding="utf-8")
    try:
        subprocess.run(["cc", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"], check=True,
                       env=environment(), capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        return Row(what, "measured", f"not measured: {error}", False, judged_small=False)
    return trials.refuse(what, ("env", f"LD_PRELOAD={library}"), 1, "the system's clock stands",
                         "exit code 1, one line that names it")


def _limit_files(trials: _Trials) -> Row:
    """A limit that holds for the launcher too, which would map larger files before a rank starts."""
    before = _read(trials.folder)
    launcher = (environment().get("MPIEXEC", "mpiexec"), "-n", "2")
    limited = ("bash", "-c", f'ulimit -f {LIMIT_KIB}; exec "$@"', "sh")
    ended = trials.run("ulimit -f", 0, (*limited, *launcher, *DDIC, "run", "case.toml"))
    is_same = _read(trials.folder) == before
    is_said = len(ended.lines) == 1 and "result.vtkhdf could not be read or written: File too large" in ended.lines[0]
    return Row(f"ulimit -f {LIMIT_KIB} for mpiexec and 2 ranks: ddic run",
               "exit code 1, one line that names the result, all files as they were",
               f"exit code {ended.code}, {len(ended.lines)} lines {ended.lines[:1]}, files "
               f"{'as they were' if is_same else 'have changed'}", ended.code == 1 and is_said and is_same)


def _fill_temporary_files(trials: _Trials) -> Row:
    """A full disk where the launcher and libraries keep what is temporary."""
    what, disk = "a full TMPDIR for mpiexec and 2 ranks: ddic run", trials.folder / "disk"
    try:
        with small_disk(disk, DISK_KIB):
            (disk / "filler").write_bytes(bytes(1024 * (DISK_KIB - 4)))
            (disk / "rest").write_bytes(bytes(shutil.disk_usage(disk).free))
            ended = trials.run("a full TMPDIR", 2, (*DDIC, "run", "case.toml"), {"TMPDIR": str(disk)})
            wrong = trials.find_faults(ended)
    except NotHereError as error:
        return Row(what, "measured", f"not measured: {error}", False, judged_small=False)
    return Row(what, f"exit code 0, the field is the same to {SAME_PX} px",
               f"exit code {ended.code}{'; '.join(['', *wrong])}", not wrong)


def _read(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
