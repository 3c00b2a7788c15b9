"""Where a frame of a series starts: from what frames before it extrapolate to, or from a search."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, SingularSubdomainError, is_collective
from ddic.methods.dd_dic import Session
from ddic.problem.cameras import Frame
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement
from ddic.results.series_frames import MeasuredState, extrapolate

Starts = Sequence[tuple[str, list[NDArray[np.float64]] | None]]
"""Names of starts, and their unknowns; None for a search."""


def list_starts(wanted: str, states: Sequence[MeasuredState], time: float) -> Starts:
    """List where a frame may start, the best first.

    Parameters
    ----------
    wanted : str
        ``series.start`` of the case.
    states : sequence of MeasuredState
        The last frames that were measured, two at most.
    time : float
        Of the frame, unit chosen by the user.

    Returns
    -------
    sequence of (str, list of array or None)
        The search last.
    """
    return [*_list_known(wanted, states, time), ("a search", None)]


def _list_known(wanted: str, states: Sequence[MeasuredState],
                time: float) -> Iterator[tuple[str, list[NDArray[np.float64]]]]:
    if states and states[-1].holds_back:
        # Off what the frame showed, it would take what it sees for something else than the specimen.
        return
    if wanted == "extrapolate" and len(states) > 1:
        yield "the last two frames", extrapolate(states[-2], states[-1], time)
    elif wanted != "search" and states:
        yield "the last frame", states[-1].q


def measure_from(session: Session, frame: Frame, starts: Starts, least_shown: float,
                 listener: Listener) -> tuple[Measurement, str]:
    """Measure a frame from the first start that converges; collective.

    Parameters
    ----------
    session : Session
        Prepared; what earlier frames changed of its operators is forgotten.
    frame : Frame
        One deformed image of each camera.
    starts : sequence of (str, list of array or None)
        Of ``list_starts``.
    least_shown : float
        Share of the cells that a known start must show.
    listener : Listener
        Told what happens.

    Returns
    -------
    measurement : Measurement
        Spread over ranks.
    name : str
        Of the start.

    Raises
    ------
    InputError, ConvergenceError, SingularSubdomainError
        On all ranks, where none does: as the last one.
    """
    *others, (last_name, last) = starts
    for name, start in others:
        session.begin_anew()
        try:
            return session.measure(frame, start, least_shown), name
        except (ConvergenceError, SingularSubdomainError) as error:
            if not is_collective(error):
                raise
            listener.note(f"from {name}: {error}; it is searched for")
    session.begin_anew()
    return session.measure(frame, last), last_name
