"""The recipe that a case asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.methods.dd_dic import Session
from ddic.parallel.phases import PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.results.listener import Listener

if TYPE_CHECKING:
    from ddic.methods.pgd_dic import SeparatedSession

Recipe: TypeAlias = "Session | SeparatedSession"
"""A prepared measurement."""


def prepare_recipe(team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                   first_frame: Frame | None = None) -> Recipe:
    """Prepare the reference images as the case's method does; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        Reference images, mesh and settings.
    listener : Listener
        Told what happens.
    clock : PhaseClock
        Of the phases.
    first_frame : Frame, optional
        Where it is known already.

    Returns
    -------
    Session or SeparatedSession
        PGD-DIC where the case has [pgd].

    Raises
    ------
    InputError, SingularSubdomainError, FactorizationError
        On all ranks.
    StoppedError
        On all ranks, where a signal asked one of them to stop.
    """
    stop_if_asked(team, "before the first iteration")
    if inputs.case.pgd is not None:
        from ddic.methods.pgd_dic import SeparatedSession

        return SeparatedSession(team, inputs, listener, clock)
    return Session(team, inputs, listener, clock, first_frame)
