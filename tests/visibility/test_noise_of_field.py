"""Corrections that do not become smaller are accepted where they are far below the noise of the field."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ddic.errors import ConvergenceError
from ddic.results.measurement import Measurement
from ddic.visibility.seen_cells import TypicalCell
from support.spoilt import Spoilt, clean, hide, measure_files

MANY = (60, 60, 170, 130)


AT_REST = "[start]\n" + "".join(f"{key} = false\n" for key in ("rigid", "features", "pyramid", "independent"))


def stop_early(folder: Path, scene: Spoilt, iterations: int, more: str = "") -> tuple[Measurement, float, float]:
    """Of a measurement that may take few iterations: the residual, grey levels, and the field's noise, pixels."""
    measured, ears = measure_files(folder, scene, "[gauss_newton]\ntolerance = 1e-16\nrms_tolerance = 1e-9\n"
                                                  f"max_iterations = {iterations}\n{more}")
    pattern = r"a residual of ([\d.]+) grey levels leaves an error of ([\d.e+-]+) px RMS"
    found = [match for note in ears.notes if (match := re.search(pattern, note))]
    assert len(found) == 1
    return measured, float(found[0][1]), float(found[0][2])


@pytest.mark.parametrize("scene", [clean(), hide(MANY)], ids=["clean", "hidden"])
def test_the_noise_is_that_of_the_pixels_that_count(tmp_path: Path, scene: Spoilt,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    # What converges is not asked; so it is asked after two iterations.
    monkeypatch.setattr("ddic.visibility.solved_frame.PATIENCE", 1)
    measured, residual, noise = stop_early(tmp_path, scene, 2)
    # Noise of 2 grey levels in both images, interpolated in one of them.
    assert 2.3 <= residual <= 3.1
    # What such noise leaves on these cells: 0.02 px was measured. Elastic matter 1e-4 as stiff as texture, which nodes
    # that were not measured have, would have a hundred times as much.
    assert 0.012 <= noise <= 0.05
    assert any(is_unmeasured.any() for is_unmeasured in measured.unmeasured) == scene.hidden.any()


def test_few_iterations_are_no_sign_of_noise(tmp_path: Path) -> None:
    with pytest.raises(ConvergenceError, match="did not converge in 2 iterations"):
        stop_early(tmp_path, clean(), 2)


def test_a_correction_that_is_more_than_noise_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ddic.visibility.solved_frame.PATIENCE", 0)
    # After one iteration from 2.8 px off.
    with pytest.raises(ConvergenceError, match="did not converge in 1 iterations"):
        stop_early(tmp_path, clean(), 1, AT_REST)


def test_forces_of_a_wrong_place_are_no_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("PATIENCE", 0), ("SHARE_OF_NOISE", 1e9), ("LARGEST_OF_NOISE", 1e9)):
        monkeypatch.setattr(f"ddic.visibility.solved_frame.{name}", value)
    monkeypatch.setattr(TypicalCell, "is_alike", True)
    # Far beyond what one iteration finds.
    wrong = 'points = [[100.0, 100.0, 17.0, -14.0]]\n[correlation]\nspoilt_pixels = "keep"\n'
    _, residual, noise = stop_early(tmp_path, clean(), 1, AT_REST + wrong)
    assert residual > 10.0
    # Noise of one grey level leaves 0.0075 px; forces that move cells say ten times as much.
    assert noise / residual == pytest.approx(0.0075, rel=0.2)
