"""Where a frame of a series starts: from what frames before it extrapolate to, or from a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, SingularSubdomainError, is_collective
from ddic.inputs.cameras import Frame
from ddic.methods.dd_dic import Session
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement
from ddic.results.series import MeasuredState, extrapolate

SEARCH = "a search"
"""Name of a start that nothing is known of."""

LEAST_SHOWN = 0.8
"""Share of the cells that the last frame showed which a start must show, else it is searched for: Gauss-Newton takes
long, or does not find its way, from other speckle. A larger share searches more often."""


@dataclass(frozen=True)
class KnownFrameStart:
    """What earlier frames say of where a frame starts.

    Attributes
    ----------
    name : str
        For the log.
    q : list of (n_unknowns,) array
        Unknowns of owned subdomains since the first reference image.
    least_shown : float
        Share of the cells that it must show.
    """

    name: str
    q: list[NDArray[np.float64]]
    least_shown: float


def choose_known_start(wanted: str, states: Sequence[MeasuredState], time: float) -> KnownFrameStart | None:
    """Choose what a frame starts from of those before it.

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
    KnownFrameStart or None
        None where it is to be searched for.
    """
    # A field that mechanics hold off what its frame showed would take what it sees for something else.
    if wanted == "search" or not states or states[-1].holds_back:
        return None
    last, least_shown = states[-1], LEAST_SHOWN * states[-1].shown_share
    if wanted == "extrapolate" and len(states) > 1:
        return KnownFrameStart("the last two frames", extrapolate(states[-2], last, time), least_shown)
    return KnownFrameStart("the last frame", last.q, least_shown)


def measure_from(session: Session, frame: Frame, known: KnownFrameStart | None,
                 listener: Listener) -> tuple[Measurement, str]:
    """Measure a frame from a known start, or from a search where that leads nowhere; collective.

    Parameters
    ----------
    session : Session
        Prepared; what earlier frames changed of its operators is forgotten.
    frame : Frame
        One deformed image of each camera.
    known : KnownFrameStart or None
        None: it is searched for.
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
        On all ranks, where the search does not converge either.
    """
    if known is not None:
        session.begin_anew()
        try:
            start = session.problem.reference.convert_to_reference(known.q)
            return session.measure(frame, start, known.least_shown), known.name
        except (ConvergenceError, SingularSubdomainError) as error:
            if not is_collective(error):
                raise
            listener.note(f"from {known.name}: {error}; it is searched for")
    session.begin_anew()
    return session.measure(frame), SEARCH
