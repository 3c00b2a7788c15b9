"""Element sizes and cut-off wavelengths compared on the pair and on virtual images made from it.

A candidate is one element size and one cut-off wavelength: prepared, and measured with. Virtual images are made on rank
0 from the reference image, measured on all ranks; their truth is a measured field, roughened.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.arrays import Array
from ddic.case.schema import Case, RegularizationSection
from ddic.errors import ConvergenceError, DdicError, require_collective
from ddic.functionals.noise_transfer import build_white_transfer
from ddic.functionals.regularization import Material
from ddic.functionals.texture import measure_gap
from ddic.images.binned import ArraySource
from ddic.images.rigid import fill_absent
from ddic.images.sub_image import MaskedSource, read_reference
from ddic.images.volume import find_slopes
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.io.result_reader import Result
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Mesh
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.region_mesh import build_material
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Silence
from ddic.results.measurement import Measurement
from ddic.results.publishing import gather
from ddic.results.sweep import (
    Candidate,
    Sweep,
    Trial,
    choose_trial,
    correct_predictions,
    estimate_pair_noise,
    predict_errors,
)
from ddic.solvers.probing import estimate_degrees_of_freedom, estimate_response
from ddic.start.given_start import EarlierResult, keep_displacement

T = TypeVar("T")


ELEMENT_FACTORS = (0.5, 2**-0.5, 1.0, 2**0.5, 2.0)
"""Element sizes that are tried, over that of the case."""

WAVELENGTH_FACTORS = tuple(2 ** (k / 2) for k in range(-4, 5))
"""Cut-off wavelengths that are tried, over that of the case."""

ELEMENTS_A_WAVELENGTH = 5.0
"""Elements in the cut-off wavelength about which a case without one is tried."""

_DIGITS = 3
"""Of the sizes that are tried: they are written into case files."""


def set_resolution(case: Case, element_size: float | None, wavelength: float) -> Case:
    """Put another element size and cut-off wavelength l_c, pixels, into a case, and ask for no residual image.

    All else stays. An ``element_size`` of None keeps the mesh, a ``wavelength`` of 0 leaves the regularization out. The
    case is not validated again.
    """
    section = case.regularization
    if wavelength and section is not None:
        section = section.model_copy(update={"cut_off_wavelength": wavelength, "eta": None})
    elif wavelength:
        section = RegularizationSection(cut_off_wavelength=wavelength)
    else:
        section = None
    mesh = case.mesh
    if element_size is not None and mesh.structured is not None:
        structured = mesh.structured.model_copy(update={"element_size": element_size})
        mesh = mesh.model_copy(update={"structured": structured})
    output = case.output.model_copy(update={"residual_image": False})
    return case.model_copy(update={"mesh": mesh, "regularization": section, "output": output})


def list_element_sizes(case: Case) -> list[float | None]:
    """List element sizes about that of a case, pixels, its own first; None alone without [mesh.structured]."""
    if case.mesh.structured is None:
        return [None]
    own = case.mesh.structured.element_size
    low, high = np.reshape(case.mesh.structured.box, (2, -1))
    sizes = [_round(own * factor) for factor in ELEMENT_FACTORS]
    return [own, *(size for size in sizes if size != own and size <= (high - low).min())]


def list_wavelengths(case: Case, typical_size: float) -> list[float]:
    """List cut-off wavelengths about that of a case, pixels, its own first, and 0 for no regularization.

    ``typical_size`` is that of its elements, pixels.
    """
    section = case.regularization
    own = None if section is None else section.cut_off_wavelength
    middle = ELEMENTS_A_WAVELENGTH * typical_size if own is None else own
    others = [0.0, *(_round(middle * factor) for factor in WAVELENGTH_FACTORS)]
    return list(dict.fromkeys([*([] if own is None else [own]), *others]))


def _round(size: float) -> float:
    return float(f"{size:.{_DIGITS}g}")


class _CandidateSession:
    """A candidate, prepared at its first measurement; what is made then is kept if it ``stays_open``."""

    def __init__(self, team: Team, candidate: Candidate, inputs: Inputs, *, stays_open: bool) -> None:
        self.candidate, self._team, self._inputs, self._stays_open = candidate, team, inputs, stays_open
        self._session: DecomposedSession | None = None

    def measure_pair(self, frame: Frame, start: EarlierResult | None) -> tuple[Trial, Result | None]:
        """Measure the pair of the case; collective.

        ``start`` is a displacement to start from; None: it is searched for. Where nothing was measured the reason is in
        the trial: one candidate that fails ends no sweep.
        """
        found = self._measure(frame, start, lambda problem, measured: _collect_trial(self.candidate, problem, measured))
        return (Trial(self.candidate, NOWHERE, failure=found), None) if isinstance(found, str) else found

    def measure_virtual(self, frame: Frame, start: EarlierResult) -> Result | None:
        """Measure a virtual image from a start; collective. The field is on every rank, None where there is none."""
        found = self._measure(frame, start, lambda _, measured: gather(measured))
        return None if isinstance(found, str) else found

    def _measure(self, frame: Frame, start: EarlierResult | None,
                 take: Callable[[WeightedProblem, Measurement], T]) -> T | str:
        """What is taken of a measurement, or why there is none."""
        try:
            if self._session is None:
                clock = PhaseClock(waiting=self._team.waiting)
                self._session = DecomposedSession(self._team, self._inputs, Silence(), clock)
            return take(self._session.problem, self._session.measure(frame, start))
        except DdicError as error:
            require_collective(error)
            self.close()
            return str(error)
        finally:
            if not self._stays_open:
                self.close()

    def close(self) -> None:
        """Free the factors."""
        if self._session is not None:
            self._session.close()
        self._session = None


N_POINTS = 20_000
"""Places at which errors are taken: with some thousand independent ones among them a few per cent of each error, alike
for all candidates."""

LEAST_MEASURED = 0.95
"""Share of the places at which a candidate must measure: without those that are hardest it would look better."""

NOWHERE = np.zeros((0, 2))


def _collect_trial(candidate: Candidate, problem: WeightedProblem, measurement: Measurement) -> tuple[Trial, Result]:
    """Judge what a candidate measured of the pair by residual, degrees of freedom and noise; collective.

    The field comes with the trial, both on every rank. The problem is of one camera, the measurement the last one with
    it. Raises ConvergenceError on all ranks where a linear step does not converge.
    """
    team, state = problem.team, measurement.evaluation.grey[0]
    systems, step = problem.solver.assembly.systems, problem.solver.step
    freedom = estimate_degrees_of_freedom(team, systems, step)
    counted = [~is_unmeasured for is_unmeasured in measurement.unmeasured]
    noise = state.residual_std / np.sqrt(2.0) * estimate_response(team, systems, step, counted).rms_per_grey
    result = gather(measurement)
    # A gain and an offset of each element follow noise as well.
    n_grey = 2 * result.mesh.n_cells if measurement.grey_correction == "element" else 0
    return Trial(candidate, NOWHERE, state.residual_rms, state.n_pixels, degrees_of_freedom=freedom + n_grey,
                 noise=noise), result


def _draw_points(trials: Sequence[Trial], fields: Sequence[Result | None]) -> Array:
    """Draw places all over the mesh of the first field that was measured, the same at every call.

    Places are (n_points, 2), pixels. Raises ConvergenceError where no candidate measured anything.
    """
    result = next((field for field in fields if field is not None), None)
    if result is None:
        raise ConvergenceError(f"nothing that the sweep tries measures the pair: {trials[0].failure}")
    low, high = result.mesh.nodes.min(axis=0), result.mesh.nodes.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (N_POINTS, len(low)))
    return np.asarray(points[np.isfinite(result.at(points)).all(axis=1)])


def _evaluate_pair(trial: Trial, field: Result | None, points: Array, material: Material) -> Trial:
    """Add what a candidate measured of the pair at points, (n_points, 2), pixels, and its forces out of equilibrium."""
    if field is None:
        return replace(trial, displacement=np.full(points.shape, np.nan))
    return replace(trial, displacement=field.at(points), gap=measure_gap(field.mesh, field.displacement, material))


def _evaluate_virtual(trial: Trial, result: Result | None, truth: VirtualTruth, points: Array) -> Trial:
    """Compare what a candidate measured of the virtual images with the truth at points, (n_points, 2), pixels.

    The trial gains its RMS error of a component, or why there is none; ``result`` is None where it could not be
    measured.
    """
    if result is None:
        return replace(trial, failure="the virtual images could not be measured")
    error = result.at(points) - truth.at(points)
    is_measured = np.isfinite(error).all(axis=1)
    if is_measured.mean() < LEAST_MEASURED:
        return replace(trial, failure=f"of the virtual images only {100 * is_measured.mean():.0f} % could be measured")
    return replace(trial, virtual_error=float(np.sqrt((error[is_measured] ** 2).mean())))


@dataclass(frozen=True, eq=False)
class VirtualTruth:
    """A displacement that virtual images have.

    Between nodes it is no finite element's: sum_i N_i (u_i + G_i (x - x_i) / 2), G_i the gradients at nodes, which is
    exact where the displacement is quadratic. Else the elements of its own mesh would hold it better than any specimen.

    Attributes
    ----------
    mesh : Mesh
        On which it was measured, pixels.
    displacement : (n_nodes, dim) array
        Of its nodes, pixels; nan where nothing was measured.
    """

    mesh: Mesh
    displacement: Array

    def at(self, points: Array) -> Array:
        """Interpolate it at points, (n, dim), pixels; nan where there is none."""
        found, dim = interpolate(self.mesh, self._columns, points), self.mesh.dim
        gradient = found[:, dim:].reshape(-1, dim, dim)
        return np.asarray(found[:, :dim] + 0.5 * np.einsum("ncj,nj->nc", gradient, points))

    @cached_property
    def _columns(self) -> Array:
        """u_i - G_i x_i / 2 and G_i of the nodes, (n_nodes, dim + dim^2)."""
        (gradient,) = recover_gradients([self.mesh], [self.displacement.ravel()], list)
        gradient = np.where(np.isfinite(gradient), gradient, 0.0)
        linear = 0.5 * np.einsum("ncj,nj->nc", gradient, self.mesh.nodes)
        return np.column_stack([self.displacement - linear, gradient.reshape(len(gradient), -1)])

    def with_lost_detail(self, again: Result) -> VirtualTruth:
        """Add what measuring it once more takes off: 2 u - S u.

        The measurement S leaves a wave a share t of its amplitude; the measured wave, t times the specimen's, becomes t
        (2 - t) times. What noise has put in is raised by at most as much. ``again`` is what the same settings measure
        of an image without noise that has this displacement.
        """
        rougher = 2.0 * self.displacement - again.displacement
        # Where it was not measured again it stays as it is.
        return VirtualTruth(self.mesh, np.where(np.isfinite(rougher), rougher, self.displacement))

    def render(self, grey: Array, noise: float) -> NDArray[np.float32]:
        """Render the deformed image of ``grey``, a whole image, with noise of a standard deviation; grey levels."""
        displacement = np.empty((*grey.shape, grey.ndim))
        for rows in _split_rows(grey.shape):
            points = _list_points(rows, *map(range, grey.shape[1:]))
            displacement[rows.start:rows.stop] = self.at(points.reshape(grey.ndim, -1).T).reshape(*points.shape[1:], -1)
        image = render_virtual_image(grey, fill_absent(displacement))
        random = np.random.default_rng(0)
        image += np.float32(noise) * random.standard_normal(image.shape, dtype=np.float32)
        return image


DEGREE = 5
"""Of the spline that moves the image: another one than the cubic that measures, or its errors would cancel."""

NEAR_PX = 1e-5
"""Change of a point, pixels, below which it is where it came from; a larger one blurs the known displacement."""

MOST_STEPS = 50
"""Steps after which a point stays where it is: at the sides of a crack that closes none fits."""

_ROWS = {2: 256, 3: 4}
"""Rows of an image, or planes of a volume, that are made at once; a larger value takes more memory."""


def _split_rows(shape: Sequence[int]) -> Iterator[range]:
    rows = range(shape[0])
    return (rows[first:first + _ROWS[len(shape)]] for first in range(0, len(rows), _ROWS[len(shape)]))


def _list_points(*along: range) -> Array:
    """Pixel centres at some rows and columns, x first, (dim, rows, ...), pixels."""
    return np.asarray(np.stack(np.meshgrid(*along, indexing="ij")[::-1]), dtype=np.float64)


def render_virtual_image(grey: Array, displacement: Array) -> NDArray[np.float32]:
    """Render g(y) = f(x) with x + u(x) = y, f interpolated by a quintic spline.

    ``displacement`` is u at pixel centres, (..., dim), pixels, finite. Noise of f moves with the specimen and
    is texture here; interpolation smooths it. What f does not show is its mirror image.
    """
    coefficients = ndimage.spline_filter(grey, DEGREE, mode="mirror")
    affine = _fit_affine(displacement)
    bands = []
    for rows in _split_rows(grey.shape):
        origins = _find_origins(displacement, affine, _list_points(rows, *map(range, grey.shape[1:])))
        bands.append(ndimage.map_coordinates(coefficients, origins[::-1], order=DEGREE, prefilter=False,
                                             mode="mirror").astype(np.float32))
    return np.concatenate(bands)


def _fit_affine(displacement: Array) -> tuple[Array, Array]:
    """F and t of x + u(x) = F x + t + small, by least squares over a few thousand pixels."""
    *sizes, dim = displacement.shape
    along = [range(0, size, max(1, size // round(4096 ** (1 / dim)))) for size in sizes]
    points = _list_points(*along)
    columns = np.column_stack([*points.reshape(dim, -1), np.ones(points[0].size)])
    fitted = np.linalg.lstsq(columns, displacement[np.ix_(*along)].reshape(-1, dim), rcond=None)[0]
    return np.eye(dim) + fitted[:dim].T, fitted[dim]


def _find_origins(displacement: Array, affine: tuple[Array, Array], points: Array) -> Array:
    """The x of points y, both (dim, rows, ...): x <- F^-1 (y - t - what is left of u at x)."""
    gradient, offset = affine
    inverse, dim = np.linalg.inv(gradient), len(offset)
    shift = offset.reshape(-1, *[1] * dim)
    x = np.einsum("ij,j...->i...", inverse, points - shift)
    for _ in range(MOST_STEPS):
        u = np.stack([ndimage.map_coordinates(displacement[..., axis], x[::-1], order=1, mode="nearest")
                      for axis in range(dim)])
        # Without its affine part, so that turned and stretched images need no more steps than others.
        change = np.einsum("ij,j...->i...", inverse, points - x - u)
        x = x + change
        if np.abs(change).max() <= NEAR_PX:
            break
    return np.asarray(x)


KEPT_PIXELS = 50_000_000
"""Pixels of all candidates together up to which their images, M and factors are kept, 20 to 40 bytes a pixel; others
are prepared twice. A larger value takes more memory."""

Advance = Callable[[str], None]
"""Told what is measured next."""


def measure_candidates(team: Team, varied: Sequence[tuple[Candidate, Inputs]], frame: Frame, advance: Advance) -> Sweep:
    """Measure the pair and the virtual images with every candidate, and choose one; collective.

    ``varied`` has candidates with their inputs, the case's own first, of one camera; ``advance`` is told what is
    measured next, twice for each candidate. The sweep is the same on all ranks. Raises ConvergenceError on all ranks,
    where no candidate measures the pair, or the virtual images.
    """
    inputs = varied[0][1]
    reference, degree = inputs.cameras[0].reference, inputs.case.correlation.spline_degree
    section = inputs.case.regularization
    material = Material.default(inputs.case.dim) if section is None else build_material(section, inputs.case.dim)
    stays_open = reference.extent.n_pixels * len(varied) <= KEPT_PIXELS
    with ExitStack() as stack:
        sessions = [stack.enter_context(closing(_CandidateSession(team, candidate, inputs, stays_open=stays_open)))
                    for candidate, inputs in varied]
        trials, fields = _measure_pair(sessions, frame, advance)
        points = team.alike(lambda: _draw_points(trials, fields))
        trials = [_evaluate_pair(trial, field, points, material) for trial, field in zip(trials, fields, strict=True)]
        noise = estimate_pair_noise(trials, _find_noise_transfer(trials, degree))
        trials = predict_errors(trials, noise, team.on_root(lambda: _measure_gradient(reference, points, degree)))
        known = int(np.nanargmin([trial.predicted_error for trial in trials]))
        field = require_held(fields[known])
        start = keep_displacement(field, "the measured field")
        truth = VirtualTruth(field.mesh, field.displacement)
        again = sessions[known].measure_virtual(_render(team, reference, truth, 0.0), start)
        truth = truth if again is None else truth.with_lost_detail(again)
        virtual = _render(team, reference, truth, float(np.sqrt(noise.of_field)))
        for number, session in enumerate(sessions):
            advance(f"virtual images, {trials[number].candidate.describe()}")
            if not trials[number].failure:
                measured = session.measure_virtual(virtual, start)
                trials[number] = _evaluate_virtual(trials[number], measured, truth, points)
    trials = correct_predictions(trials, known)
    chosen = team.alike(lambda: choose_trial(trials))
    return Sweep(tuple(trials), points, noise.camera, known, chosen)


def _measure_pair(sessions: Sequence[_CandidateSession], frame: Frame,
                  advance: Advance) -> tuple[list[Trial], list[Result | None]]:
    """What each measures of the pair, from the second on starting from the first field."""
    trials: list[Trial] = []
    fields: list[Result | None] = []
    start = None
    for session in sessions:
        advance(f"images of the case, {session.candidate.describe()}")
        trial, field = session.measure_pair(frame, start)
        trials.append(trial)
        fields.append(field)
        if start is None and field is not None:
            start = keep_displacement(field, "the first field")
    return trials, fields


def _find_noise_transfer(trials: Sequence[Trial], degree: int) -> float:
    """What interpolation leaves of the deformed image's noise, 0 to 1, where the first trial measured it has moved."""
    moved = next(trial for trial in trials if not trial.failure).displacement
    moved = moved[np.isfinite(moved).all(axis=1)]
    # As much along x as along y.
    return float(build_white_transfer(degree, moved.shape[1]).find(moved)[:, 0].mean())


def _measure_gradient(reference: MaskedSource, points: Array, degree: int) -> float:
    """Mean square of the reference image's gradient at the pixels next to points, (n, dim), all components together."""
    pixels, squares = np.rint(points).astype(np.int64), np.zeros(len(points))
    for band in reference.extent.split_rows(_ROWS[points.shape[1]] * 16):
        inside = (pixels[:, -1] >= band.lower[-1]) & (pixels[:, -1] < band.upper[-1])
        image = read_reference(MaskedSource(reference.image), band, degree)
        at_pixels = image.window.index(pixels[inside])
        squares[inside] = np.sum([slope[at_pixels] ** 2 for slope in find_slopes(image)], axis=0)
    return float(squares.mean())


def _render(team: Team, reference: MaskedSource, truth: VirtualTruth, noise: float) -> Frame:
    """The deformed image of a displacement, with noise of a standard deviation, whole on every rank; collective."""
    values = team.on_root(lambda: truth.render(reference.read_whole(), noise))
    return (MaskedSource(ArraySource(Path("virtual image"), values)),)
