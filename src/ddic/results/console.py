"""What a run prints: plain lines in a batch log, beside a bar on a terminal."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

import click

from ddic.parallel.phases import REPEATED, Phase
from ddic.problem.weighted_problem import ProblemSize
from ddic.results.summary import SeriesSummary, Summary
from ddic.solvers.gauss_newton import IterationRecord

if TYPE_CHECKING:
    from ddic.results.progress_bar import ProgressBar
    from ddic.separated.corrections import CorrectionRecord


_COLUMNS = {"iter": 4, "|dq|/|q|": 8, "RMS dq/px": 9, "max dq/px": 9, "residual": 8, "% range": 7, "Krylov": 6,
            "error/px": 8, "pass/s": 6, "step/s": 6}
"""Names and widths of the table of iterations, which fits 100 characters with up to two cameras. The residual is in
grey levels, by camera, and left out where only the pixels about slow nodes were visited; the error is what the Krylov
solver leaves of the correction; the seconds are those of the pass over the pixels and of the linear step."""

_CORRECTION_COLUMNS = {"number": 6, "du_x/px": 8, "du_y/px": 8, "of u_x": 8, "of u_y": 8, "gain": 8, "of noise": 8,
                       "residual": 8, "sweeps": 6, "modes": 6}
"""The same of the table of corrections; sizes of corrections are RMS."""

_OF_CAMERA = 9
"""Characters of a camera's residual, with the blank after it."""


class RunConsole:
    """Rank 0's listener; use it in a ``with`` statement."""

    def __init__(self) -> None:
        self._shown: ProgressBar | _PhaseLines = _PhaseLines()
        if is_on_terminal():
            # Here, for a batch log does without Rich.
            from ddic.results.progress_bar import ProgressBar

            self._shown = ProgressBar()
        self._print = self._shown.show_line
        self._range = 1.0
        self._seconds: dict[Phase, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the bar off the terminal, and print the phases that have not been."""
        self._shown.stop()

    def phase(self, phase: Phase) -> None:
        """Show the phase that begins."""
        self._shown.begin(phase)

    def progress(self, share: float) -> None:
        """Show how far the phase at hand is, from 0 to 1."""
        self._shown.set_share(share)

    def note(self, line: str) -> None:
        """Print a line, given without its end."""
        self._print(line)

    def frame(self, number: int, n_frames: int, image: str) -> None:
        """Print which frame of a series begins, numbered from 1, and the name of its image file."""
        self._shown.show_phases()
        self._print(f"frame {number} of {n_frames}: {image}")

    def problem_size(self, size: ProblemSize) -> None:
        """Print the sizes of what is about to be solved."""
        self._shown.show_phases()
        self._range = size.dynamic_range or 1.0
        weight = f", eta = {size.eta:.4g}" if size.eta else ""
        self._print(f"{size.n_unknowns} unknowns, {size.n_cells} elements, {size.n_pixels} pixels; "
                    f"{_count(size.n_subdomains, 'subdomain')} on {_count(size.n_ranks, 'rank')}, "
                    f"{size.n_interface} interface unknowns{weight}")
        if size.half_amplitudes is not None:
            self._print(f"regularization: {size.half_amplitudes.describe()}")

    def iteration(self, record: IterationRecord) -> None:
        """Print a line of the iteration table; the residual is that before the correction."""
        self._shown.add_iteration(is_correction=False)
        widths = _COLUMNS | {"residual": max(_COLUMNS["residual"], _OF_CAMERA * len(record.cameras) - 1)}
        spent = {phase: record.seconds[phase] - self._seconds.get(phase, 0.0) for phase in REPEATED}
        self._seconds = record.seconds
        cells = (f"{record.number}", f"{record.size.relative:.2e}", f"{record.size.rms:.2e}",
                 f"{record.size.largest:.2e}",
                 "" if record.is_local else " ".join(f"{camera.residual_std:.3f}" for camera in record.cameras),
                 "" if record.is_local else f"{100 * record.grey.residual_std / self._range:.2f}",
                 f"{record.krylov_iterations}",
                 f"{record.linear_error:.1e}", f"{spent[Phase.RESIDUAL]:.2f}",
                 f"{spent[Phase.LINEAR_STEP]:.2f}")
        self._print_row(record.number, cells, widths)

    def correction(self, record: CorrectionRecord) -> None:
        """Print a line of the table of corrections, below its head; the residual is that before the correction."""
        self._shown.add_iteration(is_correction=True)
        cells = (f"{record.number}", f"{record.rms[0]:.2e}", f"{record.rms[1]:.2e}", f"{record.fluctuation[0]:.2e}",
                 f"{record.fluctuation[1]:.2e}", f"{record.gain:.2e}", f"{record.noise_gain:.2e}",
                 f"{record.grey.residual_std:.3f}", f"{record.n_sweeps}", f"{record.n_modes}")
        self._print_row(record.number, cells, _CORRECTION_COLUMNS)

    def _print_row(self, number: int, cells: Sequence[str], widths: Mapping[str, int]) -> None:
        """Print a row of a table, flush right, below the names of its columns where it is the first."""
        for row in ([*widths], cells) if number == 1 else (cells,):
            self._print("  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths.values(), strict=True)))

    def finish(self, summary: Summary | SeriesSummary) -> None:
        """Print what was found."""
        self._shown.stop()
        if isinstance(summary, SeriesSummary):
            self._finish_series(summary)
        else:
            self._finish_pair(summary)

    def _finish_series(self, summary: SeriesSummary) -> None:
        n_measured = len(summary.frames) - len(summary.failures)
        self._print(f"{n_measured} of {summary.n_frames} frames measured in {summary.seconds:.1f} s"
                    + (f", {summary.n_resumed} of them by an earlier run" if summary.n_resumed else ""))
        for frame in summary.failures:
            self._print(frame.describe())
        self._print(f"verdict: {summary.describe_verdicts()}")
        self._print(f"result: {summary.result_file}")

    def _finish_pair(self, summary: Summary) -> None:
        seconds = ", ".join(f"{name} {value:.2f}" for name, value in summary.seconds.items())
        memory = ", ".join(f"{value / 2**20:.0f}" for value in summary.peak_memory_bytes)
        steps = "iterations" if summary.n_modes is None else f"corrections to {_count(summary.n_modes, 'mode')}"
        alone = f" and {summary.local_iterations} of slow nodes alone" if summary.local_iterations else ""
        self._print(f"converged in {summary.iterations} {steps}{alone}; residual {summary.residual_std_grey:.3f} grey "
                    f"levels ({summary.residual_percent_of_range:.2f} % of the dynamic range), "
                    f"grey-level correction: {summary.grey_correction}")
        for number, near in enumerate(summary.near, start=1):
            turned = f", theta = {near.theta_rad:.2e} +- {near.theta_std_rad:.1e} rad" if near.theta_std_rad else ""
            self._print(f"near field {number}: residual {near.residual_std_grey:.3f} grey levels; its set-up moved by "
                        f"alpha = ({near.alpha_px[0]:.4f} +- {near.alpha_std_px[0]:.4f}, {near.alpha_px[1]:.4f} +- "
                        f"{near.alpha_std_px[1]:.4f}) far-field px{turned}")
        if summary.n_modes is None:
            self._print(f"largest jump left at an interface node: {summary.largest_jump_px:.1e} px")
        if math.isfinite(summary.linear_error_px):
            self._print("estimated displacement error left by the linear solver: "
                        f"{summary.linear_error_px:.1e} px RMS")
        if math.isfinite(summary.noise_floor_px):
            last = list(summary.iteration_table.get("rms_correction_px", ()))
            beside = f"; the last correction was {last[-1]:.1e} px RMS" if last else ""
            self._print(f"noise floor: {summary.noise_floor_px:.2g} px RMS a component, were the residual all noise"
                        f"{beside}")
        if summary.n_pixels_outside:
            self._print(f"{summary.n_pixels_outside} pixels were left out: mapped outside the deformed image or onto "
                        "excluded pixels of it")
        self._print(f"seconds by phase: {seconds}")
        self._print(f"peak memory by rank [MiB]: {memory}")
        if summary.verdict is not None:
            self._print(f"verdict: {summary.verdict.describe()}")
        self._print(f"result: {summary.result_file}")


def _count(number: int, noun: str) -> str:
    """A number and its noun."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


NOTICEABLE = 0.05
"""Seconds below which a batch log does not mention a phase. A larger value prints fewer lines."""

LONG = 1.0
"""Seconds of a phase after which the lines of those before it are printed. A larger value adds up more and prints
later."""


class _PhaseLines:
    """A plain line for each phase that takes long enough to be waited for.

    A run enters some phases several times. What it spends in one adds up, and its line comes when another phase has
    taken long, at the latest before the iteration table.
    """

    def __init__(self) -> None:
        self._phase: Phase | None = None
        self._began = 0.0
        self._unprinted: dict[Phase, float] = {}

    def show_line(self, line: str) -> None:
        click.echo(line)

    def begin(self, phase: Phase) -> None:
        self._close()
        self._phase = phase
        self._began = time.perf_counter()

    def set_share(self, share: float) -> None:
        pass

    def add_iteration(self, *, is_correction: bool) -> None:
        pass

    def show_phases(self) -> None:
        # So that no line of a phase before lands in the iteration table.
        self.stop()

    def stop(self) -> None:
        self._close()
        self._print_all_but(None)
        self._unprinted.clear()

    def _close(self) -> None:
        """Add the time of the phase that ends to its earlier time."""
        ended, self._phase = self._phase, None
        if ended is None or ended in REPEATED:
            return
        spent = time.perf_counter() - self._began
        self._unprinted[ended] = self._unprinted.get(ended, 0.0) + spent
        if spent >= LONG:
            self._print_all_but(ended)

    def _print_all_but(self, kept: Phase | None) -> None:
        for phase, seconds in list(self._unprinted.items()):
            if phase != kept and seconds >= NOTICEABLE:
                self.show_line(f"{phase}: {seconds:.2f} s")
                del self._unprinted[phase]


def is_on_terminal() -> bool:
    """Tell whether the output is a terminal's; under mpirun, which gives ranks one of its own, whether mpirun's is."""
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
