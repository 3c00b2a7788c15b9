"""The start of a frame: a coarse field, independent measurements, and with several cameras their motions and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import list_first
from ddic.kinematics.camera_kinematics import CameraKinematics
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.cameras import Frame
from ddic.problem.start_points import StartPoints
from ddic.problem.views import FrameViews, ReferenceViews, read_frame_windows
from ddic.problem.weighted_problem import WeightedProblem
from ddic.start.camera_noise import describe_noise, estimate_noise
from ddic.start.coarse_field import CoarseSearch, StartField
from ddic.start.earlier_field import fit_found_fields
from ddic.start.given_start import EarlierResult, GivenStart
from ddic.start.independent import measure_independently
from ddic.start.multilevel import MultilevelStart
from ddic.start.start_motions import start_motions

Array = NDArray[np.float64]

KnownStart = Sequence[Array] | GivenStart
"""Unknowns of each owned subdomain to start from, or a displacement to go on from."""


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

    Parameters
    ----------
    by : FrameStart
        What it is found with.
    frame : Frame
        One deformed image of each camera.
    views : sequence of FrameViews
        Owned subdomains in the frame.
    found : list of MultilevelStart or None
        Coarse fields that were found already, by camera.
    begin : sequence of (n_unknowns,) array, EarlierResult, StartPoints or None
        Unknowns of an earlier frame, which replace all stages; or a displacement from which they go on, in place of
        what the case gives.

    Returns
    -------
    StartedFrame
        Unknowns and notes.

    Raises
    ------
    InputError, ConvergenceError
        On all ranks.
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
