"""Rows of acceptance tables judge what their texts say."""

from __future__ import annotations

import signal
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from accept import hard_starts, kills_and_signals, moved_specimen, recorded
from accept.kills_and_signals import COMPUTING, STARTING
from accept.moved_specimen import Believed
from accept.recorded_cases import CASES
from accept.support.ended_job import Ended
from accept.table import Scale

COVERED = f"occlusion of {moved_specimen.OCCLUSION} px"


@pytest.mark.parametrize(("number", "moment", "code", "was_reached", "is_measured", "is_right"), [
    (signal.SIGTERM, COMPUTING, 3, True, False, True),
    (signal.SIGTERM, COMPUTING, 0, True, True, True),
    # It ended as if all were well, and measured nothing.
    (signal.SIGTERM, COMPUTING, 0, True, False, False),
    (signal.SIGTERM, COMPUTING, 143, True, False, False),
    (signal.SIGTERM, STARTING, 143, True, False, True),
    (signal.SIGHUP, COMPUTING, 130, True, False, True),
    (signal.SIGHUP, COMPUTING, 3, True, False, False),
    (signal.SIGKILL, COMPUTING, 137, True, False, True),
    (signal.SIGKILL, COMPUTING, 0, True, False, False),
    # The rank had gone by itself.
    (signal.SIGKILL, COMPUTING, 0, False, True, True),
    (signal.SIGKILL, COMPUTING, 137, False, True, False)])
def test_exit_codes_of_killed_runs_are_bounded(number: signal.Signals, moment: str, code: int, *, was_reached: bool,
                                               is_measured: bool, is_right: bool) -> None:
    trial = kills_and_signals._Trial(2, number, 0, moment, 0.1)
    outcome = kills_and_signals._Outcome(Ended(code, 1.0, [], 0), was_reached, is_measured)
    assert (code in kills_and_signals._list_codes(trial, outcome)) == is_right


@pytest.mark.parametrize(("codes", "holds"), [
    ([3] * 75 + [0] * 20 + [130] * 5, True), ([3] * 70 + [0] * 30, False), ([3] * 90 + [143] * 10, False)])
def test_signals_that_change_nothing_are_counted(codes: list[int], holds: bool) -> None:
    assert kills_and_signals._count_obeyed(codes).holds == holds


def _disturbed(displacement: NDArray[np.float64], doubtful: NDArray[np.bool_], name: str = COVERED) -> Believed:
    """What is said of a field of the small specimen, without regularization."""
    specimen = moved_specimen.make_specimen(128, 90)
    mesh = ddic.structured_mesh(specimen.box, moved_specimen.ELEMENT)
    result = SimpleNamespace(mesh=mesh, displacement=displacement, fields={"doubtful": doubtful})
    return moved_specimen.judge_marks(result, specimen, name, (0, 0))  # type: ignore[arg-type]


def test_disturbed_judges_nodes_and_shares_of_marks() -> None:
    mesh = ddic.structured_mesh(moved_specimen.make_specimen(128, 90).box, moved_specimen.ELEMENT)
    exact, none = moved_specimen.displace(mesh.nodes), np.zeros(mesh.n_cells, dtype=bool)
    assert _disturbed(exact, none) == Believed(0.0, 0.0, 0.0)
    # One corner off by 1 px: 0.25 px in the mean of its cell, which is what was judged.
    corner = exact.copy()
    corner[0, 0] += 1.0
    assert _disturbed(corner, none).worst == pytest.approx(1.0)
    assert not _disturbed(corner, none).holds
    first = none.copy()
    first[0] = True
    assert _disturbed(corner, first) == Believed(0.0, 1 / mesh.n_cells, 0.0)
    # A field that is off everywhere, and says so of every cell, is none.
    everywhere = _disturbed(exact + 4.9, ~none)
    assert everywhere == Believed(0.0, 1.0, 0.0)
    assert not everywhere.holds
    # The middle is covered by 80 of 128 px, about which any cell may be marked; a dimmed image has no such place.
    assert _disturbed(exact, first, "brightness x 0.6") == Believed(0.0, 1 / mesh.n_cells, 1 / mesh.n_cells)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_fields_have_the_gradient_that_is_printed(seed: int) -> None:
    deformation = hard_starts.make_random(np.random.default_rng(seed), 0.15)
    # Central differences over 2e-3 px of waves of 300 px and longer.
    assert hard_starts.measure_largest_gradient(deformation) == pytest.approx(0.15, rel=1e-6)


def test_recorded_guards_the_default_path_and_prints_every_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES["grey"]
    before = {run.name: np.zeros((4, 2)) for run in case.runs}
    # The present code is off where nothing is switched off.
    off = {recorded.ALL_PIXELS.ending: 0.0, recorded.BY_DEFAULT.ending: 1e-3}
    monkeypatch.setattr(recorded, "make_inputs", lambda *_: [])
    monkeypatch.setattr(recorded, "recorded_fields", lambda *_: (before, "recorded"))
    monkeypatch.setattr(recorded, "measure_fields", lambda *given: {
        name: field + off[given[-1].ending] for name, field in before.items()})
    rows = recorded.recorded(Scale(smoke=True))
    assert [row.holds for row in rows] == [True, False]
    switched_off = 'correlation.spoilt_pixels = "keep"'
    assert [switched_off in row.check for row in rows] == [True, False]
    for row in rows:
        assert 'global: correlation.grey_correction = "global"' in row.check.replace(f"{switched_off}, ", "")
        assert 'solver.method = "dual", solver.tolerance = 1e-12, solver.inexact = false' in row.check
