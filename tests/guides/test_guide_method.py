from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ddic
from ddic.case.loader import LoadedCase
from ddic.case.methods import METHODS
from ddic.check.case import check_case
from ddic.errors import ConvergenceError, is_collective
from ddic.inputs.inputs import open_inputs
from ddic.methods.method import prepare_session
from ddic.methods.run import run_pair
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.publishing import Publishable
from support.guides import run_guide


@pytest.fixture
def guide(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    # Its line of the registry goes with the test.
    monkeypatch.setattr("ddic.case.methods.METHODS", dict(METHODS))
    return run_guide("method")


def load(guide: dict[str, Any]) -> LoadedCase:
    return LoadedCase(guide["case"], Path("case.toml"), "")


def test_translation_of_the_guide(guide: dict[str, Any]) -> None:
    result = guide["result"]
    assert np.abs(result.displacement - [1.3, -0.7]).max() < 5e-3
    assert np.isnan(result.at(np.array([[5.0, 5.0]]))).all()
    assert result.converged


def test_case_of_the_guide_is_checked_run_and_written_as_any_other(guide: dict[str, Any]) -> None:
    loaded = load(guide)
    assert check_case(loaded).n_cells == 16
    summary = run_pair(Team.world(), loaded, Silence())
    assert summary.method == "translation"
    assert summary.iterations > 1
    assert 0 < summary.noise_floor_px < 1e-2
    assert summary.ranges is not None
    assert summary.ranges.displacement_px["x"] == pytest.approx((1.3, 1.3), abs=5e-3)
    file = guide["folder"] / "result.vtkhdf"
    assert np.array_equal(ddic.open(file).displacement, guide["result"].displacement)
    assert json.loads((guide["folder"] / "result.json").read_text())["case"]["translation"]["tolerance"] == 1e-5


def test_session_of_the_guide_starts_from_its_last_field(guide: dict[str, Any]) -> None:
    with ddic.prepare(guide["case"]) as session:
        first = session.measure(guide["folder"] / "g.tif")
        again = session.measure(guide["folder"] / "g.tif", from_last=True)
    assert np.abs(first.displacement - again.displacement).max() < 1e-5


def test_method_of_the_guide_raises_where_it_does_not_converge(guide: dict[str, Any]) -> None:
    hasty = guide["TranslationSection"](tolerance=1e-12, most_iterations=1)
    with pytest.raises(ConvergenceError, match="still moves") as caught:
        ddic.measure(guide["case"].model_copy(update={"translation": hasty}))
    assert is_collective(caught.value)
    assert not caught.value.result.converged


def test_sweeps_refuse_the_method_of_the_guide(guide: dict[str, Any]) -> None:
    with pytest.raises(ddic.errors.InputError, match=r"leave \[translation\] out"):
        ddic.choose_regularization(guide["case"])


def test_what_the_guide_measures_is_publishable(guide: dict[str, Any]) -> None:
    team = Team.world()
    inputs, frame = open_inputs(team, load(guide))
    with prepare_session(team, inputs, Silence(), PhaseClock(), frame) as session:
        assert isinstance(session.measure(frame), Publishable)
