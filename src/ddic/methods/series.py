"""A series of deformed images measured from one reference image; what is finished is never lost.

Each frame is started from those before it; one that cannot be measured does not stop the others. Each is written to a
folder as it is finished; at the end they are joined to one result file.
"""

import json
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from ddic.case.loader import LoadedCase
from ddic.case.named_files import list_cameras, list_deformed, list_times
from ddic.errors import ConvergenceError, DdicError, StoppedError, as_collective, is_collective
from ddic.inputs.inputs import FrameOpener, inputs_kept, open_inputs
from ddic.io import result_schema as schema
from ddic.io.join_frames import join_frames
from ddic.io.replace_on_exit import replaced_together
from ddic.io.result_writer import ResultWriter
from ddic.io.series_folder import BackgroundWriter, ReadAhead, SeriesFolder
from ddic.methods.series_frame import (
    N_STATES,
    FramesSoFar,
    MeasuredFrame,
    MeasuredState,
    ReferenceSession,
    SeriesImages,
    collect_states,
)
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import StopRequest, is_stop_asked
from ddic.parallel.team import Team, require_held
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement
from ddic.results.publishing import Publishable, pack, publish
from ddic.results.summary import FrameRecord, SeriesSummary, write_series_summary


def run_series(team: Team, loaded: LoadedCase, listener: Listener, *, resume: bool = False) -> SeriesSummary:
    """Measure the deformed images of a case in order; collective.

    ``resume`` tells whether to go on where an earlier run stopped. Returns the summary, also written beside the result.
    Raises DdicError on all ranks: where frames could not be measured the others are in the result, and the message says
    which. Raises StoppedError on all ranks, where a signal asked one of them to stop; what was measured until then is
    in the result.
    """
    began = time.perf_counter()
    file, n_frames = loaded.case.output.file, len(list_deformed(loaded.case.images))
    folder = SeriesFolder(file, n_frames)
    origin = _describe_origin(loaded)
    texts = team.on_root(lambda: folder.begin(origin, resume=resume))
    finished = {number: FrameRecord.from_json(text) for number, text in texts.items()}
    numbers = [number for number in range(1, n_frames + 1) if number not in finished]
    records = list(finished.values())
    if numbers:
        before = [finished[number] for number in sorted(finished) if number < numbers[0]]
        images = _open_series(team, loaded, numbers[0], listener)
        records += measure_frames(team, images, numbers, before, folder)
    records.sort(key=lambda record: record.number)
    summary = SeriesSummary(records, n_frames, str(file), time.perf_counter() - began, len(finished),
                            {"path": str(loaded.path), "toml": loaded.text})
    team.on_root(lambda: _finish_series(folder, summary, origin))
    if not summary.is_whole:
        raise as_collective(StoppedError(_describe_stop(summary)))
    if summary.failures:
        raise as_collective(ConvergenceError(_describe_failures(summary)))
    return summary


def _describe_origin(loaded: LoadedCase) -> dict[str, object]:
    """What a series is measured from, as JSON has it, to tell it from others."""
    sections = list_cameras(loaded.case)
    return {"case file": loaded.text, "reference images": [str(section.reference) for section in sections],
            "deformed images": [[str(path) for path in list_deformed(section)] for section in sections],
            "times": list(list_times(loaded.case))}


def _open_series(team: Team, loaded: LoadedCase, number: int, listener: Listener) -> SeriesImages:
    """The reference images of a series, and its first frame that is to be measured, from 1; the clock has begun."""
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    with inputs_kept(team, loaded.stamps), clock.phase(Phase.MESH):
        inputs, first = open_inputs(team, loaded, number - 1)
    # A frame that has begun is finished: no signal ends it.
    patient = replace(team, stop=StopRequest())
    return SeriesImages(patient, FrameOpener(team, inputs, number, first, loaded.stamps), listener, clock)


def measure_frames(team: Team, images: SeriesImages, numbers: Sequence[int], before: Sequence[FrameRecord],
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


def _begin(images: SeriesImages, before: Sequence[FrameRecord], folder: SeriesFolder) -> FramesSoFar:
    """Prepare the session that an earlier run was at, or a new one; collective."""
    measured, records = [record for record in before if record.converged], list(before)
    if not measured:
        return FramesSoFar(ReferenceSession.prepare(images, (), images.opener.first), records, [])
    lines, reference = measured[-1].lines, measured[-1].reference
    # Fields on a mesh that other lines cut do not help.
    known = [record.number for record in measured[-N_STATES:] if record.lines == lines]
    needed = {*known, reference} - {0}
    stored = images.team.on_root(lambda: {number: folder.read_state(number) for number in needed})
    session = ReferenceSession.prepare(images, lines)
    states = collect_states(session.session.problem, [stored[number] for number in known])
    if not states or not reference:
        return FramesSoFar(session, records, states)
    record = next(record for record in measured if record.number == reference)
    updated = session.update(record, *collect_states(session.session.problem, [stored[reference]]))
    states = updated.restrict_states(session, states)
    session.close()
    return FramesSoFar(updated, records, states)


def _keep_frame(team: Team, frame: MeasuredFrame, folder: SeriesFolder,
                writer: BackgroundWriter) -> MeasuredState | None:
    """Begin to write a frame, or note that it could not be measured; collective, the writer is rank 0's.

    Returns what the next frame starts from, as it is written; None where it could not be measured. Raises OSError on
    all ranks where it cannot be written, or the one before could not be.
    """
    record, result = frame.record, frame.result
    if isinstance(result, DdicError):
        _note_failure(team, result, record, folder)
        return None
    measurement = replace(result, inputs=result.inputs.with_frame(record.number - 1))
    state = MeasuredState(record.time, measurement.unknowns, measurement.shown_share,
                          measurement.excluded.has_held_off(team))
    content = _pack_frame(measurement, record, state)
    path = folder.get_frame_path(record.number)
    team.on_root(lambda: writer.write(path, require_held(content)))
    return state


def _pack_frame(measurement: Measurement, record: FrameRecord, state: MeasuredState) -> bytes | None:
    """The file of a frame, with what the next one goes on from; on rank 0, collective."""
    own = {f"{subdomain.index:06d}": np.asarray(q)
           for subdomain, q in zip(measurement.subdomains, state.q, strict=True)}
    gathered = measurement.team.gather_to(own, 0)

    def add(opened: ResultWriter) -> None:
        by_subdomain = {name: q for of_rank in require_held(gathered) for name, q in of_rank.items()}
        opened.write_attributes(schema.SERIES, {"record": record.as_json(), "time": record.time,
                                                "noise": np.array(measurement.noise, dtype=float),
                                                "shown_share": state.shown_share, "holds_back": state.holds_back})
        opened.write_arrays(f"{schema.SERIES}/unknowns", by_subdomain)

    return pack(measurement, flip_y=measurement.inputs.case.output.flip_y, add=add)


def _note_failure(team: Team, error: DdicError, record: FrameRecord, folder: SeriesFolder) -> None:
    """Note that a frame could not be measured, and keep its last field; collective.

    What the error brings is written as the result of a pair that did not converge.
    """
    last = error.last if isinstance(error, ConvergenceError) else None
    if isinstance(last, Publishable):
        path = schema.not_converged_path(folder.result.with_suffix(f".{record.number:06d}{folder.result.suffix}"))
        try:
            publish(last, path, flip_y=last.inputs.case.output.flip_y)
        except (OSError, DdicError) as second:
            # That the frame failed is told first; this comes of it.
            if not is_collective(second):
                raise
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
