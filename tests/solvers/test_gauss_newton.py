"""Gauss-Newton on pairs whose displacement is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, is_collective
from ddic.functionals.grey_statistics import GreyState
from ddic.functionals.view import View
from ddic.images.sub_image import MaskedSource
from ddic.mesh.mesh import Mesh
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.correction_size import CorrectionSize, Tolerances
from ddic.solvers.gauss_newton import (
    PATIENCE,
    AndersonMixing,
    Correction,
    IterationRecord,
    Progress,
    Solution,
    gauss_newton,
    run_gauss_newton,
    stay_silent,
)
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_system import LocalOperator, MonolithicStep
from ddic.synth.fields import Affine, DisplacementField, Sinusoidal, Translation
from support.fields import field_of, plain_field
from support.one_subdomain import measure_alone, model_of, system_of
from support.pictures import pair_of, rms_error, source, square_mesh

MESH = square_mesh(24.0, 168.0)
STILL = Translation((0.0, 0.0))


def own_view(pair_model: ResidualModel) -> View:
    return pair_model.views[0][0]


def model(reference: MaskedSource, deformed: MaskedSource, mesh: Mesh = MESH, degree: int = 3) -> ResidualModel:
    """The whole mesh as one subdomain."""
    return model_of(reference, deformed, mesh, degree=degree)


# Without noise and rounding of grey levels there remain the bias of the cubic spline (1.4e-3 px at quarter
# shifts on this speckle) and its scatter (as much again): 2.6e-3 px RMS is what DESIGN.md measured at 16 px.
# Bilinear cells of 16 px miss a wave of 192 px and 0.5 px by up to (2 pi 16/192)^2 / 8 x 0.5 = 1.7e-2 px.
@pytest.mark.parametrize(("field", "bound"), [
    (Translation((0.3, -0.4)), 2.6e-3),
    (Affine(((0.004, 0.002), (-0.003, -0.005)), (0.2, 0.1), (96.0, 96.0)), 2.6e-3),
    (Sinusoidal((0.1, -0.2), (0.5, 0.4), (192.0, 256.0), (256.0, 192.0)), 1.7e-2),
], ids=["translation", "affine", "sinusoidal"])
def test_known_displacement(field: DisplacementField, bound: float) -> None:
    pair = pair_of(field)
    solution = measure_alone(model(source(pair.reference), source(pair.deformed)))
    assert rms_error(solution.q[0], MESH.nodes, field) <= bound
    assert len(solution.records) <= 6


def test_the_quintic_spline_is_closer() -> None:
    field = Translation((0.25, 0.25))
    pair = pair_of(field)
    bias = []
    for degree in (3, 5):
        pair_model = model(source(pair.reference), source(pair.deformed), degree=degree)
        q = measure_alone(pair_model, tolerances=Tolerances(1e-8, 1e-8)).q[0]
        bias.append(np.abs(q.reshape(-1, 2).mean(axis=0) - field.vector).max())
    # 1.4e-3 px against 2.3e-4 px at quarter shifts; the mean of 100 nodes scatters by 1e-4 px.
    assert bias[0] <= 1.8e-3
    assert bias[1] <= 4e-4


@pytest.mark.parametrize("bit_depth", [8, 32])
def test_identical_images_converge_at_once(bit_depth: int) -> None:
    image = source(pair_of(STILL, bit_depth=bit_depth).reference)
    solution = measure_alone(model(image, image))
    assert len(solution.records) == 1
    # The float32 spline returns a pixel's value to 1e-5 grey levels, gradients are tens of grey levels per px.
    assert np.abs(solution.q[0]).max() < 1e-6
    assert solution.records[0].grey.residual_std < 1e-3


def test_records_count_and_describe_the_iterations() -> None:
    pair = pair_of(Translation((0.3, -0.4)))
    told: list[IterationRecord] = []
    pair_model = model(source(pair.reference), source(pair.deformed))
    system = system_of(pair_model)
    operator = LocalOperator(system.hessian, smallest_eigenvalue=0, where="test")
    clock = PhaseClock()
    q = field_of(pair_model, [np.zeros(MESH.n_dofs)])
    solution = gauss_newton(pair_model, q, MonolithicStep(system, operator), Tolerances(),
                            Progress(clock, told.append))
    operator.destroy()
    assert told == solution.records
    assert [r.number for r in told] == list(range(1, len(told) + 1))
    assert told[0].size.relative > 1.0  # from zero, q = dq, of which only what is not affine counts below
    assert told[0].size.rms == pytest.approx(np.sqrt((0.3**2 + 0.4**2) / 2), rel=0.5)  # a first step overshoots
    assert told[-1].grey.residual_std < 0.1 * told[0].grey.residual_std
    assert told[0].grey.n_pixels == own_view(pair_model).n_pixels
    assert set(clock.wall) == {"residual", "linear step"}
    assert (q[0] == 0).all()  # the start is left alone


def test_stops_at_whichever_tolerance_comes_first() -> None:
    pair = pair_of(Translation((0.3, -0.4)))
    pair_model = model(source(pair.reference), source(pair.deformed))
    loose = measure_alone(pair_model, tolerances=Tolerances(relative=1e-30, rms=0.01)).records
    assert loose[-1].size.rms <= 0.01 < loose[-2].size.rms
    tight = measure_alone(pair_model, tolerances=Tolerances(relative=1e-5, rms=0.0)).records
    assert tight[-1].size.relative <= 1e-5 < tight[-2].size.relative


def test_too_few_iterations_raise_with_numbers_and_remedies() -> None:
    pair = pair_of(Translation((0.3, -0.4)))
    pair_model = model(source(pair.reference), source(pair.deformed))
    with pytest.raises(ConvergenceError, match=r"did not converge in 1 iterations \(last \|dq\|/\|q\| = .*, "
                                               r"RMS dq = .* px, largest dq = .* px in subdomain 0, residual .* grey "
                                               r"levels\).*"
                                               r"gauss_newton\.max_iterations") as caught:
        measure_alone(pair_model, tolerances=Tolerances(max_iterations=1))
    assert is_collective(caught.value)
    # The field after the one correction, which a run that may take more has after its first as well.
    last = caught.value.last
    assert [record.number for record in last.records] == [1]
    assert np.abs(last.q[0].reshape(-1, 2).mean(axis=0) - (0.3, -0.4)).max() < 0.2


class _Broken:
    """A linear step whose solution is not finite."""

    def __init__(self, value: float) -> None:
        self._value = value

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        return StepResult(q.with_parts(np.full_like(q_s, self._value) for q_s in q))

    def destroy(self) -> None:
        pass


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_correction_that_is_not_finite_is_divergence(value: float) -> None:
    image = source(pair_of(STILL).reference)
    pair_model = model(image, image)
    with pytest.raises(ConvergenceError, match="diverged: the correction is not finite") as caught:
        gauss_newton(pair_model, field_of(pair_model, [np.zeros(MESH.n_dofs)]), _Broken(value), Tolerances(),
                     Progress(PhaseClock()))
    assert is_collective(caught.value)
    # The last unknowns that are numbers: those of the start.
    assert (caught.value.last.q[0] == 0).all()
    assert len(caught.value.last.records) == 1


def test_the_window_grows_with_the_displacement() -> None:
    # 30 px is far beyond the margin that is read around the mesh at first.
    field = Translation((-30.0, 30.0))
    pair = pair_of(field, side=256)
    mesh = square_mesh(64.0, 160.0)
    pair_model = model(source(pair.reference), source(pair.deformed), mesh)
    frame_view = pair_model.views[0][0]
    frame_view.deformed.get_spline(frame_view.correlation.raster.window)  # the window of a start at zero
    near = np.tile([-29.5, 30.5], mesh.n_nodes)
    solution = measure_alone(pair_model, q=near)
    assert rms_error(solution.q[0], mesh.nodes, field) <= 2e-3
    assert solution.records[-1].grey.n_pixels == own_view(pair_model).n_pixels


def test_float32_images_cost_no_accuracy() -> None:
    """Half a unit in the last place of every pixel moves the field far less than its interpolation errs."""
    field = Sinusoidal((0.1, -0.2), (0.5, 0.4), (192.0, 256.0), (256.0, 192.0))
    pair = pair_of(field)
    rng = np.random.default_rng(0)
    exactly = Tolerances(relative=1e-12, rms=1e-11, max_iterations=60)
    fields = []
    for size in (0.0, 2.0**-24):
        f, g = (image.astype(np.float64) * (1 + size * rng.uniform(-1, 1, image.shape))
                for image in (pair.reference, pair.deformed))
        fields.append(measure_alone(model(source(f), source(g)), tolerances=exactly).q[0])
    # 4e-8 px measured; the cubic spline's bias is 1.4e-3 px.
    assert np.sqrt(np.mean((fields[1] - fields[0]) ** 2)) <= 1.5e-7


class _Made:
    """A model whose corrections have given sizes, as if each step were solved."""

    def __init__(self, sizes: Callable[[int], float]) -> None:
        self.team = Team.alone()
        self._sizes = sizes
        self.n_asked = 0

    def linearize(self, q: Field) -> tuple[Field, tuple[GreyState, ...]]:
        return q.with_parts(np.zeros_like(q_s) for q_s in q), (GreyState(1.0, 1.0, 100, 1.0, 0.0),)

    def measure_correction(self, dq: Field, q: Field, tolerances: Tolerances) -> CorrectionSize:
        size = self._sizes(self.n_asked)
        self.n_asked += 1
        return CorrectionSize(size, size, size, 0, size, int(size > tolerances.largest))


def run_made(sizes: Callable[[int], float], most: int = 2000) -> Solution:
    made = _Made(sizes)
    tolerances = Tolerances(relative=1e-12, rms=1e-6, max_iterations=most, inexact=False)
    solution = run_gauss_newton(made, plain_field(np.zeros(2)), _Broken(0.0), tolerances, Progress(PhaseClock()))
    assert made.n_asked == len(solution.records)
    return solution


def test_what_never_converges_is_given_up_after_patience() -> None:
    # Eight iterations of a digit each three, then nothing more.
    solution = run_made(lambda k: max(0.5**k, 0.5**8))
    assert not solution.converged
    # The ninth is the smallest so far, and as many more must do better than it: by a fifth.
    assert len(solution.records) == 9 + PATIENCE
    assert "stagnates after 29 iterations" in solution.stop
    # One that wanders up and down is the same.
    random = np.random.default_rng(0)
    wandering = run_made(lambda k: 1e-2 * random.uniform(0.9, 1.1))
    assert not wandering.converged
    assert len(wandering.records) <= 3 * PATIENCE


@pytest.mark.parametrize("gained", [0.025, 0.1, 0.5])
def test_what_converges_slowly_is_not_given_up(gained: float) -> None:
    solution = run_made(lambda k: (1 - gained)**k)
    assert solution.converged
    assert len(solution.records) == int(np.ceil(np.log(1e-6) / np.log(1 - gained))) + 1


def test_what_gains_less_than_a_fifth_in_that_many_is_given_up() -> None:
    # 1 % an iteration: 18 % in 20.
    solution = run_made(lambda k: 0.99**k)
    assert not solution.converged
    assert len(solution.records) == PATIENCE + 1


def test_a_few_growing_corrections_are_borne() -> None:
    # A start that is far off: corrections grow tenfold before they fall.
    solution = run_made(lambda k: 0.1 * 1.3**k if k < 10 else 1.3**10 * 0.1 * 0.3**(k - 10))
    assert solution.converged


class _Linear:
    """A model whose b is A (q* - q), and a step that takes all of b for dq: A has a few eigenvalues far from 1."""

    def __init__(self) -> None:
        self.team = Team.alone()
        self.solution = np.random.default_rng(4).normal(size=30)
        self.shares = np.ones(30)
        self.shares[:3] = 0.1, 0.25, 1.6
        self.n_passes = 0

    def linearize(self, q: Field) -> tuple[Field, tuple[GreyState, ...]]:
        self.n_passes += 1
        return q.with_parts([self.shares * (self.solution - q[0])]), (GreyState(1.0, 1.0, 100, 1.0, 0.0),)

    def measure_correction(self, dq: Field, q: Field, tolerances: Tolerances) -> CorrectionSize:
        size = float(np.sqrt((dq[0]**2).mean()))
        return CorrectionSize(size, size, size, 0, size, int(size > tolerances.largest))

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        return StepResult(b, 0, np.zeros(1), 0.0)

    def destroy(self) -> None:
        pass


EXACTLY = Tolerances(relative=1e-30, rms=1e-8, max_iterations=300)


def run_linear(q: NDArray[np.float64], pause: Callable[[Correction], bool] | None = None, n_before: int = 0,
               mixing: AndersonMixing | None = None, tolerances: Tolerances = EXACTLY) -> Solution:
    made = _Linear()
    progress = Progress(PhaseClock(), stay_silent, n_before)
    return run_gauss_newton(made, plain_field(q), made, tolerances, progress, pause, mixing)


def test_a_pause_ends_after_the_correction_that_asks_for_it() -> None:
    asked: list[float] = []

    def pause(correction: Correction) -> bool:
        asked.append(correction.size.rms)
        return correction.size.rms < 0.05

    paused = run_linear(np.zeros(30), pause)
    assert not paused.converged
    assert paused.paused is not None
    # It is asked after every correction but the last one of all, and tells of that which was made.
    assert asked == [record.size.rms for record in paused.records]
    assert asked[-1] < 0.05 <= min(asked[:-1])
    last = paused.paused
    np.testing.assert_array_equal(paused.q[0], last.q[0] + last.dq[0])
    np.testing.assert_array_equal(last.b[0], _Linear().shares * (_Linear().solution - last.q[0]))
    assert last.size.rms == asked[-1]
    # From there on it goes as if it had not paused.
    went_on = run_linear(paused.q[0], None, len(paused.records))
    at_once = run_linear(np.zeros(30))
    assert went_on.converged
    assert went_on.paused is None
    np.testing.assert_array_equal(went_on.q[0], at_once.q[0])
    numbers = [record.number for record in (*paused.records, *went_on.records)]
    assert numbers == [record.number for record in at_once.records]


def test_nothing_pauses_after_a_correction_that_is_small_enough() -> None:
    found = run_linear(_Linear().solution, lambda correction: True)
    assert found.converged
    assert found.paused is None
    assert len(found.records) == 1


def test_mixing_finds_the_same_in_fewer_passes() -> None:
    plain = run_linear(np.zeros(30))
    mixed = run_linear(np.zeros(30), mixing=AndersonMixing([np.ones(30)]))
    # 10 % an iteration takes 22 a digit; three slow directions are known after four corrections.
    assert len(plain.records) > 100
    assert len(mixed.records) <= 7
    assert mixed.converged
    np.testing.assert_allclose(mixed.q[0], _Linear().solution, atol=1e-7)


def test_the_last_correction_is_not_mixed() -> None:
    # What is small enough is added as it is: the field is that of the last pass and its linear step.
    found = run_linear(np.zeros(30), mixing=AndersonMixing([np.ones(30)]))
    made = _Linear()
    before_last = run_linear(np.zeros(30), mixing=AndersonMixing([np.ones(30)]),
                             tolerances=Tolerances(relative=1e-30, rms=1e-30, max_iterations=len(found.records) - 1))
    q = before_last.q[0]
    np.testing.assert_array_equal(found.q[0], q + made.shares * (made.solution - q))


def test_too_few_iterations_are_no_stagnation() -> None:
    solution = run_made(lambda k: 0.9**k, most=5)
    assert not solution.converged
    assert "did not converge in 5 iterations" in solution.stop
