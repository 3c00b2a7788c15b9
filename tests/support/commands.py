"""Run ddic in processes of its own, alone and under mpiexec; nothing survives a test."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from accept.support.ended_job import drop_launcher_lines

LIMIT = 60.0
"""Seconds after which a job counts as hanging; it takes two or three."""

_ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "PMIX_MCA_gds": "hash",
    "PYTHONUNBUFFERED": "1",
}
DDIC = (sys.executable, "-m", "ddic")


@dataclass(frozen=True)
class Finished:
    """Exit code, standard output and error, and wall seconds of a job."""

    code: int
    out: str
    err: str
    seconds: float

    @property
    def errors(self) -> list[str]:
        """Lines of standard error that come from ddic, not from the launcher."""
        return drop_launcher_lines(self.err)


@contextlib.contextmanager
def started(command: Sequence[str], ranks: int = 0) -> Iterator[subprocess.Popen[str]]:
    """Start a command, under mpiexec if ranks > 0, as a group of processes that ends with the block."""
    launcher = ("mpiexec", "-n", str(ranks)) if ranks else ()
    # os.environ, and not what MPI has added to this process' environment.
    process = subprocess.Popen([*launcher, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               env=dict(os.environ) | _ENVIRONMENT, start_new_session=True)
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


def finished(command: Sequence[str], ranks: int = 0) -> Finished:
    """Run a command to its end; fails after LIMIT seconds."""
    begin = time.monotonic()
    with started(command, ranks) as process:
        out, err = process.communicate(timeout=LIMIT)
        return Finished(process.returncode, out, err, time.monotonic() - begin)


def ddic(*arguments: str | Path, ranks: int = 0) -> Finished:
    """Run ddic."""
    return finished([*DDIC, *map(str, arguments)], ranks)


def driven(driver: str, folder: Path, command: str = "run") -> list[str]:
    """Command that runs Python code, then ``ddic run``, or another command, on the folder's case.toml."""
    script = folder.parent / f"{folder.name}_driver.py"
    script.write_text(driver + "\nimport sys\nfrom ddic.cli.app import command_line\n"
                               f"sys.argv = ['ddic', {command!r}, {str(folder / 'case.toml')!r}]\ncommand_line()\n",
                      encoding="utf-8")
    return [sys.executable, str(script)]


def wait_for(condition: Path, n: int = 1) -> None:
    """Wait until ``n`` files match condition's name as a pattern in its folder."""
    limit = time.monotonic() + LIMIT
    while len(list(condition.parent.glob(condition.name))) < n:
        if time.monotonic() > limit:
            raise TimeoutError(f"{condition} did not appear")
        time.sleep(0.02)
