"""Signals that ask a run to stop: noted by a thread, agreed on by all ranks where none is in the middle of its work.

Also how a rank ends that cannot go on: with one line, and all ranks of its job with it; no other is left waiting.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

from ddic.errors import StoppedError, as_collective

if TYPE_CHECKING:
    from ddic.parallel.team import Team

LAUNCHERS = frozenset({"mpirun", "mpiexec", "orterun", "orted", "prterun", "prte", "prted"})
"""Open MPI's programs that start ranks. They end by sending SIGTERM, and SIGKILL one second later."""

INTERRUPTED = 130
"""Exit code of a run that a signal ended at once: what shells say of Ctrl-C."""

_RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")
"""Of Open MPI; of other launchers with PMIx; of MPICH and Intel MPI; of srun."""

_FAILURE_HEAD_START = 2.5
"""Seconds that rank 0 has to tell what all ranks have to tell, before others do, on a busy machine too. A larger value
delays what only another rank knows; the last of them waits for twice as long."""

_STEPS = 64
"""Ranks of which each waits a little longer than the one before."""

STOPPING = (signal.SIGTERM, signal.SIGUSR1, signal.SIGXCPU)
"""What batch systems send ahead of the end of a job's time, of the processor too."""

ENDING = (signal.SIGINT, signal.SIGHUP)
"""Of the keyboard, and of a terminal that closes: they end a run at once."""

REPEATED_AFTER = 1.0
"""Seconds after which a further SIGTERM or SIGINT is a second request, which ends the run at once; before, it is the
first one again, which batch systems send to a job's steps and once more through their launcher. A larger value waits
longer before a second one counts."""

N_INTERRUPTIONS, BETWEEN = 3, 1.5
"""Times that the main thread is interrupted, and seconds after each, before the process ends without it: it may be
waiting inside a library, or a library may have caught the interruption. Larger values give more time to clean up;
together they stay well below the ten seconds after which a batch system kills."""

_INTERRUPTING = signal.SIGALRM
"""Brings an interruption to the main thread; SIGINT may be ignored there, as in what a shell runs in the background."""

_LATER = 0.01
"""Seconds after which an interruption that was lost is sent again; a finalizer takes less."""

_HEAD_START = 1.0
"""Seconds that rank 0 has to speak where all ranks were signalled; the main thread goes on meanwhile. A larger value
lets a short run end before it is interrupted."""

_TOLD = "interrupted; no result was written"
_STOPPED_EARLY = ("stopped by a signal before the first iteration", StoppedError.exit_code)


@dataclass
class StopRequest:
    """Whether this rank was asked to stop.

    Attributes
    ----------
    asked : bool
        Set once, by ``note`` or by hand.
    first_at : float
        When SIGTERM came first, seconds of ``time.monotonic``; infinity before.
    ended_at : float
        When the run was first told to end at once; infinity before.
    has_begun : bool
        Whether the ranks know of one another, so that they can agree on a stop; before, each ends alone.
    is_over : bool
        Whether the run has ended, well or not, and needs no interruption.
    is_by_launcher : bool
        Whether it is the launcher that ends the run: another rank has failed and says why, or the user ended it.
    before_end : callable
        Called where the rank must end at once, from the thread that notes signals: what it removes goes even where the
        main thread waits for other ranks.
    """

    asked: bool = False
    first_at: float = float("inf")
    ended_at: float = float("inf")
    has_begun: bool = False
    is_over: bool = False
    is_by_launcher: bool = False
    before_end: Callable[[], None] = field(default=lambda: None, repr=False)

    def note_signals(self) -> None:
        """Note signals from now on, in a thread of their own; call it before MPI starts its threads.

        They are blocked in all others, so that no operation of MPI, and no file being written, is ever cut short. Those
        of ``ENDING`` that were ignored, as under nohup, stay so.
        """
        numbers = [*STOPPING, *(number for number in ENDING if signal.getsignal(number) != signal.SIG_IGN)]
        signal.signal(_INTERRUPTING, _interrupt)
        sys.unraisablehook = self._take_up
        for number in numbers:
            # For a thread that began earlier and blocks nothing.
            signal.signal(number, lambda number, frame: self.note(number, 0))
        signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
        threading.Thread(target=self._wait_for_signals, args=(numbers,), name="stop request", daemon=True).start()

    def _wait_for_signals(self, numbers: Sequence[int]) -> None:
        while True:
            number, sender = _receive(numbers)
            self.note(number, sender)

    def note(self, number: int, sender: int) -> None:
        """Note a signal, of ``sender`` or 0, or interrupt the main thread where the rank must end at once."""
        is_asked_to_stop = number in STOPPING
        self.asked = self.asked or is_asked_to_stop
        self.is_by_launcher = self.is_by_launcher or (number == signal.SIGTERM and is_launcher(sender))
        if self.is_by_launcher and (self.is_over or not self.has_begun):
            os._exit(INTERRUPTED)
        if self.is_over:
            return
        if not self.has_begun:
            self._end(*(_STOPPED_EARLY if is_asked_to_stop else (_TOLD, INTERRUPTED)))
        now = time.monotonic()
        if now - self.ended_at >= REPEATED_AFTER and number in (signal.SIGTERM, *ENDING):
            self._end(_TOLD, INTERRUPTED)
        if self._is_urgent(number, now) and self.ended_at == float("inf"):
            self.ended_at = now
            if self.is_by_launcher:
                # Which kills one second later, whatever the main thread does.
                self.before_end()
            threading.Thread(target=self._interrupt_until_over, name="interruption", daemon=True).start()

    def _is_urgent(self, number: int, now: float) -> bool:
        """Whether the run must end at once."""
        if number != signal.SIGTERM:
            return number in ENDING
        is_repeated = now - self.first_at >= REPEATED_AFTER
        self.first_at = min(self.first_at, now)
        # A launcher that ends kills its ranks: what time is left is for the removal of temporary files.
        return is_repeated or self.is_by_launcher

    def _interrupt_until_over(self) -> None:
        """Interrupt the main thread, and end the process where that does not."""
        for _ in range(N_INTERRUPTIONS):
            _interrupt_main_thread()
            time.sleep(BETWEEN)
            if self.is_over:
                return
        self._end(_TOLD, INTERRUPTED)

    def _take_up(self, lost: sys.UnraisableHookArgs) -> None:
        """Interrupt again where an interruption was lost in a finalizer; show all else that is lost there as ever."""
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(lost)
        elif not self.is_over:
            # By a thread, a little later: not inside this function, where it would be lost as well.
            threading.Timer(_LATER, _interrupt_main_thread).start()

    def _end(self, line: str, code: int) -> NoReturn:
        self.before_end()
        abort_all_ranks(line, code, _HEAD_START)


def is_stop_asked(team: Team) -> bool:
    """Tell whether any rank was asked to stop, the same on all ranks; collective."""
    return team.maximum(int(team.stop.asked)) > 0


def stop_if_asked(team: Team, when: str) -> None:
    """Raise StoppedError, which says ``when``, on all ranks where any was asked to stop; collective."""
    if is_stop_asked(team):
        raise as_collective(StoppedError(f"stopped by a signal {when}"))


def _interrupt_main_thread() -> None:
    signal.pthread_kill(threading.main_thread().ident or 0, _INTERRUPTING)


def _receive(numbers: Sequence[int]) -> tuple[int, int]:
    """Wait for a signal; its number and its sender, 0 where the system does not say."""
    if not hasattr(signal, "sigwaitinfo"):
        return int(signal.sigwait(numbers)), 0
    info = signal.sigwaitinfo(numbers)
    return info.si_signo, info.si_pid


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Raise an error in the main thread, so that temporary files are removed."""
    raise KeyboardInterrupt


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


def abort_all_ranks(line: str, code: int, head_start: float = _FAILURE_HEAD_START) -> NoReturn:
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
