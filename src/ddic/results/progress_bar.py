"""How much of a run is done, as far as can be told while it goes on: a bar on a terminal."""

import math
import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

from ddic.parallel.phases import REPEATED, Phase

WEIGHTS = {
    Phase.MESH: 3, Phase.START: 15, Phase.READ: 10, Phase.ASSEMBLE: 12, Phase.INDEPENDENT_START: 8,
    Phase.FACTORIZE: 12, Phase.INTERFACE_SET_UP: 10, Phase.RESIDUAL: 10, Phase.LINEAR_STEP: 10, Phase.FINISH: 3,
    Phase.WRITE: 7,
}
"""What each phase takes of a run, per cent, both of those that iterations repeat together: a guess from runs on 1 to
29 megapixels by the dual method. Where it is wrong, the time left is too, less and less as the run goes on."""

OF_ITERATION = 0.5
"""What one iteration of Gauss-Newton does of those that are left: it takes three to five as a rule."""

OF_CORRECTION = 0.1
"""The same of PGD-DIC's corrections, of which there are some ten or twenty."""


class RunShare:
    """Adds up what is done; it never goes back, although a run enters phases again.

    Attributes
    ----------
    done : float
        Share of the run, from 0 to 1.
    """

    def __init__(self) -> None:
        self.done = 0.0
        self._phase = Phase.MESH
        self._left_of_iterations = 1.0

    def begin(self, phase: Phase) -> None:
        """Take note of a phase that begins."""
        self._phase = phase
        if phase not in REPEATED:
            self.set_share(0.0)

    def set_share(self, share: float) -> None:
        """Take note of how far the phase at hand is, from 0 to 1."""
        if self._phase not in REPEATED:
            self._reach(_sum_before(self._phase) + share * WEIGHTS[self._phase])

    def add_iteration(self, share: float) -> None:
        """Take note of an iteration that has ended; ``share`` is what it did of those that were left."""
        self._left_of_iterations *= 1.0 - share
        weight = sum(WEIGHTS[phase] for phase in REPEATED)
        self._reach(_sum_before(REPEATED[0]) + weight * (1.0 - self._left_of_iterations))

    def _reach(self, per_cent: float) -> None:
        self.done = max(self.done, per_cent / sum(WEIGHTS.values()))


def _sum_before(phase: Phase) -> float:
    """What phases before one take, per cent."""
    phases = list(Phase)
    return float(sum(WEIGHTS[earlier] for earlier in phases[:phases.index(phase)]))


class _Lines(Console):
    """What is printed; a closed pipe fails like a full disk, where Rich would end the program."""

    def on_broken_pipe(self) -> None:
        """Raise the error that Rich has caught."""
        raise  # noqa: PLE0704


class ProgressBar:
    """A bar below the lines that a run prints."""

    def __init__(self) -> None:
        self._console = _Lines(highlight=False, soft_wrap=True)
        self._progress = Progress(SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(),
                                  _TimeLeft(), console=self._console, transient=True)
        self._share = RunShare()
        self._task = self._progress.add_task("start", total=1.0)
        self._progress.start()

    def show_line(self, line: str) -> None:
        """Print a line as it is, at once."""
        self._console.print(line, markup=False)
        sys.stdout.flush()

    def begin(self, phase: Phase) -> None:
        """Show the phase that begins."""
        self._share.begin(phase)
        self._progress.update(self._task, description=phase, completed=self._share.done)

    def set_share(self, share: float) -> None:
        """Show how far the phase at hand is, from 0 to 1."""
        self._share.set_share(share)
        self._progress.update(self._task, completed=self._share.done)

    def add_iteration(self, *, is_correction: bool) -> None:
        """Show that an iteration of Gauss-Newton, or a correction of PGD-DIC, has ended."""
        self._share.add_iteration(OF_CORRECTION if is_correction else OF_ITERATION)
        self._progress.update(self._task, completed=self._share.done)

    def show_phases(self) -> None:
        """Do nothing: the bar shows them, below what is printed."""

    def stop(self) -> None:
        """Remove the bar."""
        self._progress.stop()


LEAST_SHARE = 0.1
"""Share of a run before which nothing is said of the time left. A larger value guesses later and better."""


class _TimeLeft(ProgressColumn):
    """What a run takes yet if it goes on as before."""

    def render(self, task: Task) -> Text:
        done, elapsed = float(task.completed), task.elapsed or 0.0
        if done < LEAST_SHARE:
            return Text("")
        return Text(f"about {_describe_seconds(elapsed * (1.0 - done) / done)} left")


def _describe_seconds(seconds: float) -> str:
    """A time to wait, in words."""
    if seconds < 60:
        return f"{math.ceil(seconds)} s"
    if seconds < 3600:
        return f"{math.ceil(seconds / 60)} min"
    return f"{seconds / 3600:.1f} h"
