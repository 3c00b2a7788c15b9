"""What the frames of a series are opened, told and timed with."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.case.loader import LoadedCase
from ddic.inputs.inputs import FrameOpener, inputs_kept, open_inputs
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Listener


@dataclass(frozen=True)
class SeriesImages:
    """What frames are opened, told and timed with.

    Attributes
    ----------
    team : Team
        All ranks.
    opener : FrameOpener
        Of the images.
    listener : Listener
        Told what happens.
    clock : PhaseClock
        Of the phases.
    """

    team: Team
    opener: FrameOpener
    listener: Listener
    clock: PhaseClock


def open_series(team: Team, loaded: LoadedCase, number: int, listener: Listener) -> SeriesImages:
    """Open the reference images of a series, and its first frame; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    loaded : LoadedCase
        Checked, with several deformed images.
    number : int
        Of the first frame that is to be measured, from 1.
    listener : Listener
        Told what happens.

    Returns
    -------
    SeriesImages
        With a clock that has begun.

    Raises
    ------
    InputError
        On all ranks, where an image cannot be read.
    """
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    with inputs_kept(team, loaded.stamps), clock.phase(Phase.MESH):
        inputs, first = open_inputs(team, loaded, number - 1)
    return SeriesImages(team, FrameOpener(team, inputs, number, first, loaded.stamps), listener, clock)
