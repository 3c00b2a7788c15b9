"""What rank 0 prints: plain lines in a log, a bar on a terminal, one table row per iteration."""

from __future__ import annotations

import dataclasses
import os
import pty
import re
import sys
import time
from collections.abc import Sequence

import numpy as np
import pytest

from ddic.parallel.phases import REPEATED, Phase
from ddic.problem.weighted_problem import ProblemSize
from ddic.results.console import RunConsole, is_on_terminal
from ddic.results.summary import Summary
from ddic.separated.corrections import CorrectionRecord
from ddic.solvers.correction_size import CorrectionSize
from ddic.solvers.gauss_newton import GreyState, IterationRecord

SIZE = ProblemSize(n_unknowns=200, n_cells=81, n_pixels=20736, n_subdomains=4, n_ranks=2, n_interface=60,
                   dynamic_range=200.0, eta=12.5)
SUMMARY = Summary(converged=True, iterations=2, residual_std_grey=1.5, residual_percent_of_range=0.75, n_dofs=200,
                  n_subdomains=4, n_ranks=2, krylov_iterations=[11, 7], seconds={Phase.READ: 0.5, Phase.WRITE: 0.25},
                  cpu_seconds={Phase.READ: 1.0}, peak_memory_bytes=[2**27, 2**28], largest_jump_px=2e-9,
                  linear_error_px=3e-6, n_pixels=20000, n_pixels_outside=0, grey_correction="global",
                  result_file="/a/[b]/result.vtkhdf")


def _record(number: int, seconds: float) -> IterationRecord:
    size = CorrectionSize(10.0**-number, 0.5 / number, largest=1.0, subdomain=0, known_rms=0.5 / number, n_slow=1)
    return IterationRecord(number, size, (GreyState(2.0, 2.1, 20736, 1.0, 0.0),), 12 - number, np.zeros(2), 3e-6,
                           {Phase.RESIDUAL: seconds, Phase.LINEAR_STEP: 2 * seconds})


def _speak(summary: Summary = SUMMARY) -> None:
    with RunConsole() as console:
        for phase in Phase:
            console.phase(phase)
        console.note("start: a note with [brackets]")
        console.problem_size(SIZE)
        console.iteration(_record(1, 1.0))
        console.iteration(_record(2, 1.5))
        console.finish(summary)


def test_a_log_has_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    _speak()
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "\r" not in out
    lines = out.splitlines()
    assert "start: a note with [brackets]" in lines
    assert any(line.startswith("200 unknowns, 81 elements, 20736 pixels; 4 subdomains on 2 ranks, "
                               "60 interface unknowns, eta = 12.5") for line in lines)
    assert "result: /a/[b]/result.vtkhdf" in lines
    assert "largest jump left at an interface node: 2.0e-09 px" in lines
    assert "estimated displacement error left by the linear solver: 3.0e-06 px RMS" in lines
    assert any("converged in 2 iterations; residual 1.500 grey levels (0.75 %" in line for line in lines)
    assert "peak memory by rank [MiB]: 128, 256" in lines


@dataclasses.dataclass
class _Clock:
    """Seconds that pass when a test says so."""

    now: float = 100.0

    def __call__(self) -> float:
        return self.now


def _log_phases(monkeypatch: pytest.MonkeyPatch, spent: Sequence[tuple[Phase, float]]) -> None:
    """A run before its iteration table."""
    clock = _Clock()
    monkeypatch.setattr("ddic.results.console.time.perf_counter", clock)
    with RunConsole() as console:
        for phase, seconds in spent:
            console.phase(phase)
            clock.now += seconds
        console.problem_size(SIZE)


def _phase_lines(out: str) -> list[str]:
    return [line for line in out.splitlines() if line.partition(":")[0] in list(Phase)]


def test_a_log_names_each_phase_once_before_the_table(monkeypatch: pytest.MonkeyPatch,
                                                      capsys: pytest.CaptureFixture[str]) -> None:
    _log_phases(monkeypatch, [(phase, 0.5) for phase in Phase])
    out = capsys.readouterr().out
    assert _phase_lines(out) == [f"{phase}: 0.50 s" for phase in Phase if phase not in REPEATED]
    assert out.index("write: 0.50 s") < out.index("200 unknowns")


def test_a_log_adds_up_a_phase_that_is_entered_again(monkeypatch: pytest.MonkeyPatch,
                                                     capsys: pytest.CaptureFixture[str]) -> None:
    _log_phases(monkeypatch, [(Phase.MESH, 0.02), (Phase.MESH, 0.1), (Phase.START, 0.2), (Phase.MESH, 0.3),
                              (Phase.START, 0.0), (Phase.READ, 0.4)])
    assert _phase_lines(capsys.readouterr().out) == ["mesh: 0.42 s", "start: 0.20 s", "read: 0.40 s"]


def test_a_log_says_at_once_what_came_before_a_long_phase(monkeypatch: pytest.MonkeyPatch,
                                                          capsys: pytest.CaptureFixture[str]) -> None:
    _log_phases(monkeypatch, [(Phase.MESH, 0.1), (Phase.START, 2.0), (Phase.MESH, 3.0), (Phase.READ, 0.4)])
    assert _phase_lines(capsys.readouterr().out) == ["mesh: 0.10 s", "start: 2.00 s", "mesh: 3.00 s", "read: 0.40 s"]


def test_a_log_is_silent_about_phases_that_nobody_waits_for(monkeypatch: pytest.MonkeyPatch,
                                                            capsys: pytest.CaptureFixture[str]) -> None:
    _log_phases(monkeypatch, [(Phase.MESH, 0.04), (Phase.START, 1.5), (Phase.READ, 0.02), (Phase.READ, 0.04)])
    assert _phase_lines(capsys.readouterr().out) == ["start: 1.50 s", "read: 0.06 s"]


def test_a_log_ends_with_the_phase_in_which_a_run_stops(monkeypatch: pytest.MonkeyPatch,
                                                        capsys: pytest.CaptureFixture[str]) -> None:
    clock = _Clock()
    monkeypatch.setattr("ddic.results.console.time.perf_counter", clock)
    with RunConsole() as console:
        console.phase(Phase.ASSEMBLE)
        clock.now += 0.7
    assert _phase_lines(capsys.readouterr().out) == ["assemble: 0.70 s"]


def test_table_rows_hold_each_iterations_own_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    _speak()
    lines = capsys.readouterr().out.splitlines()
    head = next(n for n, line in enumerate(lines) if "|dq|/|q|" in line)
    # number, |dq|/|q|, RMS and largest dq, residual, % of the dynamic range, Krylov and its error, own seconds.
    assert lines[head + 1].split() == ["1", "1.00e-01", "5.00e-01", "1.00e+00", "2.000", "1.00", "11", "3.0e-06",
                                       "1.00", "2.00"]
    assert lines[head + 2].split() == ["2", "1.00e-02", "2.50e-01", "1.00e+00", "2.000", "1.00", "10", "3.0e-06",
                                       "0.50", "1.00"]
    assert len(lines[head]) == len(lines[head + 1]) == len(lines[head + 2])


def test_tables_fit_a_hundred_columns(capsys: pytest.CaptureFixture[str]) -> None:
    correction = CorrectionRecord(100, (0.1, 0.2), (1e-3, 1e-3), (1e-3, 1e-3), 1e-10, 1e-10, 6,
                                  GreyState(1234.5, 1234.5, 10**9, 1.0, 0.0), 24, 1e-3, 0.05)
    with RunConsole() as console:
        console.problem_size(dataclasses.replace(SIZE, dynamic_range=4095.0))
        capsys.readouterr()
        for number, seconds in ((1, 123.0), (50, 234.5)):
            record = _record(number, seconds)
            console.iteration(dataclasses.replace(record, cameras=2 * (GreyState(1234.5, 1234.5, 10**9, 1.0, 0.0),)))
        for number in (1, 100):
            console.correction(dataclasses.replace(correction, number=number))
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines) <= 100
    # Each table's rows are as wide as its head.
    assert len({len(line) for line in lines[:3]}) == len({len(line) for line in lines[3:]}) == 1


def test_noise_floor_is_told_beside_the_last_correction(capsys: pytest.CaptureFixture[str]) -> None:
    _speak()
    assert "noise floor" not in capsys.readouterr().out
    _speak(dataclasses.replace(SUMMARY, noise_floor_px=0.00534, iteration_table={"rms_correction_px": [0.1, 2e-6]}))
    line = "noise floor: 0.0053 px RMS a component, were the residual all noise; the last correction was 2.0e-06 px RMS"
    assert line in capsys.readouterr().out.splitlines()


def test_pixels_left_out_are_told_only_if_there_are_any(capsys: pytest.CaptureFixture[str]) -> None:
    _speak()
    assert "left out" not in capsys.readouterr().out
    _speak(dataclasses.replace(SUMMARY, n_pixels_outside=321))
    assert "321 pixels were left out" in capsys.readouterr().out


def test_long_lines_are_not_broken(capsys: pytest.CaptureFixture[str]) -> None:
    with RunConsole() as console:
        console.note("x" * 500)
    assert "x" * 500 + "\n" in capsys.readouterr().out


def test_a_file_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull, "w") as nowhere:
        monkeypatch.setattr(sys, "stdout", nowhere)
        assert not is_on_terminal()


def test_a_terminal_gets_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    outer, inner = pty.openpty()
    for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK", "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    with os.fdopen(inner, "w") as screen:
        monkeypatch.setattr(sys, "stdout", screen)
        assert is_on_terminal()
        with RunConsole() as console:
            console.phase(Phase.ASSEMBLE)
            console.note("a note")
            time.sleep(0.3)  # the bar is drawn ten times a second
            console.progress(0.5)
            time.sleep(0.3)
        screen.flush()
        shown = os.read(outer, 100_000).decode()
    os.close(outer)
    assert "\x1b[" in shown
    assert "assemble" in shown
    assert "a note" in shown
    # 34 per cent are done after less than a second.
    assert re.search(r"about [12] s left", shown)
