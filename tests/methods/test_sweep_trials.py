"""Predicted errors and the recommendation of a sweep."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.errors import ConvergenceError
from ddic.io.result_reader import Result
from ddic.mesh.structured import build_structured_mesh
from ddic.methods.sweep import VirtualTruth
from ddic.results.sweep import (
    Candidate,
    PairNoise,
    Sweep,
    Trial,
    choose_trial,
    correct_predictions,
    estimate_pair_noise,
    predict_errors,
)

NOWHERE = np.zeros((0, 2))
N_PIXELS, GRADIENT = 10_000, 50.0


def make_trial(size: float, wavelength: float, virtual: float = np.nan, predicted: float = np.nan) -> Trial:
    return Trial(Candidate(size, wavelength), NOWHERE, predicted_error=predicted, virtual_error=virtual)


def make_sweep(*trials: Trial) -> Sweep:
    return Sweep(trials, NOWHERE, 1.0, 0, choose_trial(trials))


def test_prediction_is_bias_and_noise() -> None:
    """Residuals as theory has them: what a field lacks more, less what noise it follows."""
    variance, freedom = 4.0, np.array([1000.0, 300.0, 100.0])
    lacks = np.array([0.0, 900.0, 9000.0])
    # Variances of the fields: tr(A^-1 M A^-1 M), which for a field without regularization is tr(A^-1 M).
    followed = np.array([1000.0, 200.0, 60.0])
    squares = N_PIXELS * variance + lacks - variance * (2 * freedom - followed)
    trials = [Trial(Candidate(8.0, 0.0), NOWHERE, residual=float(np.sqrt(square / N_PIXELS)), n_pixels=N_PIXELS,
                    degrees_of_freedom=k) for square, k in zip(squares, freedom, strict=True)]
    noise = PairNoise(variance, 1.0)
    assert noise.of_field == pytest.approx(variance)
    failed = Trial(Candidate(4.0, 0.0), NOWHERE, failure="singular")
    *found, last = predict_errors([*trials, failed], noise, GRADIENT)
    expected = np.sqrt((lacks + variance * followed) / (N_PIXELS * GRADIENT))
    assert [trial.predicted_error for trial in found] == pytest.approx(expected.tolist())
    assert last is failed
    anchored = correct_predictions([trial if k else make_trial(8.0, 0.0, 0.2, trial.predicted_error)
                                    for k, trial in enumerate(found)], 0)
    assert anchored[0].predicted_error == pytest.approx(0.2)
    assert (anchored[2].predicted_error**2 - anchored[1].predicted_error**2
            == pytest.approx(expected[2]**2 - expected[1]**2))


def test_noise_is_what_no_unknown_follows() -> None:
    trials = [Trial(Candidate(8.0, 0.0), NOWHERE, residual=float(np.sqrt(3.0 * (1 - k / N_PIXELS) + lack)),
                    n_pixels=N_PIXELS, degrees_of_freedom=k) for k, lack in ((1000.0, 0.0), (100.0, 0.5))]
    noise = estimate_pair_noise([Trial(Candidate(4.0, 0.0), NOWHERE, failure="singular"), *trials], 0.5)
    assert noise.variance == pytest.approx(3.0)
    assert noise.camera == pytest.approx(np.sqrt(2.0))
    assert noise.of_field == pytest.approx(4.0)


def test_larger_elements_and_longer_wavelengths_win_where_errors_are_alike() -> None:
    trials = [make_trial(8, 32, 0.0100), make_trial(16, 64, 0.0101), make_trial(16, 128, 0.0102),
              make_trial(32, 128, 0.0103), make_trial(64, 0)]
    assert choose_trial(trials) == 2
    assert choose_trial(trials[:1]) == 0
    with pytest.raises(ConvergenceError, match="--lengths"):
        choose_trial([make_trial(8, 32)])


def test_recommendation_says_why_and_where_the_sweep_ends() -> None:
    inside = make_sweep(make_trial(16, 64, 0.03, 0.03), make_trial(8, 64, 0.02, 0.02), make_trial(16, 32, 0.01, 0.01),
                        make_trial(32, 128, 0.04, 0.04))
    line = inside.describe_recommendation()
    assert line.startswith("recommended: elements of 16 px, l_c = 32 px: error of 0.01 px RMS")
    assert line.endswith("the case's own settings: 0.03 px")
    assert inside.describe_case() == "[mesh.structured]\nelement_size = 16\n[regularization]\ncut_off_wavelength = 32"
    at_ends = make_sweep(make_trial(16, 64, 0.02, 0.02), make_trial(32, 128, 0.01, 0.08))
    line = at_ends.describe_recommendation()
    assert "no larger elements were tried; no longer l_c was tried" in line
    assert "in doubt: the residual of the pair predicts 0.08 px here and 0.02 px with elements of 16 px" in line


def test_without_regularization_the_case_has_no_section() -> None:
    only = make_sweep(Trial(Candidate(None, 0.0), NOWHERE, virtual_error=0.1))
    assert only.describe_case() == "# without [regularization]"
    assert only.best.candidate.describe() == "no regularization"


def test_detail_that_a_measurement_loses_comes_back_to_second_order() -> None:
    mesh = build_structured_mesh((0, 0, 20, 20), 10.0)
    specimen, transfer = np.ones((mesh.n_nodes, 2)), 0.7
    measured = transfer * specimen
    again = transfer * measured
    again[0] = np.nan
    result = Result(None, mesh, again, {}, {}, np.zeros(4, np.int64), {}, (), {}, False)  # type: ignore[arg-type]
    rougher = VirtualTruth(mesh, measured).with_lost_detail(result)
    assert rougher.displacement[1:] == pytest.approx(transfer * (2 - transfer) * specimen[1:])
    assert rougher.displacement[0].tolist() == [transfer, transfer]


def test_truth_between_nodes_is_no_finite_elements() -> None:
    mesh = build_structured_mesh((0, 0, 60, 60), 12.0)

    def curve(points: np.ndarray) -> np.ndarray:
        x, y = points.T
        return np.column_stack([0.01 * x**2 - 0.02 * x * y, 0.3 + 0.015 * y**2 + 0.1 * x])

    points = np.random.default_rng(0).uniform(12, 48, (50, 2))
    found = VirtualTruth(mesh, curve(mesh.nodes)).at(points)
    # Exact where the gradients at nodes are, which those of quadratic fields are; Q4 err by 0.01 12^2 / 4 = 0.36.
    assert found == pytest.approx(curve(points), abs=1e-9)
    missing = curve(mesh.nodes)
    missing[0] = np.nan
    corner = VirtualTruth(mesh, missing).at(np.array([[5.0, 5.0], [30.0, 30.0]]))
    assert np.isnan(corner[0]).all()
    assert np.isfinite(corner[1]).all()
