"""A series of deformed images measured from one reference image; what is finished is never lost.

Each frame is started from those before it; one that cannot be measured does not stop the others.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace

from ddic.case.loader import LoadedCase
from ddic.case.named_files import list_deformed
from ddic.errors import ConvergenceError, StoppedError, as_collective
from ddic.io.series_folder import BackgroundWriter, ReadAhead, SeriesFolder
from ddic.methods.reference_session import ReferenceSession
from ddic.methods.series_frame import FramesSoFar, keep_frame, measure_with_updates
from ddic.parallel.stop_request import StopRequest, is_stop_asked
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.series import N_STATES, FrameRecord, SeriesSummary, collect_states
from ddic.results.series_images import (
    FramesToMeasure,
    SeriesImages,
    describe_origin,
    finish_series,
    list_frames_to_measure,
    open_series,
)


def measure_frames(images: SeriesImages, wanted: FramesToMeasure) -> list[FrameRecord]:
    """Measure what is left of a series, or what of it a signal leaves time for; collective.

    Returns the record of each frame, the same on all ranks. Raises InputError, SingularSubdomainError,
    FactorizationError or OSError on all ranks, where nothing can be prepared, or no frame can be written.
    """
    team, opener, listener = images.team, images.opener, images.listener
    # A frame that has begun is finished: no signal ends it.
    images = replace(images, team=replace(team, stop=StopRequest()))
    with ExitStack() as stack:
        reader, writer = stack.enter_context(ReadAhead()), stack.enter_context(BackgroundWriter())
        so_far = _begin(images, wanted)
        try:
            for number in wanted.numbers:
                if team.is_root:
                    reader.begin(opener.list_files(number + 1))
                listener.frame(number, opener.n_frames, opener.describe(number))
                frame, session = measure_with_updates(so_far, number)
                state = keep_frame(team, frame, wanted.folder, writer)
                so_far = so_far.add(session, frame.record, state)
                listener.note(frame.record.describe())
                if is_stop_asked(team):
                    break
        finally:
            so_far.session.close()
        team.on_root(writer.wait)
    return list(so_far.records[len(wanted.before):])


def _begin(images: SeriesImages, wanted: FramesToMeasure) -> FramesSoFar:
    """Prepare the session that an earlier run was at, or a new one; collective."""
    measured = [record for record in wanted.before if record.converged]
    lines = measured[-1].lines if measured else ()
    session = ReferenceSession.prepare(images, lines, None if measured else images.opener.first)
    problem = session.session.problem
    # Fields on a mesh that other lines cut do not help.
    known = [record.number for record in measured[-N_STATES:] if record.lines == lines]
    states = collect_states(problem, [wanted.states[number] for number in known])
    so_far = FramesSoFar(session, wanted.before, states)
    if not states or not measured[-1].reference:
        return so_far
    reference = next(record for record in measured if record.number == measured[-1].reference)
    updated = session.update(reference, *collect_states(problem, [wanted.states[reference.number]]))
    states = updated.restrict_states(session, states)
    session.close()
    return FramesSoFar(updated, wanted.before, states)


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
    origin = describe_origin(loaded)
    texts = team.on_root(lambda: folder.begin(origin, resume=resume))
    before = {number: FrameRecord.from_json(text) for number, text in texts.items()}
    records = [*before.values(), *_measure_rest(team, loaded, folder, before, listener)]
    records.sort(key=lambda record: record.number)
    summary = SeriesSummary(records, n_frames, str(file), time.perf_counter() - began, len(before),
                            {"path": str(loaded.path), "toml": loaded.text})
    team.on_root(lambda: finish_series(folder, summary, origin))
    if not summary.is_whole:
        raise as_collective(StoppedError(_describe_stop(summary)))
    if summary.failures:
        raise as_collective(ConvergenceError(_describe_failures(summary)))
    return summary


def _measure_rest(team: Team, loaded: LoadedCase, folder: SeriesFolder, before: Mapping[int, FrameRecord],
                  listener: Listener) -> Sequence[FrameRecord]:
    """Measure the frames that are not finished; collective."""
    wanted = list_frames_to_measure(team, folder, before)
    if not wanted.numbers:
        return []
    images = open_series(team, loaded, wanted.numbers[0], listener)
    return measure_frames(images, wanted)


def _describe_stop(summary: SeriesSummary) -> str:
    tried = len(summary.frames)
    return (f"stopped by a signal after {tried} of {summary.n_frames} frames, of which {tried - len(summary.failures)} "
            f"are in {summary.result_file or 'no file'}; ddic run --resume measures the rest")


def _describe_failures(summary: SeriesSummary) -> str:
    failures = summary.failures
    reasons = "; ".join(frame.describe() for frame in failures)
    kept = "" if len(failures) == len(summary.frames) else f"; the others are in {summary.result_file}"
    return f"{len(failures)} of {summary.n_frames} frames could not be measured: {reasons}{kept}"
