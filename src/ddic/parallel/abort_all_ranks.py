"""How a rank ends that cannot go on: with one line, and all ranks of its job with it; no other is left waiting."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

LAUNCHERS = frozenset({"mpirun", "mpiexec", "orterun", "orted", "prterun", "prte", "prted"})
"""Open MPI's programs that start ranks. They end by sending SIGTERM, and SIGKILL one second later."""

INTERRUPTED = 130
"""Exit code of a run that a signal ended at once: what shells say of Ctrl-C."""

_RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")
"""Of Open MPI; of other launchers with PMIx; of MPICH and Intel MPI; of srun."""

_HEAD_START = 2.5
"""Seconds that rank 0 has to tell what all ranks have to tell, before others do, on a busy machine too. A larger value
delays what only another rank knows; the last of them waits for twice as long."""

_STEPS = 64
"""Ranks of which each waits a little longer than the one before."""


def find_rank() -> int | None:
    """Tell which rank of a job this is, before MPI has begun, as the launcher says; None without one."""
    for name in _RANK_VARIABLES:
        if os.environ.get(name, "").isdecimal():
            return int(os.environ[name])
    return None


def is_launcher(pid: int) -> bool:
    """Tell whether a process, by its number, is one that starts ranks; False where it is gone, or this one."""
    try:
        name = Path(f"/proc/{pid}/comm").read_text(encoding="utf-8").strip()
    except OSError:
        return False
    return pid != os.getpid() and name in LAUNCHERS


def prepare_abort() -> None:
    """Have an abort speak no lines of Open MPI's own, for ddic says why it ends; call it before MPI begins.

    Of the launcher's own messages none is lost; OMPI_MCA_orte_execute_quiet=0 in the environment brings all back.
    """
    os.environ.setdefault("OMPI_MCA_orte_execute_quiet", "1")


def abort_all_ranks(line: str, code: int, head_start: float = _HEAD_START) -> NoReturn:
    """Say why, in a line for the user, and end this process and all ranks of its job; not collective.

    Nothing is finalised: the end of MPI waits for ranks that wait for this one. Where all ranks have the same to say,
    rank 0 says it, ``head_start`` seconds before others may, and the launcher ends the others before they do.
    """
    rank = find_rank() or 0
    if rank > 0 and _is_ended_within(head_start * (1.0 + (rank % _STEPS) / _STEPS)):
        os._exit(code)
    # Whatever is wrong with the streams, the process ends.
    with suppress(Exception):
        sys.stdout.flush()
    with suppress(Exception):
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
    with suppress(Exception):
        _abort(code)
    os._exit(code)


def _is_ended_within(seconds: float) -> bool:
    """Whether the launcher asks this rank to end meanwhile; where SIGTERM is not blocked it ends it."""
    if not hasattr(signal, "sigtimedwait"):
        time.sleep(seconds)
        return False
    return signal.sigtimedwait([signal.SIGTERM], seconds) is not None


def _abort(code: int) -> None:
    """End all ranks through MPI where it runs: launchers that do not watch exit codes end them too."""
    mpi = sys.modules.get("mpi4py.MPI")
    # Of another thread MPI would have to be free of locks that the main one may hold.
    if mpi is None or threading.current_thread() is not threading.main_thread():
        return
    if mpi.Is_initialized() and not mpi.Is_finalized() and mpi.COMM_WORLD.Get_size() > 1:
        mpi.COMM_WORLD.Abort(code)
