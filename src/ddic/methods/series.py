"""A series of deformed images measured from one reference image; what is finished is never lost.

A session has one reference image: the first one, or that of a frame that was measured and has taken its place. A frame
starts from what those before it extrapolate to, or from a search; one that cannot be measured does not stop the others.
Each is written to a folder as it is finished; at the end they are joined to one result file.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import Array
from ddic.case.loader import LoadedCase
from ddic.case.named_files import list_cameras, list_deformed, list_times
from ddic.errors import (
    ConvergenceError,
    DdicError,
    InputError,
    SingularSubdomainError,
    StoppedError,
    as_collective,
    require_collective,
)
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import FrameOpener, Inputs, inputs_kept, open_inputs
from ddic.io import result_schema as schema
from ddic.io.replace_on_exit import replaced_together
from ddic.io.result_writer import ResultWriter
from ddic.io.series_writer import BackgroundWriter, FrameState, ReadAhead, SeriesFolder, join_frames
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.fe_dic import measure_and_look
from ddic.parallel.field import Field
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import StopRequest, is_stop_asked
from ddic.parallel.team import Team, require_held
from ddic.problem.reference_problem import update_reference
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement, place_at_nodes
from ddic.results.publishing import Publishable, pack, publish
from ddic.results.summary import FrameRecord, SeriesSummary, Vertices, write_series_summary

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


def run_series(team: Team, loaded: LoadedCase, listener: Listener, *, resume: bool = False) -> SeriesSummary:
    """Measure the deformed images of a case in order; collective.

    ``resume`` tells whether to go on where an earlier run stopped. Returns the summary, also written beside the result.
    Raises DdicError on all ranks: where frames could not be measured the others are in the result, and the message says
    which. Raises StoppedError on all ranks, where a signal asked one of them to stop; what was measured until then is
    in the result.
    """
    began = time.perf_counter()
    file, n_frames = loaded.case.output.file, len(list_deformed(loaded.case.imaging))
    folder = SeriesFolder(file, n_frames)
    origin = _describe_origin(loaded)
    texts = team.on_root(lambda: folder.begin(origin, resume=resume))
    finished = {number: FrameRecord.from_json(text) for number, text in texts.items()}
    records = [*finished.values(), *_measure_in_groups(team, loaded, finished, folder, listener)]
    records.sort(key=lambda record: record.number)
    summary = SeriesSummary(records, n_frames, str(file), time.perf_counter() - began, len(finished),
                            {"path": str(loaded.path), "toml": loaded.text})
    team.on_root(lambda: _finish_series(folder, summary, origin))
    if not summary.is_whole:
        raise as_collective(StoppedError(_describe_stop(summary)))
    if summary.failures:
        raise as_collective(ConvergenceError(_describe_failures(summary)))
    return summary


def _measure_in_groups(team: Team, loaded: LoadedCase, finished: Mapping[int, FrameRecord], folder: SeriesFolder,
                       listener: Listener) -> list[FrameRecord]:
    """Measure the frames that are not finished, each group of ranks a part of them that follow each other; collective.

    Returns the record of each on all ranks. Raises what ``measure_frames`` does, once all groups are done.
    """
    n_groups, error = loaded.case.series.groups, None
    records: list[FrameRecord] = []
    with team.in_groups(n_groups) as (group, own):
        first, end = (1 + folder.n_frames * k // n_groups for k in (group, group + 1))
        part = range(first, end)
        numbers = [number for number in part if number not in finished]
        if numbers:
            before = [finished[number] for number in part if number < numbers[0]]
            try:
                images = _open_series(own, loaded, numbers[0], listener)
                if n_groups > 1:
                    listener.note(f"{n_groups} groups of {own.size} ranks measure; this one frames {first}-{end - 1}")
                records = measure_frames(own, images, numbers, before, folder)
            except (DdicError, OSError) as caught:
                require_collective(caught)
                error = caught
        is_first = own.is_root
    team.share_error(error)
    return team.gather_lists(records if is_first else [])


def _describe_origin(loaded: LoadedCase) -> dict[str, object]:
    """What a series is measured from, as JSON has it, to tell it from others."""
    sections = list_cameras(loaded.case)
    return {"case file": loaded.text, "reference images": [str(section.reference) for section in sections],
            "deformed images": [[str(path) for path in list_deformed(section)] for section in sections],
            "times": list(list_times(loaded.case))}


def _open_series(team: Team, loaded: LoadedCase, number: int, listener: Listener) -> _SeriesImages:
    """The reference images of a series, and its first frame that is to be measured, from 1; the clock has begun."""
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    with inputs_kept(team, loaded.stamps), clock.phase(Phase.MESH):
        inputs, first = open_inputs(team, loaded, number - 1)
    # A frame that has begun is finished: no signal ends it.
    patient = replace(team, stop=StopRequest())
    return _SeriesImages(patient, FrameOpener(team, inputs, number, first, loaded.stamps), listener, clock)


def measure_frames(team: Team, images: _SeriesImages, numbers: Sequence[int], before: Sequence[FrameRecord],
                   folder: SeriesFolder) -> list[FrameRecord]:
    """Measure frames, from 1, in order, or as many of them as a signal leaves time for; collective.

    ``before`` are those before them. Returns the record of each frame, the same on all ranks. Raises InputError,
    SingularSubdomainError, FactorizationError or OSError on all ranks, where nothing can be prepared, or no frame can
    be written.
    """
    opener, listener = images.opener, images.listener
    with ExitStack() as stack:
        reader, writer = stack.enter_context(ReadAhead()), stack.enter_context(BackgroundWriter())
        so_far = _begin(images, before, folder)
        try:
            for number in numbers:
                if team.is_root:
                    reader.begin(opener.list_files(number + 1))
                listener.frame(number, opener.n_frames, opener.describe(number))
                frame = so_far.measure(number)
                so_far.add(frame, _keep_frame(images.team, frame, folder, writer))
                listener.note(frame.record.describe())
                if is_stop_asked(team):
                    break
        finally:
            so_far.session.close()
        team.on_root(writer.wait)
    return so_far.records[len(before):]


def _begin(images: _SeriesImages, before: Sequence[FrameRecord], folder: SeriesFolder) -> _FramesSoFar:
    """Prepare the session that an earlier run was at, or a new one; collective."""
    measured, records = [record for record in before if record.converged], list(before)
    if not measured:
        return _FramesSoFar(_ReferenceSession.prepare(images, (), images.opener.first), records, [])
    lines, reference = measured[-1].lines, measured[-1].reference
    # Fields on a mesh that other lines cut do not help.
    known = [record.number for record in measured[-N_STATES:] if record.lines == lines]
    section = images.opener.inputs.case.regularization
    history = [] if section is None or section.yield_strain is None else [record.number for record in measured]
    needed = {*known, *history, reference} - {0}
    stored = images.team.on_root(lambda: {number: folder.read_state(number) for number in needed})
    session = _ReferenceSession.prepare(images, lines)
    states = _collect_states(session.session.problem, [stored[number] for number in known])
    try:
        _repeat_history(session.session.problem, [stored[number] for number in history])
    except BaseException:
        session.close()
        raise
    if not states or not reference:
        return _FramesSoFar(session, records, states)
    record = next(record for record in measured if record.number == reference)
    updated = session.update(record, *_collect_states(session.session.problem, [stored[reference]]))
    states = updated.restrict_states(session, states)
    session.close()
    return _FramesSoFar(updated, records, states)


def _keep_frame(team: Team, frame: _MeasuredFrame, folder: SeriesFolder, writer: BackgroundWriter) -> FrameState | None:
    """Begin to write a frame, or note that it could not be measured; collective, the writer is rank 0's.

    Returns what the next frame starts from, as it is written; None where it could not be measured. Raises OSError on
    all ranks where it cannot be written, or the one before could not be.
    """
    record, result = frame.record, frame.result
    if isinstance(result, DdicError):
        _note_failure(team, result, record, folder)
        return None
    measurement = replace(result, inputs=result.inputs.with_frame(record.number - 1))
    unknowns = {subdomain.index: q for subdomain, q in zip(measurement.subdomains, measurement.unknowns, strict=True)}
    state = FrameState(record.time, unknowns, measurement.noise, measurement.evidence.shown_share,
                       measurement.excluded.has_held_off(team))
    content = _pack_frame(measurement, record, state)
    path = folder.get_frame_path(record.number)
    team.on_root(lambda: writer.write(path, require_held(content)))
    return state


def _pack_frame(measurement: Measurement, record: FrameRecord, state: FrameState) -> bytes | None:
    """The file of a frame, with what the next one goes on from; on rank 0, collective."""
    gathered = measurement.team.gather_to(state.unknowns, 0)

    def add(opened: ResultWriter) -> None:
        by_subdomain = {f"{number:06d}": np.asarray(q)
                        for of_rank in require_held(gathered) for number, q in of_rank.items()}
        opened.write_attributes(schema.SERIES, {"record": record.as_json(), "time": record.time,
                                                "noise": np.array(state.noise, dtype=float),
                                                "shown_share": state.shown_share, "holds_back": state.holds_back})
        opened.write_arrays(f"{schema.SERIES}/unknowns", by_subdomain)

    return pack(measurement, flip_y=measurement.inputs.case.output.flip_y, add=add)


def _note_failure(team: Team, error: DdicError, record: FrameRecord, folder: SeriesFolder) -> None:
    """Note that a frame could not be measured, and write its last field as that of an unconverged pair; collective."""
    last = error.last if isinstance(error, ConvergenceError) else None
    if isinstance(last, Publishable):
        path = schema.not_converged_path(folder.result.with_suffix(f".{record.number:06d}{folder.result.suffix}"))
        try:
            publish(last, path, flip_y=last.inputs.case.output.flip_y)
        except (OSError, DdicError) as second:
            # That the frame failed is told first; this comes of it.
            require_collective(second)
            record = replace(record, failure=f"{record.failure}; its last field could not be written ({second})")
    team.on_root(lambda: folder.write_failure(record.number, record.as_json()))


def _finish_series(folder: SeriesFolder, summary: SeriesSummary, origin: Mapping[str, object]) -> None:
    """Join what was measured, and write the summary; the folder of frames goes once every frame was tried.

    The folder is not there where an earlier run has finished the series: nothing is left to do then. Raises OSError
    where one cannot be written; neither is, an earlier result and the frames stay.
    """
    if not folder.path.exists():
        return
    measured = [frame.number for frame in summary.frames if frame.converged]
    with replaced_together() as files:
        if measured:
            records = [frame.as_json() for frame in summary.frames]
            join_frames(folder, measured, records, json.dumps(origin), files)
        else:
            summary = replace(summary, result_file="")
        write_series_summary(schema.summary_path(folder.result), summary, files)
    if summary.is_whole:
        folder.remove()


def _describe_stop(summary: SeriesSummary) -> str:
    tried = len(summary.frames)
    return (f"stopped by a signal after {tried} of {summary.n_frames} frames, of which {tried - len(summary.failures)} "
            f"are in {summary.result_file or 'no file'}; ddic run --resume measures the rest")


def _describe_failures(summary: SeriesSummary) -> str:
    failures = summary.failures
    reasons = "; ".join(frame.describe() for frame in failures)
    kept = "" if len(failures) == len(summary.frames) else f"; the others are in {summary.result_file}"
    return f"{len(failures)} of {summary.n_frames} frames could not be measured: {reasons}{kept}"


@dataclass(frozen=True)
class _SeriesImages:
    """What frames are opened, told and timed with; no signal stops the team."""

    team: Team
    opener: FrameOpener
    listener: Listener
    clock: PhaseClock


def _collect_states(problem: WeightedProblem, states: Sequence[FrameState]) -> list[FrameState]:
    """Take up of what an earlier run has measured what owned subdomains need; collective.

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
    return [replace(state, unknowns={subdomain.index: state.unknowns[subdomain.index] for subdomain in subdomains})
            for state in states]


def _repeat_history(problem: WeightedProblem, states: Sequence[FrameState]) -> None:
    """Put a plastic material through the frames that an earlier run has measured; collective.

    Raises InputError on all ranks, where the subdomains are others.
    """
    taken = _collect_states(problem, states)
    if len(taken) < len(states):
        raise as_collective(InputError("--resume: the plastic strains so far are known by subdomain, and these are "
                                       "others now; resume on as many ranks as before, or measure all frames again"))
    subdomains = problem.reference.subdomains
    for state in taken:
        require_held(problem.law).keep(Field(problem.team, subdomains, [state.unknowns[s.index] for s in subdomains]))


def _choose_start(wanted: str, states: Sequence[FrameState], time: float) -> tuple[str, Mapping[int, Array] | None]:
    """Choose what a frame starts from of those before it: its name, and unknowns by owned subdomain.

    These are None where it is to be searched for. ``wanted`` is ``series.start`` of the case; ``states`` are those of
    the last frames that were measured, two at most; ``time`` is the frame's, unit chosen by the user.
    """
    # A field that mechanics hold off what its frame showed would take what it sees for something else.
    if wanted == "search" or not states or states[-1].holds_back:
        return SEARCH, None
    last = states[-1]
    if wanted != "extrapolate" or len(states) == 1:
        return "the last frame", last.unknowns
    before = states[-2]
    share = (time - last.time) / (last.time - before.time)
    return "the last two frames", {number: q + share * (q - before.unknowns[number])
                                   for number, q in last.unknowns.items()}


class _ReferenceSession:
    """The session of one reference image, ``of`` a frame or else the first one; the caller's to close.

    ``frame`` is that frame's number, 0 for the first reference image; ``lines`` are the vertices of the discontinuities
    as a frame has refined them, pixels, none for those of the case; ``started_from`` says where the last frame was
    started.
    """

    def __init__(self, images: _SeriesImages, inputs: Inputs, lines: tuple[Vertices, ...] = (),
                 first_frame: Frame | None = None, of: FrameRecord | None = None) -> None:
        self.images, self.lines = images, lines
        self.frame = 0 if of is None else of.number
        self.session = DecomposedSession(images.team, inputs, images.listener, images.clock, first_frame)
        # What noise has left in the field of that frame, pixels.
        self._noise_floor = 0.0 if of is None else of.noise_floor_px
        self._floor_by_grey_level: float | None = None
        self.started_from = SEARCH

    @classmethod
    def prepare(cls, images: _SeriesImages, lines: tuple[Vertices, ...],
                first_frame: Frame | None = None) -> _ReferenceSession:
        """Prepare the session of the first reference image with lines as a frame has refined them; collective.

        Raises InputError, SingularSubdomainError or FactorizationError on all ranks.
        """
        return cls(images, _place_lines(images.opener.inputs, lines), lines, first_frame)

    def update(self, record: FrameRecord, state: FrameState) -> _ReferenceSession:
        """Prepare a session that compares with a frame that was measured; collective.

        This one stays; the other one is the caller's to close. ``state`` is the frame's field on this session's
        subdomains. Raises InputError, SingularSubdomainError or FactorizationError on all ranks, where the mesh has
        left the frame, or the frame does not hold it.
        """
        images = self.images
        displacement = self._gather(state)
        frame = images.opener.open(record.number)
        inputs = update_reference(images.team, self.session.problem.reference, frame, displacement)
        return _ReferenceSession(images, inputs, of=record)

    def measure(self, frame: Frame, states: Sequence[FrameState], time: float) -> Measurement:
        """Measure a frame from those before it, or from a search where there are none or they lead nowhere; collective.

        What earlier frames changed of the operators is forgotten. Raises InputError, ConvergenceError or
        SingularSubdomainError on all ranks, where the search does not converge either.
        """
        session, reference, listener = self.session, self.session.problem.reference, self.images.listener
        self.started_from, unknowns = _choose_start(self.images.opener.inputs.case.series.start, states, time)
        if unknowns is not None:
            session.begin_anew()
            try:
                start = reference.convert_to_reference([unknowns[s.index] for s in reference.subdomains])
                return session.measure(frame, start, LEAST_SHOWN * states[-1].shown_share)
            except (ConvergenceError, SingularSubdomainError) as error:
                require_collective(error)
                listener.note(f"from {self.started_from}: {error}; it is searched for")
                self.started_from = SEARCH
        session.begin_anew()
        return session.measure(frame)

    def estimate_noise_floor(self, measurement: Measurement) -> float:
        """Estimate what noise leaves in a frame's field, with what it has left in those of updates; collective.

        It is found by linear steps for the first frame, by their residuals for the others: the RMS of a component at a
        node, pixels; nan where a linear step fails.
        """
        deviation = measurement.evaluation.grey[0].residual_std
        if self._floor_by_grey_level is None:
            self._floor_by_grey_level = self.session.estimate_noise_floor(measurement) / max(deviation, 1e-300)
        return math.hypot(self._noise_floor, self._floor_by_grey_level * deviation)

    def restrict_states(self, other: _ReferenceSession, states: Sequence[FrameState]) -> list[FrameState]:
        """Restrict another session's states to these subdomains, none where other lines cut the mesh; collective."""
        if other is self:
            return list(states)
        if other.lines != self.lines:
            return []
        fields = [other._gather(state) for state in states]
        subdomains = self.session.problem.reference.subdomains
        return [replace(state, unknowns={s.index: field[s.node_ids].ravel() for s in subdomains})
                for state, field in zip(states, fields, strict=True)]

    def _gather(self, state: FrameState) -> Array:
        """The displacement of all nodes since the first reference image, (n_nodes, dim), pixels; collective."""
        reference = self.session.problem.reference
        dim = reference.inputs.case.dim
        # The unknowns of the subdomains are displacements of nodes.
        own = [(subdomain.node_ids, state.unknowns[subdomain.index].reshape(-1, dim))
               for subdomain in reference.subdomains]
        return place_at_nodes(self.images.team.gather_lists(own), reference.region.n_nodes, dim)

    def close(self) -> None:
        """Free PETSc's objects."""
        self.session.close()


def _place_lines(inputs: Inputs, lines: tuple[Vertices, ...]) -> Inputs:
    """Put the discontinuities of a case where a frame has refined them, pixels; they stay where there are no lines."""
    if not lines:
        return inputs
    sections = tuple(section.model_copy(update={"vertices": vertices})
                     for section, vertices in zip(inputs.case.discontinuity, lines, strict=True))
    return replace(inputs, case=inputs.case.model_copy(update={"discontinuity": sections}))


@dataclass(frozen=True)
class _MeasuredFrame:
    """What became of a frame; its result is an error where it could not be measured.

    The session is another one than was asked where lines were refined, and then the caller's to close.
    """

    record: FrameRecord
    result: Measurement | DdicError
    session: _ReferenceSession


def _measure_frame(session: _ReferenceSession, number: int, states: Sequence[FrameState]) -> _MeasuredFrame:
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
            session, measurement = _measure_on_lines(session, frame, states, record.time)
    except DdicError as error:
        require_collective(error)
        return _MeasuredFrame(replace(record, failure=str(error)), error, session)
    deviation = measurement.evaluation.grey[0].residual_std
    record = replace(record, converged=True, iterations=measurement.n_iterations, started_from=session.started_from,
                     lines=session.lines, residual_std_grey=deviation,
                     noise_floor_px=session.estimate_noise_floor(measurement), notes=measurement.notes,
                     verdict=measurement.verdict.word, reasons=measurement.verdict.reasons,
                     seconds=float(images.team.maximum(time.perf_counter() - began)))
    return _MeasuredFrame(record, measurement, session)


def _measure_on_lines(session: _ReferenceSession, frame: Frame, states: Sequence[FrameState],
                      time: float) -> tuple[_ReferenceSession, Measurement]:
    """Measure a frame with a session, or with one of lines that it refines; collective."""
    images = session.images
    inputs = _place_lines(images.opener.inputs, session.lines)
    measured = measure_and_look(lambda: session.measure(frame, states, time), images.team, inputs, frame,
                                images.listener, images.clock)
    if isinstance(measured, Measurement):
        return session, measured
    lines = tuple(section.vertices or () for section in measured.case.discontinuity)
    refined = _ReferenceSession.prepare(images, lines, frame)
    try:
        measurement = refined.measure(frame, (), time)
    except DdicError:
        refined.close()
        raise
    # They are of this frame alone: a series that is resumed knows the lines, not how they were found.
    return refined, measurement.with_notes(measured.notes[len(inputs.notes):])


@dataclass
class _FramesSoFar:
    """The frames of a series that are finished, in order, and what the next one goes on from.

    The session is of the reference image in use; states are those of the last frames that were measured, N_STATES at
    most, on its subdomains.
    """

    session: _ReferenceSession
    records: list[FrameRecord]
    states: list[FrameState]

    def measure(self, number: int) -> _MeasuredFrame:
        """Measure a frame, with the last one that was measured as its reference image where that is due; collective.

        Frames are numbered from 1; it is not among those that are finished yet.
        """
        session, section = self.session, self.session.images.opener.inputs.case.series
        if section.incremental == "always" and number - session.frame > section.update_after:
            return self._measure_updated(number) or _measure_frame(session, number, self.states)
        frame = _measure_frame(session, number, self.states)
        if section.incremental == "auto" and self._asks_for_update(frame.record):
            again = self._measure_updated(number)
            if again is not None and _is_better(again.record, frame.record):
                return again
            if again is not None:
                again.session.close()
        return frame

    def add(self, frame: _MeasuredFrame, state: FrameState | None) -> None:
        """Add a frame, and go on with the session that measured it; ``state`` is None where none did; collective."""
        states = frame.session.restrict_states(self.session, self.states)
        if frame.session is not self.session:
            self.session.close()
        self.session = frame.session
        self.records.append(frame.record)
        self.states = (states if state is None else [*states, state])[-N_STATES:]

    def _measure_updated(self, number: int) -> _MeasuredFrame | None:
        """Measure a frame with a session that compares with the last one that was measured; collective.

        None where there is none, or nothing is known of its field, or it is the reference image, or cannot be.
        """
        listener = self.session.images.listener
        last = next((record for record in reversed(self.records) if record.converged), None)
        if last is None or not self.states or last.number == self.session.frame:
            return None
        try:
            updated = self.session.update(last, self.states[-1])
        except DdicError as error:
            require_collective(error)
            listener.note(f"frame {last.number} cannot be the reference image: {error}")
            return None
        listener.note(f"frame {last.number} is the reference image from here on; its error adds up to those that "
                      "follow")
        return _measure_frame(updated, number, updated.restrict_states(self.session, self.states))

    def _asks_for_update(self, record: FrameRecord) -> bool:
        """Whether a frame was not measured, or its residual has grown."""
        if not record.converged:
            return True
        compared = [other.residual_std_grey for other in self.records
                    if other.converged and other.reference == record.reference]
        return bool(compared) and record.residual_std_grey > RESIDUAL_GROWTH * compared[0]


def _is_better(again: FrameRecord, before: FrameRecord) -> bool:
    if not (again.converged and before.converged):
        return again.converged
    return again.residual_std_grey < before.residual_std_grey
