"""Standard deviations in a result, against those of repeated measurements, and what a case may ask for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import ddic
from ddic.errors import ConvergenceError, InputError, as_collective
from ddic.methods.run import run_case
from ddic.parallel.team import Team
from support.cases import Ears, write_case, write_images
from support.small_pair import SIZE, move

SIGMA = 2.0
ON = {"output": {"uncertainty": True}}
NAMES = ("sigma_u", "sigma_v", "sigma_exx", "sigma_eyy", "sigma_exy")
CELL_NAMES = ("cell_sigma_exx", "cell_sigma_eyy", "cell_sigma_exy")
MESH = ddic.structured_mesh((10, 10, 150, 130), 20)
REGULARIZED = {"regularization": {"cut_off_wavelength": 80}}


def _clean() -> list[NDArray[np.float32]]:
    return [image.astype(np.float32) for image in ddic.make_synthetic_pair(move, SIZE)]


def _add_noise(images: list[NDArray[np.float32]], random: np.random.Generator) -> list[NDArray[np.float32]]:
    return [image + (SIGMA * random.standard_normal(image.shape)).astype(np.float32) for image in images]


def _measure(pair: list[NDArray[Any]], options: dict[str, Any] | None = None) -> ddic.Result:
    return ddic.measure(pair, MESH, **(options or {}))


@pytest.mark.parametrize("regularization", [{}, REGULARIZED], ids=["free", "regularized"])
def test_they_are_those_of_repeated_measurements(regularization: dict[str, Any]) -> None:
    clean, random = _clean(), np.random.default_rng(7)
    found = _measure(_add_noise(clean, random), {**regularization, **ON})
    repeated = [_measure(_add_noise(clean, random), regularization) for _ in range(40)]
    by_u = np.std([r.displacement for r in repeated], axis=0, ddof=1)
    by_strain = np.std([r.point_data["nodal_strain_infinitesimal"][:, [0, 1, 3]] for r in repeated], axis=0, ddof=1)
    in_cells = np.std([r.cell_data["strain_infinitesimal"][:, [0, 1, 3]] for r in repeated], axis=0, ddof=1)
    for names, data, expected in ((NAMES[:2], found.point_data, by_u), (NAMES[2:], found.point_data, by_strain),
                                  (CELL_NAMES, found.cell_data, in_cells)):
        sigma = np.stack([data[name] for name in names], axis=1)
        # 39 degrees of freedom at each of 42 to 56 places with two or three components, neighbours together: 3 %; the
        # noise itself is estimated from one residual, 1 to 2 %.
        assert np.sqrt((sigma**2).mean() / (expected**2).mean()) == pytest.approx(1.0, abs=0.1)
    attributes = found.attributes["uncertainty"]
    assert attributes["noise_grey"] == pytest.approx(SIGMA, rel=0.05)
    assert attributes["noise_origin"] == "estimated from the residual"


def test_given_noise_and_pictures_at_rest_come_before_the_residual(tmp_path: Path) -> None:
    clean, random = _clean(), np.random.default_rng(7)
    pair = _add_noise(clean, random)
    # One that the camera would have taken before: rounded to whole grey levels.
    at_rest = np.clip(np.rint(_add_noise(clean, random)[0]), 0, 255).astype(np.uint8)
    tifffile.imwrite(tmp_path / "rest.tif", at_rest)
    by_rest = _measure(pair, {**ON, "images": {"at_rest": str(tmp_path / "rest.tif")}})
    of_rest = by_rest.attributes["uncertainty"]
    assert of_rest["noise_origin"] == "of the images at rest"
    # 16 blocks of 32 px, some of which speckle saturates.
    assert of_rest["noise_grey"] == pytest.approx(SIGMA, rel=0.06)
    given = _measure(pair, {**ON, "images": {"at_rest": str(tmp_path / "rest.tif"), "noise": 3.0}})
    assert given.attributes["uncertainty"]["noise_grey"] == 3.0
    # Standard deviations are as large as the noise, whatever its origin; steps are solved alike but for rounding.
    ratio = 3.0 / of_rest["noise_grey"]
    np.testing.assert_allclose(given.point_data["sigma_u"], ratio * by_rest.point_data["sigma_u"], rtol=1e-6)


def test_the_bias_is_what_regularization_smooths_away() -> None:
    def bend(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([0.3 * np.sin(points[:, 1] / 12.0), np.zeros(len(points))])

    clean = [image.astype(np.float32) for image in ddic.make_synthetic_pair(bend, SIZE)]
    found = _measure(clean, {**REGULARIZED, **ON})
    free = _measure(clean)
    error = (found.displacement - free.displacement)[:, 0]
    estimated = found.point_data["regularization_bias"][:, 0]
    # Guards the test: there is a bias. Its estimate has lost what is smoothed away, about as much again.
    assert np.sqrt((error**2).mean()) > 0.02
    assert np.corrcoef(error, estimated)[0, 1] > 0.8
    assert 0.2 < (error @ estimated) / (error @ error) < 1.0
    assert "regularization_bias" not in _measure(clean, ON).point_data


def test_it_is_left_out_unless_it_is_asked_for() -> None:
    result = _measure(_clean())
    assert not set(NAMES + CELL_NAMES) & set(result.fields)
    assert "uncertainty" not in result.attributes


def test_products_of_functions_have_none() -> None:
    options = {"pgd": {}, "mesh": {"structured": {"region": [10, 10, 150, 130], "element_size": 4}}, **ON}
    with pytest.raises(InputError, match=r"output\.uncertainty does not go with \[pgd\]"):
        ddic.measure(_clean(), **options)


def test_a_step_that_fails_for_them_does_not_lose_the_field(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise as_collective(ConvergenceError("the linear step does not converge"))

    monkeypatch.setattr("ddic.results.field_uncertainty.estimate_field_uncertainty", fail)
    write_images(tmp_path)
    case = write_case(tmp_path, "[output]\nuncertainty = true\n")
    ears = Ears()
    summary = run_case(Team.alone(), case, ears)
    assert summary.converged
    assert any("no standard deviations were estimated" in note for note in ears.notes)
    assert "sigma_u" not in ddic.open(tmp_path / "result.vtkhdf").fields
