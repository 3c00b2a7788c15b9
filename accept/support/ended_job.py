"""Jobs under mpiexec that are expected to end: when the last process is gone, with which code, and what ddic said."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from bench.support.runs import environment, images

_OF_LAUNCHER = re.compile(r"\[[^\]]+:\d+\] |(mpi\w+|\(null\)): (Forwarding signal |abort is already)|\[warn\] Epoll ")
"""Open MPI names host and process, or the launcher, which now and then is ``(null)``; libevent within it warns."""

_RULE = "-" * 40


def drop_launcher_lines(text: str) -> list[str]:
    """Keep the lines of the ranks."""
    kept, quoted = [], False
    for line in text.splitlines():
        if line.startswith(_RULE):
            quoted = not quoted
        elif line.strip() and not quoted and not _OF_LAUNCHER.match(line):
            kept.append(line)
    return kept


DDIC = (sys.executable, "-m", "ddic")
"""The command line of the source that is measured, whatever is installed beside the interpreter."""

LONGEST = 10.0
"""Seconds in which every process of a job must be gone."""

_GIVEN_UP = 60.0
"""Seconds after which a job counts as hanging; it is ended then."""

_POLL = 0.01

CASE = ('[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
        "[mesh.structured]\nregion = [20, 20, 220, 220]\nelement_size = 20\n"
        '[solver]\nmethod = "dual"\nsubdomains = 4\n'
        '[output]\nfile = "result.vtkhdf"\n')
"""A pair that is measured in a second, on up to four ranks."""


def prepare_case(folder: Path) -> Path:
    """Make a small pair and its case file."""
    images("translation", "--vector", "1.3", "-0.7", "--size", "240x240", "--seed", "3", folder=folder / "images")
    path = folder / "case.toml"
    path.write_text(CASE, encoding="utf-8")
    return path


@dataclass(frozen=True)
class Ended:
    """What became of a job.

    Attributes
    ----------
    code : int
        Exit code of the launcher, or of ddic alone.
    seconds : float
        From ``Job.wait`` until the last process was gone; infinity where one had to be killed.
    lines : list of str
        Of standard error, but for those of the launcher.
    n_launcher_lines : int
        Those.
    """

    code: int
    seconds: float
    lines: list[str]
    n_launcher_lines: int


class Job:
    """A command on some ranks, whose processes are all known at its end; use it in a ``with`` statement.

    Parameters
    ----------
    n_ranks : int
        Ranks under mpiexec; 0 for the command alone.
    command : sequence of str
        What each rank runs.
    folder : Path
        Where it runs.
    changes : mapping, optional
        Variables of its environment that differ from this process's.
    """

    def __init__(self, n_ranks: int, command: Sequence[str], folder: Path,
                 changes: Mapping[str, str] | None = None) -> None:
        launcher = [os.environ.get("MPIEXEC", "mpiexec"), "-n", str(n_ranks)] if n_ranks else []
        self._said: IO[str] = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115  # closed by __exit__
        self.process = psutil.Popen([*launcher, *command], cwd=folder, env=environment(changes),
                                    stdout=subprocess.DEVNULL, stderr=self._said, start_new_session=True)
        self._n_ranks = n_ranks
        self._known: set[psutil.Process] = set()

    def __enter__(self) -> Job:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._list_alive():
            with suppress(psutil.NoSuchProcess):
                process.kill()
        self.process.wait()
        self._said.close()

    def list_ranks(self) -> list[psutil.Process]:
        """List the processes of the ranks that have been started, by rank."""
        if self._n_ranks == 0:
            alone: psutil.Process = self.process
            return [alone]
        with suppress(psutil.NoSuchProcess):
            ranks = self.process.children()
            self._known.update(ranks)
            return sorted(ranks, key=lambda process: process.pid)
        return []

    def is_running(self) -> bool:
        """Tell whether the launcher, or the command alone, runs."""
        return self.process.poll() is None

    def wait(self) -> Ended:
        """Wait until every process is gone; what stays is killed.

        Returns
        -------
        Ended
            With the seconds from now on.
        """
        began = time.monotonic()
        self.list_ranks()
        while self.process.poll() is None or self._list_alive():
            if time.monotonic() - began > _GIVEN_UP:
                return Ended(-1, float("inf"), *self._read())
            self.list_ranks()
            time.sleep(_POLL)
        return Ended(int(self.process.returncode), time.monotonic() - began, *self._read())

    def _list_alive(self) -> list[psutil.Process]:
        alive: list[psutil.Process] = [self.process] if self.process.poll() is None else []
        for process in self._known:
            with suppress(psutil.NoSuchProcess):
                if process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
                    alive.append(process)
        return alive

    def _read(self) -> tuple[list[str], int]:
        """Lines of ddic, and the number of those of the launcher."""
        self._said.seek(0)
        said = self._said.read()
        own = drop_launcher_lines(said)
        return own, sum(bool(line.strip()) for line in said.splitlines()) - len(own)


def list_hidden(folder: Path) -> list[str]:
    """List what a run that was ended has left beside its result: files whose names begin with a dot."""
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))
