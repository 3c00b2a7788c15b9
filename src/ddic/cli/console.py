"""What a run prints: a progress bar on a terminal, plain lines in a batch log."""

from __future__ import annotations

import math
import os
import sys
import time
from types import TracebackType
from typing import Protocol, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from ddic.parallel.phases import REPEATED, Phase
from ddic.problem.problem_size import ProblemSize
from ddic.results.summary import Summary
from ddic.solvers.gauss_newton import IterationRecord

_COLUMNS = ("iter", "|dq|/|q|", "RMS dq [px]", "residual [grey]", "[% range]", "Krylov", "its error [px]",
            "residual [s]", "step [s]")


class _Bar(Protocol):
    def phase(self, phase: Phase) -> None: ...
    def settle(self) -> None: ...
    def stop(self) -> None: ...


class RunConsole:
    """Rank 0's listener; use it in a ``with`` statement."""

    def __init__(self) -> None:
        self._console = Console(highlight=False, soft_wrap=True)
        terminal = is_on_terminal()
        self._bar: _Bar = _ProgressBar(self._console) if terminal else _PhaseLines(self._console)
        self._range = 1.0
        self._seconds: dict[Phase, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._bar.stop()

    def phase(self, phase: Phase) -> None:
        """Show the phase that begins.

        Parameters
        ----------
        phase : Phase
            Of the run.
        """
        self._bar.phase(phase)

    def note(self, line: str) -> None:
        """Print a line.

        Parameters
        ----------
        line : str
            Without its end.
        """
        self._print(line)

    def problem_size(self, size: ProblemSize) -> None:
        """Print the sizes and the head of the iteration table.

        Parameters
        ----------
        size : ProblemSize
            Of what is about to be solved.
        """
        self._bar.settle()
        self._range = size.dynamic_range or 1.0
        weight = f", eta = {size.eta:.4g}" if size.eta else ""
        self._print(f"{size.n_unknowns} unknowns, {size.n_cells} elements, {size.n_pixels} pixels; "
                    f"{_count(size.n_subdomains, 'subdomain')} on {_count(size.n_ranks, 'rank')}, "
                    f"{size.n_interface} interface unknowns{weight}")
        self._print("  ".join(f"{name:>{max(len(name), 9)}}" for name in _COLUMNS))

    def iteration(self, record: IterationRecord) -> None:
        """Print a line of the iteration table; the residual is that before the correction.

        Parameters
        ----------
        record : IterationRecord
            Of the iteration that has ended.
        """
        spent = {phase: record.seconds[phase] - self._seconds.get(phase, 0.0) for phase in REPEATED}
        self._seconds = record.seconds
        cells = (f"{record.number}", f"{record.size.relative:.2e}", f"{record.size.rms:.2e}",
                 " ".join(f"{camera.residual_std:.3f}" for camera in record.cameras),
                 f"{100 * record.grey.residual_std / self._range:.2f}", f"{record.krylov_iterations}",
                 f"{record.linear_error:.1e}", f"{spent[Phase.RESIDUAL]:.2f}",
                 f"{spent[Phase.LINEAR_STEP]:.2f}")
        self._print("  ".join(f"{cell:>{max(len(name), 9)}}" for cell, name in zip(cells, _COLUMNS, strict=True)))

    def finish(self, summary: Summary) -> None:
        """Print what was found.

        Parameters
        ----------
        summary : Summary
            Of the run.
        """
        self._bar.stop()
        seconds = ", ".join(f"{name} {value:.2f}" for name, value in summary.seconds.items())
        memory = ", ".join(f"{value / 2**20:.0f}" for value in summary.peak_memory_bytes)
        self._print(f"converged in {summary.iterations} iterations; residual {summary.residual_std_grey:.3f} grey "
                    f"levels ({summary.residual_percent_of_range:.2f} % of the dynamic range), "
                    f"grey-level correction: {summary.grey_correction}")
        for number, near in enumerate(summary.near, start=1):
            turned = f", theta = {near.theta_rad:.2e} +- {near.theta_std_rad:.1e} rad" if near.theta_std_rad else ""
            self._print(f"near field {number}: residual {near.residual_std_grey:.3f} grey levels; its set-up moved by "
                        f"alpha = ({near.alpha_px[0]:.4f} +- {near.alpha_std_px[0]:.4f}, {near.alpha_px[1]:.4f} +- "
                        f"{near.alpha_std_px[1]:.4f}) far-field px{turned}")
        self._print(f"largest jump left at an interface node: {summary.largest_jump_px:.1e} px")
        if math.isfinite(summary.linear_error_px):
            self._print("estimated displacement error left by the linear solver: "
                        f"{summary.linear_error_px:.1e} px RMS")
        if summary.n_pixels_outside:
            self._print(f"{summary.n_pixels_outside} pixels were left out: mapped outside the deformed image or onto "
                        "excluded pixels of it")
        self._print(f"seconds by phase: {seconds}")
        self._print(f"peak memory by rank [MiB]: {memory}")
        self._print(f"result: {summary.result_file}")

    def _print(self, line: str) -> None:
        """Print a line as it is, at once."""
        self._console.print(line, markup=False)
        sys.stdout.flush()


def _count(number: int, noun: str) -> str:
    """A number and its noun."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


class _ProgressBar:
    def __init__(self, console: Console) -> None:
        self._progress = Progress(SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(),
                                  console=console, transient=True)
        self._task: TaskID = self._progress.add_task("start", total=len(Phase))
        self._progress.start()

    def phase(self, phase: Phase) -> None:
        self._progress.update(self._task, description=phase, completed=list(Phase).index(phase))

    def settle(self) -> None:
        pass

    def stop(self) -> None:
        self._progress.stop()


class _PhaseLines:
    """A plain line for each phase that takes long enough to be waited for."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._phase: Phase | None = None
        self._began = time.perf_counter()

    def phase(self, phase: Phase) -> None:
        self._close()
        self._phase, self._began = phase, time.perf_counter()

    def settle(self) -> None:
        # So that the line of the phase before does not land in the iteration table.
        self._close()

    def stop(self) -> None:
        self._close()

    def _close(self) -> None:
        if self._phase is not None and self._phase not in REPEATED:
            self._console.print(f"{self._phase}: {time.perf_counter() - self._began:.2f} s", markup=False)
        self._phase = None


def is_on_terminal() -> bool:
    """Tell whether a person watches; under mpirun, which gives ranks a terminal of its own, mpirun's output counts.

    Returns
    -------
    bool
        Whether the output is a terminal's.
    """
    if not sys.stdout.isatty():
        return False
    launched = any(name in os.environ for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"))
    if not launched:
        return True
    try:
        target = os.readlink(f"/proc/{os.getppid()}/fd/1")
    except OSError:
        return False
    return target.startswith(("/dev/pts/", "/dev/tty"))
