"""Spatial resolution and noise of probes, against formulas and against measurements of images that did not move."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from ddic.probes.metrology import (
    DisplacementChain,
    find_chain,
    find_displacement_resolution,
    find_strain_noise,
    find_strain_resolution,
)
from probes.conftest import MakeResult

Array = NDArray[np.float64]
FINE = DisplacementChain(0.01)
REGULARIZED = {"json": json.dumps({"regularization": {"cut_off_wavelength": 60.0}}),
               "half_amplitude_shear_px": 50.0, "half_amplitude_longitudinal_px": 80.0, "noise_floor_px": 0.02}


def test_resolution_of_probes_on_fine_elements() -> None:
    """90 % of a wave: sin(x) / x = 0.9 at x = 0.7866 for two ends, 3 (sin x - x cos x) / x^3 at 1.0187 for a plane."""
    ends = find_strain_resolution(ddic.Extensometer("e", (0, 0), (100, 0)), FINE)
    plane = find_strain_resolution(ddic.StrainGauge("g", (0, 0), 100, angle=25), FINE)
    # Roots to four digits.
    assert ends == pytest.approx(np.pi * 100 / 0.7866, rel=2e-4)
    assert plane == pytest.approx(np.pi * 100 / 1.0187, rel=2e-4)


def test_resolution_of_elements_and_of_a_cut_off_wavelength() -> None:
    point = ddic.PointProbe("p", (0, 0))
    # 1 / (1 + (half / l)^4) = 0.9 at l = 9^(1/4) half; Tikhonov's square: l = 3 half. Elements are fine beside them.
    assert find_displacement_resolution(point, DisplacementChain(0.01, 50, 80)) == pytest.approx(80 * 9**0.25, rel=1e-5)
    assert find_displacement_resolution(point, DisplacementChain(0.01, 80, 80, 2)) == pytest.approx(240, rel=1e-5)
    # The projection of a wave on linear elements leaves sinc^4(kh/2) / ((2 + cos kh) / 3): 0.936 at three elements.
    elements = DisplacementChain(10.0)
    assert elements.keep_by_elements(np.array([2 * np.pi / 30]))[0] == pytest.approx(0.9355, abs=1e-4)
    assert find_displacement_resolution(point, elements) < 30


def test_projection_on_linear_elements_leaves_what_the_formula_says() -> None:
    n_elements, n_waves, h = 60, 17, 10.0
    x = (np.arange(n_elements * 200) + 0.5) * h / 200
    nodes = np.arange(n_elements + 1) * h
    shapes = np.column_stack([np.interp(x, nodes, row) for row in np.eye(n_elements + 1)])
    periodic = np.column_stack([shapes[:, :1] + shapes[:, -1:], shapes[:, 1:-1]])
    wave = np.cos(2 * np.pi * n_waves * x / (n_elements * h))
    fitted = periodic @ np.linalg.lstsq(periodic, wave, rcond=None)[0]
    k = np.array([2 * np.pi * n_waves / (n_elements * h)])
    # 200 samples an element: the midpoint rule errs by 1e-5.
    assert fitted @ wave / (wave @ wave) == pytest.approx(DisplacementChain(h).keep_by_elements(k)[0], abs=1e-4)


def test_noise_of_a_plane_of_many_elements() -> None:
    """Nodes of white noise s fitted by a plane over L x L: 12 s^2 h^2 / L^4; fitted elements have 1/3 of it a direction
    in short waves alone, so that long gauges see the noise that pixels give: s^2 is 3 times that of long waves."""
    chain, length = DisplacementChain(1.0), 200.0
    noise = find_strain_noise(ddic.StrainGauge("g", (0, 0), length), chain)
    # Mean of 1 / ((2 + cos a) / 3) over the waves is 3 / sqrt(3) along each axis.
    long_waves = 1.0 / (3.0 / np.sqrt(3.0))**2
    # Sums over 512 waves along each axis, and the plane's steps at its edges.
    assert noise == pytest.approx(np.sqrt(12.0 * long_waves) / length**2, rel=0.02)


@pytest.fixture(scope="module")
def static_pair() -> tuple[Array, Array]:
    pair = ddic.make_synthetic_pair(np.zeros_like, (480, 480), noise=4, seed=3)
    return pair[0], pair[1]


@pytest.mark.parametrize("options", [{}, {"regularization": {"cut_off_wavelength": 60}}])
def test_predicted_noise_is_what_probes_read_on_images_that_did_not_move(
        static_pair: tuple[Array, Array], options: dict[str, dict[str, float]]) -> None:
    mesh = ddic.structured_mesh((10, 10, 470, 470), 10)
    result = ddic.measure(static_pair, mesh, **options, solver={"method": "monolithic"})
    inner = ((mesh.nodes > 60) & (mesh.nodes < 420)).all(axis=1)
    sigma = float(np.sqrt((result.displacement[inner]**2).mean()))
    probes = {"gauge 20": lambda at: ddic.StrainGauge("g", at, 20),
              "gauge 60": lambda at: ddic.StrainGauge("g", at, 60),
              "ends 40": lambda at: ddic.Extensometer("e", (at[0] - 20, at[1]), (at[0] + 20, at[1]))}
    places = np.random.default_rng(0).uniform(100, 380, (150, 2))
    for name, make in probes.items():
        read = np.concatenate([ddic.measure_probe(result, make(tuple(at))).along for at in places])
        predicted = ddic.estimate_metrology(result, make((200.0, 200.0)), noise=sigma).strain_noise
        # About 25 gauges of 60 px lie side by side: their standard deviation is known to 14 %; the rest is the model's.
        assert predicted == pytest.approx(np.sqrt((read**2).mean()), rel=0.3), name


def test_levels_come_from_fields_then_from_the_noise_floor(make_result: MakeResult) -> None:
    def rest(points: Array) -> Array:
        return np.zeros_like(points)

    point, gauge = ddic.PointProbe("p", (60.0, 60.0)), ddic.StrainGauge("g", (60.0, 60.0), 30)
    result = make_result(rest, case=REGULARIZED)
    assert find_chain(result, np.array([3])) == DisplacementChain(10.0, 50.0, 80.0)
    floor = ddic.estimate_metrology(result, point)
    assert floor.displacement_noise == pytest.approx(0.02, rel=0.01)  # sums over waves
    assert floor.displacement_indicator == pytest.approx(floor.displacement_noise * floor.displacement_resolution)
    by_gauge = ddic.estimate_metrology(result, gauge)
    of_nodes = {"sigma_u": 0.03, "sigma_v": 0.04, "sigma_exx": 1e-3, "sigma_eyy": 2e-3}
    fields = {name: np.full(result.mesh.n_nodes, value) for name, value in of_nodes.items()}
    result.point_data.update(fields)  # type: ignore[attr-defined]
    local = ddic.estimate_metrology(result, point)
    assert local.strain_noise == pytest.approx(np.sqrt(2.5e-6))
    assert local.displacement_noise == pytest.approx(np.sqrt(0.00125), rel=0.01)
    ratio = ddic.estimate_metrology(result, gauge).strain_noise / by_gauge.strain_noise
    assert ratio == pytest.approx(np.sqrt(0.00125) / 0.02)
    given = ddic.estimate_metrology(result, gauge, noise=0.01)
    assert given.strain_noise == pytest.approx(0.5 * by_gauge.strain_noise)


def test_what_is_not_recorded_is_said(make_result: MakeResult) -> None:
    gauge = ddic.StrainGauge("g", (60.0, 60.0), 30)
    silent = ddic.estimate_metrology(make_result(np.zeros_like), gauge)
    assert np.isnan(silent.strain_noise)
    assert silent.strain_resolution > 0
    assert silent.note == "the result records no noise floor"
    by_eta = {"json": json.dumps({"regularization": {"eta": 10.0}}), "noise_floor_px": 0.02}
    unknown = ddic.estimate_metrology(make_result(np.zeros_like, case=by_eta), gauge)
    assert np.isnan(unknown.strain_resolution)
    assert unknown.note == "regularized by eta: no cut-off wavelength is recorded"
