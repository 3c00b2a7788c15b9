"""A case that runs beside the page: what ``ddic run`` prints, and how it is stopped; it outlives the page."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

from bokeh.document import Document
from bokeh.models import Button, PreText, Spinner

from ddic.errors import InputError

POLL_MS = 500
"""From one look at what a run prints to the next."""

WITH_RESULT = (0, 1, 3)
"""Exit codes of ``ddic run`` after which there may be a result: it converged, failed, or was stopped."""

MOST_SHOWN = 20_000
"""Characters from the end of what was printed."""


class CaseRun:
    """``ddic run`` of one case file, at most one at a time, in a process that no closed tab ends.

    Parameters
    ----------
    case_file : Path
        The case.

    Attributes
    ----------
    start_time : float
        When it was last started, seconds since the epoch: older files are not what it wrote.
    """

    def __init__(self, case_file: Path) -> None:
        self._case_file = case_file
        self._process: subprocess.Popen[bytes] | None = None
        self._log: IO[bytes] | None = None
        self.start_time = 0.0

    @property
    def is_running(self) -> bool:
        """Whether it was started and has not ended."""
        return self._process is not None and self._process.poll() is None

    @property
    def exit_code(self) -> int | None:
        """That of ``ddic run``; None before it has ended."""
        return None if self._process is None else self._process.poll()

    def start(self, n_ranks: int) -> None:
        """Start to measure; raises InputError where it runs already, or several ranks cannot be started."""
        if self.is_running:
            raise InputError(f"{self._case_file}: is running already")
        launcher = os.environ.get("MPIEXEC", "mpiexec")
        if n_ranks > 1 and shutil.which(launcher) is None:
            raise InputError(f"{launcher}: not found, for {n_ranks} ranks; run on one")
        on_ranks = [launcher, "-n", str(n_ranks)] if n_ranks > 1 else []
        # A second for clocks of file systems.
        self.start_time = time.time() - 1.0
        # A file, and not a pipe that would end it with this process.
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  open as long as it is read
        self._process = subprocess.Popen(
            [*on_ranks, sys.executable, "-m", "ddic", "run", str(self._case_file)],
            stdin=subprocess.DEVNULL, stdout=self._log, stderr=subprocess.STDOUT, start_new_session=True)

    def stop(self) -> None:
        """Ask it to end after the iteration at hand, or the frame of a series, and to keep what it has."""
        if self._process is not None and self.is_running:
            self._process.send_signal(signal.SIGUSR1)

    def read_log(self) -> str:
        """Read what was printed."""
        if self._log is None:
            return ""
        size = os.fstat(self._log.fileno()).st_size
        begin = max(size - MOST_SHOWN, 0)
        return os.pread(self._log.fileno(), size - begin, begin).decode(errors="replace")


class RunBox:
    """Buttons that start and stop a run, and what it prints.

    Parameters
    ----------
    run : CaseRun
        The run, which other tabs may have started.
    document : Document
        The tab.
    write : callable
        Writes the case before it runs, and says whether it did.
    finished, tell : callable
        Told that there may be a result, and what is wrong.
    """

    def __init__(self, run: CaseRun, document: Document, write: Callable[[], bool], finished: Callable[[], None],
                 tell: Callable[[Sequence[str]], None]) -> None:
        self._run, self._write, self._finished, self._tell = run, write, finished, tell
        self._was_running = False
        self._start = Button(label="Run", button_type="success")
        self._stop = Button(label="Stop, keep the field", disabled=True)
        self._ranks = Spinner(title="Ranks", low=1, high=999, value=1, width=80)
        self.controls = [self._start, self._stop, self._ranks]
        self.log = PreText(text="", width=430, styles={"max-height": "240px", "overflow": "auto"})
        self._start.on_click(self._begin)
        self._stop.on_click(run.stop)
        document.add_periodic_callback(self._follow, POLL_MS)

    def _begin(self) -> None:
        if not self._write():
            return
        try:
            self._run.start(int(self._ranks.value or 1))
            self._was_running = True
        except InputError as error:
            self._tell(error.problems)

    def _follow(self) -> None:
        """Show what the run has printed; a tab that is opened while it runs follows it too."""
        is_running = self._run.is_running
        if is_running or self._was_running:
            self.log.text = self._run.read_log()
        has_ended = self._was_running and not is_running
        self._was_running = is_running
        self._stop.disabled, self._start.disabled = not is_running, is_running
        if has_ended and self._run.exit_code in WITH_RESULT:
            self._finished()
