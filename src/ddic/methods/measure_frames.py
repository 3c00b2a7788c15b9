"""The frames of a series, each started from those before it; one that cannot be measured does not stop the others."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

from ddic.io.series_folder import BackgroundWriter, ReadAhead
from ddic.methods.frames_so_far import FramesSoFar
from ddic.methods.measure_frame import keep_frame
from ddic.methods.reference_session import ReferenceSession
from ddic.methods.reference_updates import measure_with_updates
from ddic.parallel.stop_request import StopRequest, is_stop_asked
from ddic.results.series import N_STATES, FrameRecord, collect_states
from ddic.results.series_images import FramesToMeasure, SeriesImages


def measure_frames(images: SeriesImages, wanted: FramesToMeasure) -> list[FrameRecord]:
    """Measure what is left of a series, or what of it a signal leaves time for; collective.

    Parameters
    ----------
    images : SeriesImages
        Of the series.
    wanted : FramesToMeasure
        Which.

    Returns
    -------
    list of FrameRecord
        Of each; the same on all ranks.

    Raises
    ------
    InputError, SingularSubdomainError, FactorizationError, OSError
        On all ranks, where nothing can be prepared, or no frame can be written.
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
