"""Signals that ask a run to stop: noted by a thread, agreed on by all ranks where none is in the middle of its work."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

from ddic.errors import StoppedError, as_collective

if TYPE_CHECKING:
    from ddic.parallel.team import Team

STOPPING = (signal.SIGTERM, signal.SIGUSR1)
"""What batch systems send ahead of the end of a job's time."""

REPEATED_AFTER = 1.0
"""Seconds after which a further SIGTERM is a second request, which ends the run at once; before, it is the first one
again, which batch systems send to a job's steps and once more through their launcher. A larger value waits longer
before a second one counts."""

LAUNCHERS = frozenset({"mpirun", "mpiexec", "orterun", "orted", "prterun", "prte", "prted"})
"""Open MPI's programs that start ranks. They end by sending SIGTERM, and SIGKILL one second later."""

_INTERRUPTING = signal.SIGALRM
"""Brings an interruption to the main thread; SIGINT may be ignored there, as in what a shell runs in the background."""


@dataclass
class StopRequest:
    """Whether this rank was asked to stop.

    Attributes
    ----------
    asked : bool
        Set once, by ``note`` or by hand.
    first_at : float
        When SIGTERM came first, seconds of ``time.monotonic``; infinity before.
    """

    asked: bool = False
    first_at: float = float("inf")

    def note_signals(self) -> None:
        """Note SIGTERM and SIGUSR1 from now on, in a thread of their own; call it before MPI starts its threads.

        They are blocked in all others, so that no operation of MPI, and no file being written, is ever cut short.
        """
        signal.signal(_INTERRUPTING, _interrupt)
        for number in STOPPING:
            # For a thread that began earlier and blocks nothing.
            signal.signal(number, lambda number, frame: self.note(number, 0))
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        threading.Thread(target=self._wait_for_signals, name="stop request", daemon=True).start()

    def _wait_for_signals(self) -> None:
        while True:
            number, sender = _receive()
            self.note(number, sender)

    def note(self, number: int, sender: int) -> None:
        """Note a signal, or interrupt the main thread where the rank must end at once.

        Parameters
        ----------
        number : int
            Of the signal.
        sender : int
            Process that sent it; 0 where it is not known.
        """
        self.asked = True
        if number != signal.SIGTERM:
            return
        now = time.monotonic()
        is_repeated = now - self.first_at >= REPEATED_AFTER
        self.first_at = min(self.first_at, now)
        # A launcher that ends kills its ranks: what time is left is for the removal of temporary files.
        if is_repeated or _is_launcher(sender):
            signal.pthread_kill(threading.main_thread().ident or 0, _INTERRUPTING)


def is_stop_asked(team: Team) -> bool:
    """Tell whether any rank was asked to stop; collective.

    Parameters
    ----------
    team : Team
        All ranks.

    Returns
    -------
    bool
        The same on all ranks.
    """
    return team.maximum(int(team.stop.asked)) > 0


def stop_if_asked(team: Team, when: str) -> None:
    """End the run where any rank was asked to stop; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    when : str
        How far the run is, for the message.

    Raises
    ------
    StoppedError
        On all ranks.
    """
    if is_stop_asked(team):
        raise as_collective(StoppedError(f"stopped by a signal {when}"))


def _receive() -> tuple[int, int]:
    """Wait for a signal; its number and its sender, 0 where the system does not say."""
    if not hasattr(signal, "sigwaitinfo"):
        return int(signal.sigwait(STOPPING)), 0
    info = signal.sigwaitinfo(STOPPING)
    return info.si_signo, info.si_pid


def _is_launcher(process: int) -> bool:
    try:
        name = Path(f"/proc/{process}/comm").read_text(encoding="utf-8").strip()
    except OSError:
        return False
    return process != os.getpid() and name in LAUNCHERS


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Raise an error in the main thread, so that temporary files are removed."""
    raise KeyboardInterrupt
