"""When a frame of a series becomes the reference image of those that follow."""

from __future__ import annotations

from collections.abc import Sequence

from ddic.errors import DdicError, is_collective
from ddic.methods.frames_so_far import FramesSoFar
from ddic.methods.measure_frame import MeasuredFrame, measure_frame
from ddic.methods.reference_session import ReferenceSession
from ddic.results.series import FrameRecord

RESIDUAL_GROWTH = 1.5
"""Residual of a frame over that of the first one with the same reference image, from which on ``auto`` updates it: a
third of the residual is then light and speckle that have changed. A larger value updates later."""


def measure_with_updates(so_far: FramesSoFar, number: int) -> tuple[MeasuredFrame, ReferenceSession]:
    """Measure a frame, with the last one that was measured as its reference image where that is due; collective.

    Parameters
    ----------
    so_far : FramesSoFar
        What it goes on from.
    number : int
        From 1.

    Returns
    -------
    frame : MeasuredFrame
        Measured or not.
    session : ReferenceSession
        That measured it; where it is another one the caller has to close one of them.
    """
    session = so_far.session
    section, last = session.images.opener.inputs.case.series, so_far.find_last_measured()
    can_update = last is not None and last.number != session.frame
    if can_update and section.incremental == "always" and number - session.frame > section.update_after:
        updated = _update(so_far, last)
        if updated is not None:
            return measure_frame(updated, number, updated.restrict_states(session, so_far.states)), updated
    frame = measure_frame(session, number, so_far.states)
    if can_update and section.incremental == "auto" and _asks_for_update(frame.record, so_far.records):
        updated = _update(so_far, last)
        if updated is not None:
            again = measure_frame(updated, number, updated.restrict_states(session, so_far.states))
            if _is_better(again.record, frame.record):
                return again, updated
            updated.close()
    return frame, frame.session


def _update(so_far: FramesSoFar, last: FrameRecord | None) -> ReferenceSession | None:
    """A session that compares with the last frame that was measured; None where that cannot be prepared; collective."""
    session = so_far.session
    listener = session.images.listener
    if last is None:
        return None
    try:
        updated = session.update(last, so_far.states[-1])
    except DdicError as error:
        if not is_collective(error):
            raise
        listener.note(f"frame {last.number} cannot be the reference image: {error}")
        return None
    listener.note(f"frame {last.number} is the reference image from here on; its error adds up to those that follow")
    return updated


def _asks_for_update(record: FrameRecord, records: Sequence[FrameRecord]) -> bool:
    """Whether a frame was not measured, or its residual has grown."""
    compared = [other.residual_std_grey for other in records if other.converged and other.reference == record.reference]
    if not record.converged:
        return True
    return bool(compared) and record.residual_std_grey > RESIDUAL_GROWTH * compared[0]


def _is_better(again: FrameRecord, before: FrameRecord) -> bool:
    if not (again.converged and before.converged):
        return again.converged
    return again.residual_std_grey < before.residual_std_grey
