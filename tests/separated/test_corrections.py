"""Corrections to the end: known displacements, Q4's field, noise, failures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import ddic
from ddic.errors import ConvergenceError
from ddic.functionals.regularization import Material, find_cut_off_weight, find_edge_weight
from ddic.images.sub_image import DeformedSubImage
from ddic.separated.corrections import (
    OF_GAP,
    CorrectionRecord,
    Regularization,
    Scheme,
    SeparatedSolution,
    StoppingRules,
    correct_displacement,
    estimate_noise_gain,
)
from ddic.separated.pixel_bands import FramePixels
from ddic.separated.rank_one import build_directions, find_rank_one
from ddic.separated.separated_regularization import (
    build_no_operator,
    build_plane_waves,
    measure_wave_gaps,
    measure_wave_textures,
)
from ddic.synth.fields import Translation
from support.cases import WAVES
from support.pictures import pair_of, source
from support.separated import build_zero_field, frame_of, lines, reference_of, weighted_gap

REGION = (24.0, 24.0, 168.0, 168.0)
EXACT = StoppingRules(tolerance=1e-10, rms_tolerance=1e-9, max_corrections=400, stops_at_noise=False)
COMPLETE = {"gauss_newton": {"tolerance": 1e-9, "rms_tolerance": 0, "largest_tolerance": 1e-8},
            "solver": {"method": "assembled"}}
EDGE_WAVELENGTH = 16.0
"""Default of the case file, pixels."""
POINTS = np.random.default_rng(0).uniform(24, 168, (3000, 2))


def _ignore(record: CorrectionRecord) -> None:
    pass


def _correct(frame: FramePixels, *, scheme: Scheme = Scheme(), rules: StoppingRules = StoppingRules(),  # noqa: B008
             regularization: Regularization | None = None,
             note: Callable[[CorrectionRecord], None] = _ignore) -> SeparatedSolution:
    start = build_zero_field(frame.reference.along_x, frame.reference.along_y)
    return correct_displacement(frame, start, regularization, scheme, rules, note)


def _weigh(frame: FramePixels, wavelength: float) -> Regularization:
    x, y = frame.reference.along_x, frame.reference.along_y
    waves = build_plane_waves(x, y, wavelength)
    weight = find_cut_off_weight(measure_wave_textures(x, y, waves, frame.reference.sum_texture),
                                 measure_wave_gaps(x, y, Material(), waves))
    of_edges = find_edge_weight(weight, (wavelength, weight), EDGE_WAVELENGTH)
    return Regularization(weighted_gap(x, y, weight, of_edges), weight, OF_GAP / wavelength)


@pytest.mark.parametrize("update", [False, True])
@pytest.mark.parametrize("wavelength", [None, 80.0])
def test_complete_sum_is_the_field_of_q4_elements(update: bool, wavelength: float | None) -> None:
    frame = frame_of(WAVES, REGION, 24.0)
    regularization = None if wavelength is None else _weigh(frame, wavelength)
    solution = _correct(frame, scheme=Scheme(update=update), rules=EXACT, regularization=regularization)
    pair = pair_of(WAVES)
    settings = {**COMPLETE, **({} if wavelength is None else {"regularization": {"cut_off_wavelength": wavelength}})}
    q4 = ddic.measure((pair.reference, pair.deformed), ddic.structured_mesh(REGION, 24), **settings)
    if regularization is not None:
        assert regularization.weight == pytest.approx(q4.attributes["case"]["eta"], rel=1e-12)
    # Residuals are stored as float32; without update, what small corrections leave adds up.
    assert np.abs(solution.field.at(POINTS) - q4.at(POINTS)).max() <= (1e-7 if update else 1e-6)


def test_update_takes_fewer_corrections() -> None:
    counts = [len(_correct(frame_of(WAVES, REGION, 24.0), scheme=Scheme(update=update), rules=EXACT).records)
              for update in (False, True)]
    assert counts[1] <= counts[0] / 2


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("update", [False, True])
def test_known_displacement_is_found(update: bool, degree: int) -> None:
    solution = _correct(frame_of(WAVES, REGION, 16.0, degree=degree), scheme=Scheme(update=update))
    error = solution.field.at(POINTS) - WAVES.displacement(POINTS)
    # Waves of 256 px on bilinear elements of 16 px: 0.5 (2 pi / 256)^2 16^2 / 8 = 0.01 px at most, a third of it RMS.
    assert np.sqrt((error**2).mean()) <= 4e-3
    assert len(solution.records) <= 12


def test_translation_is_not_what_corrections_are_compared_with() -> None:
    shift = Translation((0.37, -0.21))
    solution = _correct(frame_of(shift, REGION, 48.0))
    assert np.abs(solution.field.at(POINTS) - shift.displacement(POINTS)).max() <= 5e-3
    # Without its mean the displacement is what is wrong with it: a small part of a large translation is no small
    # correction.
    last = solution.records[-1]
    assert all(a > 5 * b for a, b in zip(last.fluctuation, last.relative, strict=True))


def test_records_say_what_happened() -> None:
    told: list[CorrectionRecord] = []
    solution = _correct(frame_of(WAVES, REGION, 16.0), note=told.append)
    assert told == solution.records
    assert [record.number for record in told] == list(range(1, len(told) + 1))
    assert all(record.gain > record.noise_gain > 0 for record in told)
    residual = [record.grey.residual_std for record in told]
    assert residual == sorted(residual, reverse=True)
    assert solution.grey.residual_std < residual[-1]
    assert told[0].relative == pytest.approx((1.0, 1.0))
    sizes = solution.field.measure_rms()
    # Both components together, over the displacement with the correction: the last is nearly that.
    assert told[-1].eta == pytest.approx(np.linalg.norm(told[-1].rms) / np.linalg.norm(sizes), rel=1e-3)
    assert all(min(r.relative) <= r.eta <= max(r.relative) for r in told)
    assert all(r.stagnation <= Scheme().stagnation or r.n_sweeps == Scheme().max_sweeps for r in told)


def test_one_sweep_has_nothing_to_stagnate() -> None:
    solution = _correct(frame_of(WAVES, REGION, 48.0), scheme=Scheme(max_sweeps=1))
    assert np.isnan([r.stagnation for r in solution.records]).all()


def _noisy(sigma: float, seed: int, element: float) -> FramePixels:
    pair, random = pair_of(WAVES), np.random.default_rng(seed)
    f, g = (image + sigma * random.standard_normal(image.shape) for image in (pair.reference, pair.deformed))
    return FramePixels(reference_of(f, REGION, element), DeformedSubImage(source(g), 3))


def test_corrections_end_at_noise_and_leave_less_of_it() -> None:
    errors = []
    for stops in (True, False):
        rules = StoppingRules(stops_at_noise=stops)
        solution = _correct(_noisy(4.0, 0, 8.0), rules=rules)
        errors.append(np.sqrt(((solution.field.at(POINTS) - WAVES.displacement(POINTS))**2).mean()))
        assert solution.stop.startswith("noise" if stops else "converged")
    # All modes have the noise of Q4 elements of 8 px, 0.07 px; the first ones a part of it.
    assert errors[0] < 0.6 * errors[1]


@pytest.mark.parametrize(("element", "wavelength"), [(32.0, None), (8.0, None), (2.0, None), (8.0, 32.0), (2.0, 64.0)])
def test_noise_gain_is_what_noise_gains(element: float, wavelength: float | None) -> None:
    pair, gains = pair_of(Translation((0.0, 0.0))), []
    for seed in range(3):
        random = np.random.default_rng(seed)
        f, g = (image + 2.0 * random.standard_normal(image.shape) for image in (pair.reference, pair.deformed))
        frame = FramePixels(reference_of(f, REGION, element), DeformedSubImage(source(g), 3))
        zero = build_zero_field(*lines(REGION, element))
        sums = frame.evaluate(zero)
        operator = build_no_operator(zero.along_x, zero.along_y)
        if wavelength is not None:
            operator = _weigh(frame, wavelength).operator
        mode = find_rank_one(frame, build_directions(frame, operator, zero), 6, 0.05)
        density = None if wavelength is None else OF_GAP / wavelength
        rms = float(np.sqrt(sums.values[3] / sums.n_pixels))
        gains.append(mode.gain / estimate_noise_gain(*lines(REGION, element), density, rms))
    # 0.55 to 0.95 were seen, least where there are fewest functions: five a side.
    assert 0.45 <= np.mean(gains) <= 1.05


def test_images_that_do_not_match_are_no_noise() -> None:
    pair, other = pair_of(WAVES), np.random.default_rng(0).uniform(0, 255, (192, 192))
    frame = FramePixels(reference_of(pair.reference, REGION, 16.0), DeformedSubImage(source(other), 3))
    with pytest.raises(ConvergenceError, match="the start is too far off"):
        _correct(frame)


def test_too_few_corrections_are_a_failure() -> None:
    with pytest.raises(ConvergenceError, match=r"after 2 corrections the last one is .* px along x"):
        _correct(frame_of(WAVES, REGION, 16.0), rules=StoppingRules(max_corrections=2))


def test_brightness_is_corrected() -> None:
    pair = pair_of(WAVES)
    deformed = 0.8 * pair.deformed + 30.0
    frame = FramePixels(reference_of(pair.reference, REGION, 16.0), DeformedSubImage(source(deformed), 3))
    rules = StoppingRules(tolerance=1e-5, stops_at_noise=False)
    plain = _correct(frame_of(WAVES, REGION, 16.0), rules=rules)
    corrected = _correct(frame, scheme=Scheme(correction="global"), rules=rules)
    assert corrected.grey.gain == pytest.approx(1 / 0.8, rel=1e-3)
    assert corrected.grey.offset == pytest.approx(-30.0 / 0.8, rel=1e-2)
    # The gain that is fitted to other residuals differs by 1e-4.
    assert np.abs(corrected.field.at(POINTS) - plain.field.at(POINTS)).max() <= 2e-3


def test_masked_rectangle_is_measured_around_the_mask() -> None:
    mask = np.ones((192, 192), bool)
    mask[80:120, 70:110] = False
    solution = _correct(frame_of(WAVES, REGION, 16.0, mask=mask))
    x, y = POINTS.T
    seen = ~((x > 60) & (x < 120) & (y > 70) & (y < 130))
    error = (solution.field.at(POINTS) - WAVES.displacement(POINTS))[seen]
    assert np.sqrt((error**2).mean()) <= 5e-3
    assert solution.grey.n_pixels < 144 * 144 - 1600
