"""A frame of a series: the session that measures it, where it starts, and what the next one goes on from.

A session has one reference image: the first one, or that of a frame that was measured and has taken its place. A frame
starts from what those before it extrapolate to, or from a search.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ddic.arrays import Array
from ddic.case.named_files import list_times
from ddic.errors import ConvergenceError, DdicError, SingularSubdomainError, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import FrameOpener, Inputs, inputs_kept
from ddic.io.series_folder import FrameState
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.fe_dic import add_notes, measure_and_look
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.reference_problem import update_reference
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement, place_at_nodes
from ddic.results.summary import FrameRecord, Vertices

N_STATES = 2
"""Frames from which the next one is extrapolated."""

SEARCH = "a search"
"""Name of a start that nothing is known of."""

LEAST_SHOWN = 0.8
"""Share of the cells that the last frame showed which a start must show, else it is searched for: Gauss-Newton takes
long, or does not find its way, from other speckle. A larger share searches more often."""

RESIDUAL_GROWTH = 1.5
"""Residual of a frame over that of the first one with the same reference image, from which on ``auto`` updates it: a
third of the residual is then light and speckle that have changed. A larger value updates later."""


@dataclass(frozen=True)
class SeriesImages:
    """What frames are opened, told and timed with.

    Attributes
    ----------
    team, opener, listener, clock : Team, FrameOpener, Listener, PhaseClock
        No signal stops the team.
    """

    team: Team
    opener: FrameOpener
    listener: Listener
    clock: PhaseClock


@dataclass(frozen=True)
class MeasuredState:
    """What a frame starts from of an earlier one.

    Attributes
    ----------
    time : float
        Of the earlier frame, unit chosen by the user.
    q : sequence of (n_unknowns,) array
        Unknowns of owned subdomains since the first reference image.
    shown_share : float
        Share of the cells that were seen where the field put them.
    holds_back : bool
        Whether mechanics held cells back from where they were seen, so that the field shows no way to the next frame.
    """

    time: float
    q: Sequence[Array]
    shown_share: float
    holds_back: bool


def collect_states(problem: WeightedProblem, states: Sequence[FrameState]) -> list[MeasuredState]:
    """Take up what an earlier run has measured, on owned subdomains; collective.

    Cameras of ``problem`` are weighted as they were. The list is empty where the subdomains are others: the next frame
    is searched for then.
    """
    if states and states[-1].noise and not problem.is_set_up:
        problem.set_noise(states[-1].noise)
    subdomains = problem.reference.subdomains
    n_other = sum(len(state.unknowns.get(subdomain.index, ())) != subdomain.n_unknowns
                  for state in states for subdomain in subdomains)
    if problem.team.sum(n_other):
        return []
    return [MeasuredState(state.time, [state.unknowns[subdomain.index] for subdomain in subdomains], state.shown_share,
                          state.holds_back) for state in states]


def choose_start(wanted: str, states: Sequence[MeasuredState], time: float) -> tuple[str, Sequence[Array] | None]:
    """Choose what a frame starts from of those before it: its name, and unknowns of owned subdomains.

    These are None where it is to be searched for. ``wanted`` is ``series.start`` of the case; ``states`` are those of
    the last frames that were measured, two at most; ``time`` is the frame's, unit chosen by the user.
    """
    # A field that mechanics hold off what its frame showed would take what it sees for something else.
    if wanted == "search" or not states or states[-1].holds_back:
        return SEARCH, None
    last = states[-1]
    if wanted != "extrapolate" or len(states) == 1:
        return "the last frame", last.q
    before = states[-2]
    share = (time - last.time) / (last.time - before.time)
    return "the last two frames", [q + share * (q - q_before) for q, q_before in zip(last.q, before.q, strict=True)]


class ReferenceSession:
    """The session of one reference image, the caller's to close.

    Parameters
    ----------
    images : SeriesImages
        Of the series.
    inputs : Inputs
        With that reference image.
    lines : tuple of tuple of (x, y), optional
        Vertices of the discontinuities as a frame has refined them, pixels; by default those of the case.
    first_frame : Frame, optional
        Where it is known already.
    of : FrameRecord, optional
        The frame whose image it is; by default that of no frame, the first one.

    Attributes
    ----------
    frame : int
        Its number; 0 for the first reference image.
    session : DecomposedSession
        Closed with this one.
    """

    def __init__(self, images: SeriesImages, inputs: Inputs, lines: tuple[Vertices, ...] = (),
                 first_frame: Frame | None = None, of: FrameRecord | None = None) -> None:
        self.images, self.lines = images, lines
        self.frame = 0 if of is None else of.number
        self.session = DecomposedSession(images.team, inputs, images.listener, images.clock, first_frame)
        # What noise has left in the field of that frame, pixels.
        self._noise_floor = 0.0 if of is None else of.noise_floor_px
        self._floor_by_grey_level: float | None = None

    @classmethod
    def prepare(cls, images: SeriesImages, lines: tuple[Vertices, ...],
                first_frame: Frame | None = None) -> ReferenceSession:
        """Prepare the session of the first reference image with lines as a frame has refined them; collective.

        ``first_frame`` is given where it is known already. Raises InputError, SingularSubdomainError or
        FactorizationError on all ranks.
        """
        return cls(images, place_lines(images.opener.inputs, lines), lines, first_frame)

    def update(self, record: FrameRecord, state: MeasuredState) -> ReferenceSession:
        """Prepare a session that compares with a frame that was measured; collective.

        This one stays; the other one is the caller's to close. ``state`` is the frame's field on this session's
        subdomains. Raises InputError, SingularSubdomainError or FactorizationError on all ranks, where the mesh has
        left the frame, or the frame does not hold it.
        """
        images = self.images
        displacement = self._gather(state)
        frame = images.opener.open(record.number)
        inputs = update_reference(images.team, self.session.problem.reference, frame, displacement)
        return ReferenceSession(images, inputs, of=record)

    def measure(self, frame: Frame, states: Sequence[MeasuredState], time: float) -> tuple[Measurement, str]:
        """Measure a frame from those before it, or from a search where there are none or they lead nowhere; collective.

        What earlier frames changed of the operators is forgotten. Returns the measurement and the name of the start.
        Raises InputError, ConvergenceError or SingularSubdomainError on all ranks, where the search does not converge
        either.
        """
        session, listener = self.session, self.images.listener
        name, q = choose_start(self.images.opener.inputs.case.series.start, states, time)
        if q is not None:
            session.begin_anew()
            try:
                start = session.problem.reference.convert_to_reference(q)
                return session.measure(frame, start, LEAST_SHOWN * states[-1].shown_share), name
            except (ConvergenceError, SingularSubdomainError) as error:
                if not is_collective(error):
                    raise
                listener.note(f"from {name}: {error}; it is searched for")
        session.begin_anew()
        return session.measure(frame), SEARCH

    def estimate_noise_floor(self, measurement: Measurement) -> float:
        """Estimate what noise leaves in a frame's field, with what it has left in those of updates; collective.

        It is found by linear steps for the first frame, by their residuals for the others: the RMS of a component at a
        node, pixels; nan where a linear step fails.
        """
        deviation = measurement.evaluation.grey[0].residual_std
        if self._floor_by_grey_level is None:
            self._floor_by_grey_level = self.session.estimate_noise_floor(measurement) / max(deviation, 1e-300)
        return math.hypot(self._noise_floor, self._floor_by_grey_level * deviation)

    def restrict_states(self, other: ReferenceSession, states: Sequence[MeasuredState]) -> list[MeasuredState]:
        """Restrict states on another session's subdomains to this one's; collective.

        None are left where other lines cut the mesh.
        """
        if other is self:
            return list(states)
        if other.lines != self.lines:
            return []
        fields = [other._gather(state) for state in states]
        subdomains = self.session.problem.reference.subdomains
        return [replace(state, q=[field[subdomain.node_ids].ravel() for subdomain in subdomains])
                for state, field in zip(states, fields, strict=True)]

    def _gather(self, state: MeasuredState) -> Array:
        """The displacement of all nodes since the first reference image, (n_nodes, 2), pixels; collective.

        The unknowns of the subdomains are displacements of nodes.
        """
        reference = self.session.problem.reference
        own = [(subdomain.node_ids, q.reshape(-1, 2))
               for subdomain, q in zip(reference.subdomains, state.q, strict=True)]
        return place_at_nodes(self.images.team.gather_lists(own), reference.region.n_nodes)

    def close(self) -> None:
        """Free PETSc's objects."""
        self.session.close()


def place_lines(inputs: Inputs, lines: tuple[Vertices, ...]) -> Inputs:
    """Put the discontinuities of a case where a frame has refined them, pixels; they stay where there are no lines."""
    if not lines:
        return inputs
    sections = tuple(section.model_copy(update={"vertices": vertices})
                     for section, vertices in zip(inputs.case.discontinuity, lines, strict=True))
    return replace(inputs, case=inputs.case.model_copy(update={"discontinuity": sections}))


@dataclass(frozen=True)
class MeasuredFrame:
    """What became of a frame.

    Attributes
    ----------
    record : FrameRecord
        What is told of it.
    result : Measurement or DdicError
        Its field, or why it could not be measured.
    session : ReferenceSession
        That measured it: another one than was asked where lines were refined, which the caller has to close then.
    """

    record: FrameRecord
    result: Measurement | DdicError
    session: ReferenceSession


def measure_frame(session: ReferenceSession, number: int, states: Sequence[MeasuredState]) -> MeasuredFrame:
    """Measure a frame, once more where its residual says that lines are off; collective.

    What cannot be measured is told. Frames are numbered from 1; ``states`` are those of the last frames that were
    measured, on the session's subdomains.
    """
    images, opener = session.images, session.images.opener
    record = FrameRecord(number, opener.describe(number), list_times(opener.inputs.case)[number - 1], converged=False,
                         reference=session.frame, lines=session.lines)
    began = time.perf_counter()
    try:
        with inputs_kept(images.team, opener.choose_stamps(number)):
            frame = opener.open(number)
            session, measurement, start = _measure_on_lines(session, frame, states, record.time)
    except DdicError as error:
        if not is_collective(error):
            raise
        return MeasuredFrame(replace(record, failure=str(error)), error, session)
    deviation = measurement.evaluation.grey[0].residual_std
    record = replace(record, converged=True, iterations=measurement.n_iterations, started_from=start,
                     lines=session.lines,
                     residual_std_grey=deviation, noise_floor_px=session.estimate_noise_floor(measurement),
                     notes=measurement.notes, seconds=float(images.team.maximum(time.perf_counter() - began)))
    return MeasuredFrame(record, measurement, session)


def _measure_on_lines(session: ReferenceSession, frame: Frame, states: Sequence[MeasuredState],
                      time: float) -> tuple[ReferenceSession, Measurement, str]:
    """Measure a frame with a session, or with one of lines that it refines; and where it started; collective."""
    images, start = session.images, SEARCH
    inputs = place_lines(images.opener.inputs, session.lines)

    def measure() -> Measurement:
        nonlocal start
        measurement, start = session.measure(frame, states, time)
        return measurement

    measured = measure_and_look(measure, images.team, inputs, frame, images.listener, images.clock)
    if isinstance(measured, Measurement):
        return session, measured, start
    lines = tuple(section.vertices or () for section in measured.case.discontinuity)
    refined = ReferenceSession.prepare(images, lines, frame)
    try:
        measurement, start = refined.measure(frame, (), time)
    except DdicError:
        refined.close()
        raise
    # They are of this frame alone: a series that is resumed knows the lines, not how they were found.
    return refined, add_notes(measurement, measured.notes[len(inputs.notes):]), start


@dataclass
class FramesSoFar:
    """The frames of a series that are finished, and what the next one goes on from.

    Attributes
    ----------
    session : ReferenceSession
        Of the reference image in use; it changes with the frames.
    records : list of FrameRecord
        Of all frames so far, in order.
    states : list of MeasuredState
        Of the last that were measured, two at most, on the session's subdomains.
    """

    session: ReferenceSession
    records: list[FrameRecord]
    states: list[MeasuredState]

    def measure(self, number: int) -> MeasuredFrame:
        """Measure a frame, with the last one that was measured as its reference image where that is due; collective.

        Frames are numbered from 1; it is not among those that are finished yet.
        """
        session, section = self.session, self.session.images.opener.inputs.case.series
        if section.incremental == "always" and number - session.frame > section.update_after:
            updated = self._update()
            if updated is not None:
                return measure_frame(updated, number, updated.restrict_states(session, self.states))
        frame = measure_frame(session, number, self.states)
        if section.incremental == "auto" and self._asks_for_update(frame.record):
            updated = self._update()
            if updated is not None:
                again = measure_frame(updated, number, updated.restrict_states(session, self.states))
                if _is_better(again.record, frame.record):
                    return again
                updated.close()
        return frame

    def add(self, frame: MeasuredFrame, state: MeasuredState | None) -> None:
        """Add a frame, and go on with the session that measured it; ``state`` is None where none did; collective."""
        states = frame.session.restrict_states(self.session, self.states)
        if frame.session is not self.session:
            self.session.close()
        self.session = frame.session
        self.records.append(frame.record)
        self.states = (states if state is None else [*states, state])[-N_STATES:]

    def _update(self) -> ReferenceSession | None:
        """A session that compares with the last frame that was measured; collective.

        None where there is none, or nothing is known of its field, or it is the reference image, or cannot be.
        """
        listener = self.session.images.listener
        last = next((record for record in reversed(self.records) if record.converged), None)
        if last is None or not self.states or last.number == self.session.frame:
            return None
        try:
            updated = self.session.update(last, self.states[-1])
        except DdicError as error:
            if not is_collective(error):
                raise
            listener.note(f"frame {last.number} cannot be the reference image: {error}")
            return None
        listener.note(f"frame {last.number} is the reference image from here on; its error adds up to those that "
                      "follow")
        return updated

    def _asks_for_update(self, record: FrameRecord) -> bool:
        """Whether a frame was not measured, or its residual has grown."""
        compared = [other.residual_std_grey for other in self.records
                    if other.converged and other.reference == record.reference]
        if not record.converged:
            return True
        return bool(compared) and record.residual_std_grey > RESIDUAL_GROWTH * compared[0]


def _is_better(again: FrameRecord, before: FrameRecord) -> bool:
    if not (again.converged and before.converged):
        return again.converged
    return again.residual_std_grey < before.residual_std_grey
