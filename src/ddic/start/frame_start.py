"""The start of a frame: a coarse field, independent measurements, and with several cameras their motions and noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.errors import InputError, as_collective, list_first
from ddic.functionals.correlation import Residual
from ddic.functionals.grey_statistics import GreyCorrection, measure_deviation
from ddic.functionals.view import FrameView
from ddic.inputs.cameras import Camera, Frame
from ddic.inputs.inputs import StartPoints
from ddic.kinematics.camera import CameraKinematics
from ddic.kinematics.kinematics import Kinematics
from ddic.parallel.field import ByView, Field
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.reference_problem import hold_set_ups_still
from ddic.problem.residual_model import Evaluation, ResidualModel, read_frame_windows
from ddic.problem.weighted_problem import WeightedProblem
from ddic.start.coarse_field import CoarseSearch, fit_found_fields
from ddic.start.given_start import EarlierResult, GivenStart
from ddic.start.independent import measure_independently
from ddic.start.multilevel import MultilevelStart

KnownStart = Sequence[Array] | GivenStart
"""Unknowns of each owned subdomain to start from, or a displacement to go on from."""

SMALLEST_SINGULAR_VALUE = 1e-9
"""Of what motions do to jumps, relative to the largest, below which jumps do not tell a motion. A larger value refuses
more meshes."""

ROUNDING = 0.29
"""Standard deviation of the rounding to whole grey levels: no estimate of an image of integers is below it."""

SMALLEST_SHARE = 1e-4
"""Share of the range of its grey levels below which no estimate of a camera's noise is, whatever their unit: no camera
tells ten thousand of them apart. A larger value gives a camera without noise less weight."""


@dataclass(frozen=True)
class FrameStart:
    """What the start of any frame is found with.

    Attributes
    ----------
    search : CoarseSearch
        For coarse fields.
    problem : WeightedProblem
        Set up by the first frame, where the noise of several cameras is not given.
    clock : PhaseClock
        Of the phases.
    """

    search: CoarseSearch
    problem: WeightedProblem
    clock: PhaseClock


@dataclass(frozen=True, eq=False)
class FoundStart:
    """Where Gauss-Newton starts.

    Attributes
    ----------
    q : Field
        Unknowns.
    notes : tuple of str
        How they were found.
    independent : list of (n_dofs,) array, or None
        What each owned subdomain measured by itself, pixels, as if no set-up had moved; where a case asks for it.
    """

    q: Field
    notes: tuple[str, ...]
    independent: list[Array] | None = None


def find_start(by: FrameStart, frame: Frame, views: ByView[FrameView], found: list[MultilevelStart] | None,
               begin: KnownStart | None) -> FoundStart:
    """Find where Gauss-Newton starts; collective.

    ``found`` are coarse fields that were found already, by camera. ``begin`` are unknowns of an earlier frame, which
    replace all stages; or a displacement from which they go on, in place of what the case gives. Raises InputError and
    ConvergenceError on all ranks.
    """
    problem, reference = by.problem, by.problem.reference
    team, subdomains = problem.team, reference.subdomains
    if isinstance(begin, EarlierResult | StartPoints):
        by, found = replace(by, search=replace(by.search, given=begin)), None
    elif begin is not None:
        return FoundStart(Field(team, subdomains, begin), ("start: an earlier frame",))
    search = by.search
    with by.clock.phase(Phase.START):
        if found is None:
            _, found = search.find(frame, lambda: None)
        q, notes = fit_found_fields(search, reference, require_held(found))
    with by.clock.phase(Phase.READ):
        team.together(lambda: read_frame_windows(hold_set_ups_still(subdomains, views)[1], q))
    with by.clock.phase(Phase.INDEPENDENT_START):
        q, of_refinement = _refine_independently(by, views, q)
        notes = (*notes, *of_refinement)
        independent = None
        if of_refinement and reference.inputs.case.output.independent_fields:
            still, _ = hold_set_ups_still(subdomains, views)
            independent = [subdomain.displacement(field) for subdomain, field in zip(still, q, strict=True)]
        if len(search.cameras) == 1:
            return FoundStart(q, notes, independent)
        motions = start_motions(search.cameras, q)
        noise: Sequence[float] = problem.noise
        if not problem.is_set_up:
            noise = _estimate_noise(search.cameras, q, views, search.correction)
    if not problem.is_set_up:
        problem.set_noise(noise)
    kinematics = [own.kinematics for own, *_ in reference.views]
    with_motions = team.together(lambda: q.map(
        lambda subdomain, field, of_own: _join_motion(of_own, field, motions[subdomain.camera]), kinematics))
    return FoundStart(with_motions, (*notes, *_describe_noise(search.cameras, noise)), independent)


def _refine_independently(by: FrameStart, views: ByView[FrameView], q: Field) -> tuple[Field, tuple[str, ...]]:
    """Fields of subdomains by themselves, where the case asks for them and something follows from them."""
    reference = by.problem.reference
    one_camera = len(by.search.cameras) == 1
    # Else the whole region's Gauss-Newton starts as cheaply: its factor is there, or none is needed.
    couples_several = reference.inputs.case.solver.method == "dual" and reference.region.n_subdomains > 1
    if not by.search.section.independent or (one_camera and not couples_several):
        return q, ()
    refined, own_kept = measure_independently(q, views, reference.hessians, by.search.correction, by.clock)
    kept = q.team.gather_lists(own_kept)
    note = "start: independent FE-DIC on every subdomain"
    if kept:
        note += f"; {len(kept)} kept the coarse field for want of texture or convergence ({list_first(kept)})"
    return refined, (note,)


def _join_motion(kinematics: Kinematics, field: Array, motion: Array) -> Array:
    """Unknowns of a subdomain from what its own camera saw as if its set-up were still, and the motion of that."""
    if not len(motion):
        return field
    if not isinstance(kinematics, CameraKinematics):
        raise TypeError("a camera whose set-up moves has kinematics of its own")
    in_image = kinematics.displacement(np.concatenate([field, np.zeros_like(motion)]))
    return kinematics.fit_with_motion(in_image, motion)


@dataclass(frozen=True)
class _InterfaceField:
    """What subdomains of one camera say of n unknowns on their interfaces.

    Attributes
    ----------
    camera : int
        Number of the camera.
    numbers, values : (n,) array
        Of the unknowns.
    columns : (n, n_motion_unknowns) array
        What the camera's motion does to them.
    """

    camera: int
    numbers: IntArray
    values: Array
    columns: Array


def start_motions(cameras: Sequence[Camera], q: Field) -> list[Array]:
    """Find the motion of each camera that leaves the least jumps between independent fields, Eq. 22 of [BP17].

    ``q`` are the fields' unknowns as if no set-up had moved; the motions, (n_motion_unknowns,), are on all ranks.
    Raises InputError on all ranks where a camera shares too few unknowns with others.
    """
    owned = q.team.together(lambda: [_interface_field(cameras[subdomain.camera], subdomain, field)
                                     for subdomain, field in zip(q.subdomains, q, strict=True)])
    pieces = q.team.gather_lists(owned)
    by_camera = [_mean_of_copies([piece for piece in pieces if piece.camera == camera.number]) for camera in cameras]
    n_motion_unknowns = [camera.setup.n_motion_unknowns for camera in cameras]
    columns, jumps = _find_jumps(by_camera, n_motion_unknowns)
    motions, _, rank, _ = np.linalg.lstsq(columns, jumps, rcond=SMALLEST_SINGULAR_VALUE)
    if rank < sum(n_motion_unknowns):
        raise as_collective(InputError(
            "near: the elements of a near-field image share too few nodes with those of other images to tell how its "
            "set-up moved; enlarge the mesh around it, or give near.region"))
    return np.split(motions, np.cumsum(n_motion_unknowns)[:-1])


def _find_jumps(by_camera: Sequence[_InterfaceField], n_motion_unknowns: Sequence[int]) -> tuple[Array, Array]:
    """What all motions do to the jumps between each two cameras, (n, n motion unknowns), and these jumps, (n,)."""
    ends = np.cumsum(n_motion_unknowns)
    of_camera = [slice(end - n, end) for end, n in zip(ends, n_motion_unknowns, strict=True)]
    n_columns = int(ends[-1])
    columns = [np.zeros((0, n_columns))]
    jumps = [np.zeros(0)]
    for (a, of_a), (b, of_b) in combinations(enumerate(by_camera), 2):
        _, at_a, at_b = np.intersect1d(of_a.numbers, of_b.numbers, return_indices=True)
        between = np.zeros((len(at_a), n_columns))
        between[:, of_camera[a]] = of_a.columns[at_a]
        between[:, of_camera[b]] = -of_b.columns[at_b]
        columns.append(between)
        jumps.append(of_a.values[at_a] - of_b.values[at_b])
    return np.concatenate(columns), np.concatenate(jumps)


def _interface_field(camera: Camera, subdomain: Subdomain, field: Array) -> _InterfaceField:
    """A subdomain's field and the columns of its camera's motion on its interface."""
    at = subdomain.jumps.unknowns
    kinematics = subdomain.kinematics
    displacements = camera.setup.motion_columns(subdomain.mesh.nodes).T
    columns = np.zeros((len(at), len(displacements)))
    for k, displacement in enumerate(displacements):
        columns[:, k] = kinematics.fit(displacement)[at]
    return _InterfaceField(camera.number, kinematics.numbers[at], field[at], columns)


def _mean_of_copies(pieces: Sequence[_InterfaceField]) -> _InterfaceField:
    """One value for each unknown from the subdomains of one camera."""
    if not pieces:
        return _InterfaceField(-1, np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0)))
    all_numbers = np.concatenate([piece.numbers for piece in pieces])
    all_values = np.concatenate([piece.values for piece in pieces])
    all_columns = np.concatenate([piece.columns for piece in pieces])
    numbers, place, copy_of, counts = np.unique(all_numbers, return_index=True, return_inverse=True, return_counts=True)
    sums = np.bincount(copy_of.reshape(-1), all_values, len(numbers))
    return _InterfaceField(pieces[0].camera, numbers, sums / counts, all_columns[place])


def _estimate_noise(cameras: Sequence[Camera], q: Field, views: ByView[FrameView],
                    correction: GreyCorrection) -> list[float]:
    """Find the noise of each camera: given, or its residual's standard deviation over sqrt(2); collective.

    The noise is a standard deviation, grey levels; each field is as its own camera alone sees it. Of a camera's
    subdomains the one in the middle counts: some may not have been measured well by themselves.
    """
    model = ResidualModel(q.team, *hold_set_ups_still(q.subdomains, views), correction, len(cameras))
    evaluation = model.evaluate(q)
    described = q.team.gather_lists(model.views.map(
        lambda own, residual: (own.camera, _deviation(model, evaluation, own.camera, residual),
                               *own.measure_grey_range()), evaluation.residuals).flat)
    noise = []
    for camera in cameras:
        of_camera = [rest for number, *rest in described if number == camera.number]
        deviations, lowest, highest = zip(*of_camera, strict=True)
        # The residual has the noise of two images.
        estimated = float(np.median(deviations)) / np.sqrt(2)
        # Floats need not be rounded.
        rounding = 0.0 if camera.reference.image.saturation is None else ROUNDING
        smallest = max(SMALLEST_SHARE * (max(highest) - min(lowest)), rounding)
        noise.append(max(estimated, smallest) if camera.noise is None else camera.noise)
    return noise


def _describe_noise(cameras: Sequence[Camera], noise: Sequence[float]) -> tuple[str, ...]:
    """Say what noise each camera has, grey levels, a line for each."""
    lines = []
    for camera, sigma in zip(cameras, noise, strict=True):
        origin = "estimated from the residual" if camera.noise is None else "given"
        lines.append(f"{camera.label}: noise of {sigma:.2f} grey levels ({origin})")
    return tuple(lines)


def _deviation(model: ResidualModel, evaluation: Evaluation, camera: int, residual: Residual) -> float:
    """Standard deviation of a subdomain's residual, grey levels."""
    first, second = residual.cell_sums.sum_residual(*model.find_correction(evaluation, camera, residual))
    return measure_deviation(max(float(residual.sums.n_pixels), 1.0), first.sum(), second.sum())[0]
