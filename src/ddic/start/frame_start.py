"""The start of a frame: a coarse field, independent measurements, and with several cameras their motions and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, as_collective, list_first
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import FrameView
from ddic.inputs.cameras import Camera, Frame
from ddic.inputs.start_points import StartPoints
from ddic.kinematics.camera import CameraKinematics
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.views import FrameViews, ReferenceViews, read_frame_windows
from ddic.problem.weighted_problem import WeightedProblem
from ddic.start.coarse_field import CoarseSearch, StartField, fit_found_fields
from ddic.start.given_start import EarlierResult, GivenStart
from ddic.start.independent import measure_independently
from ddic.start.multilevel import MultilevelStart

Array = NDArray[np.float64]

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
    team : Team
        All ranks.
    search : CoarseSearch
        For coarse fields.
    problem : WeightedProblem
        Set up by the first frame, where the noise of several cameras is not given.
    clock : PhaseClock
        Of the phases.
    """

    team: Team
    search: CoarseSearch
    problem: WeightedProblem
    clock: PhaseClock


@dataclass(frozen=True)
class StartedFrame:
    """Where Gauss-Newton starts.

    Attributes
    ----------
    q : list of (n_unknowns,) array
        Of each owned subdomain.
    notes : tuple of str
        How they were found.
    """

    q: list[Array]
    notes: tuple[str, ...]


def find_start(by: FrameStart, frame: Frame, views: Sequence[FrameViews], found: list[MultilevelStart] | None,
               begin: KnownStart | None) -> StartedFrame:
    """Find where Gauss-Newton starts; collective.

    ``found`` are coarse fields that were found already, by camera. ``begin`` are unknowns of an earlier frame, which
    replace all stages; or a displacement from which they go on, in place of what the case gives. Raises InputError and
    ConvergenceError on all ranks.
    """
    if isinstance(begin, EarlierResult | StartPoints):
        by, found = replace(by, search=by.search.start_from(begin)), None
    elif begin is not None:
        return StartedFrame([np.array(q_s) for q_s in begin], ("start: an earlier frame",))
    references = [of_subdomain.reference for of_subdomain in views]
    with by.clock.phase(Phase.START):
        coarse = _find_coarse_fields(by, frame, references, found)
    with by.clock.phase(Phase.READ):
        by.team.together(lambda: read_frame_windows([of_subdomain.alone() for of_subdomain in views], coarse.q))
    with by.clock.phase(Phase.INDEPENDENT_START):
        fields, notes = _refine_independently(by, views, coarse)
        if len(by.search.cameras) == 1:
            return StartedFrame(fields, notes)
        motions = start_motions(by.team, by.search.cameras, [r.subdomain for r in references], fields)
        if by.problem.is_set_up:
            noise: Sequence[float] = by.problem.noise
        else:
            noise = estimate_noise(by.team, by.search.cameras, views, fields, by.search.correction)
    if not by.problem.is_set_up:
        by.problem.set_noise(noise)
    q = by.team.together(lambda: [_join_motion(reference, field, motions[reference.subdomain.camera])
                                  for reference, field in zip(references, fields, strict=True)])
    return StartedFrame(q, (*notes, *describe_noise(by.search.cameras, noise)))


def _find_coarse_fields(by: FrameStart, frame: Frame, references: Sequence[ReferenceViews],
                        found: list[MultilevelStart] | None) -> StartField:
    if found is None:
        search = by.search.prepare(frame)
        found = by.search.share(by.team.together(search))
    return fit_found_fields(by.search, references, require_held(found))


def _refine_independently(by: FrameStart, views: Sequence[FrameViews],
                          coarse: StartField) -> tuple[list[Array], tuple[str, ...]]:
    """Fields of subdomains by themselves, where the case asks for them and something follows from them."""
    reference = by.problem.reference
    one_camera = len(by.search.cameras) == 1
    # Else the whole region's Gauss-Newton starts as cheaply: its factor is there, or none is needed.
    couples_several = reference.inputs.case.solver.method == "dual" and reference.region.n_subdomains > 1
    if not by.search.section.independent or (one_camera and not couples_several):
        return coarse.q, coarse.notes
    refined = measure_independently(by.team, views, reference.hessians, coarse.q, by.search.correction, by.clock)
    kept = by.team.gather_lists(refined.kept)
    note = "start: independent FE-DIC on every subdomain"
    if kept:
        note += f"; {len(kept)} kept the coarse field for want of texture or convergence ({list_first(kept)})"
    return refined.q, (*coarse.notes, note)


def _join_motion(reference: ReferenceViews, field: Array, motion: Array) -> Array:
    """Unknowns of a subdomain from what its own camera saw as if its set-up were still, and the motion of that."""
    if reference.subdomain.motion is None:
        return field
    kinematics = reference.own.kinematics
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
    numbers: NDArray[np.int64]
    values: Array
    columns: Array


def start_motions(team: Team, cameras: Sequence[Camera], subdomains: Sequence[Subdomain],
                  fields: Sequence[Array]) -> list[Array]:
    """Find the motion of each camera that leaves the least jumps between independent fields, Eq. 22 of [BP17].

    ``fields`` are those of the owned subdomains, as if no set-up had moved; the motions, (n_motion_unknowns,), are on
    all ranks. Raises InputError on all ranks where a camera shares too few unknowns with others.
    """
    owned = team.together(lambda: [_interface_field(cameras[subdomain.camera], subdomain, field)
                                   for subdomain, field in zip(subdomains, fields, strict=True)])
    pieces = team.gather_lists(owned)
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
    numbers, place, copy_of, counts = np.unique(all_numbers, return_index=True, return_inverse=True,
                                                return_counts=True)
    sums = np.bincount(copy_of.reshape(-1), all_values, len(numbers))
    return _InterfaceField(pieces[0].camera, numbers, sums / counts, all_columns[place])


def estimate_noise(team: Team, cameras: Sequence[Camera], views: Sequence[FrameViews],
                   fields: Sequence[NDArray[np.float64]], correction: GreyCorrection) -> list[float]:
    """Find the noise of each camera: given, or its residual's standard deviation over sqrt(2); collective.

    The noise is a standard deviation, grey levels; each field is as its own camera alone sees it. Of a camera's
    subdomains the one in the middle counts: some may not have been measured well by themselves.
    """
    alone = [_by_own_camera(of_subdomain) for of_subdomain in views]
    model = ResidualModel(team, alone, correction, len(cameras))
    evaluation = model.evaluate(fields)
    deviations = team.gather_lists([(of_subdomain.subdomain.camera, _deviation(model, evaluation, k))
                                    for k, of_subdomain in enumerate(alone)])
    ranges = team.gather_lists([(of_subdomain.subdomain.camera, *of_subdomain.reference.own.measure_grey_range())
                                for of_subdomain in alone])
    noise = []
    for camera in cameras:
        of_camera = [std for number, std in deviations if number == camera.number]
        # The residual has the noise of two images.
        estimated = float(np.median(of_camera)) / np.sqrt(2)
        lowest = min(low for number, low, _ in ranges if number == camera.number)
        highest = max(high for number, _, high in ranges if number == camera.number)
        smallest = max(SMALLEST_SHARE * (highest - lowest), _rounding(camera))
        noise.append(max(estimated, smallest) if camera.noise is None else camera.noise)
    return noise


def _rounding(camera: Camera) -> float:
    """Standard deviation of the rounding of a camera's grey levels; floats need not be rounded."""
    return 0.0 if camera.reference.image.saturation is None else ROUNDING


def describe_noise(cameras: Sequence[Camera], noise: Sequence[float]) -> tuple[str, ...]:
    """Say what noise each camera has, grey levels, a line for each."""
    lines = []
    for camera, sigma in zip(cameras, noise, strict=True):
        origin = "estimated from the residual" if camera.noise is None else "given"
        lines.append(f"{camera.label}: noise of {sigma:.2f} grey levels ({origin})")
    return tuple(lines)


def _by_own_camera(of_subdomain: FrameViews) -> FrameViews:
    """The same by its own camera, which keeps its number, in a set-up that does not move."""
    alone = of_subdomain.reference.alone()
    own = of_subdomain.reference.own.hold_still()
    return FrameViews(ReferenceViews(alone.subdomain, (own,)), (FrameView(own, of_subdomain.views[0].deformed),))


def _deviation(model: ResidualModel, evaluation: Evaluation, place: int) -> float:
    """Standard deviation of a subdomain's residual, grey levels."""
    residual = evaluation.residuals[place][0]
    camera = model.views[place].views[0].camera
    first, second = residual.cell_sums.sum_residual(*model.find_correction(evaluation, camera, residual))
    n_pixels = max(float(residual.sums.n_pixels), 1.0)
    mean = first.sum() / n_pixels
    variance = second.sum() / n_pixels - mean**2
    # Rounding may leave a variance of nothing below zero.
    return float(np.sqrt(max(variance, 0.0)))
