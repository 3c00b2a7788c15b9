"""A discontinuity found in the images: a continuous measurement, a Radon transform of its strain, a line refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ddic.case.schema import Case, DiscontinuitySection
from ddic.errors import ConvergenceError, StoppedError, as_collective
from ddic.methods.dd_dic import Session
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.cameras import Frame
from ddic.problem.cut_region import refuse_kinematics
from ddic.problem.inputs import Inputs
from ddic.results.listener import Listener, WithoutNotes
from ddic.results.whole_field import gather_displacement

RMS_PX, LARGEST_PX = 0.01, 1.0
"""Correction at which the continuous measurement is exact enough to look for a line in it: its elements on the line
waver by more."""


def is_line_wanted(case: Case) -> bool:
    """Tell whether a case asks for a line to be found.

    Parameters
    ----------
    case : Case
        With its discontinuities.

    Returns
    -------
    bool
        Whether one has no vertices.
    """
    return any(section.vertices is None for section in case.discontinuity)


def find_discontinuity(team: Team, inputs: Inputs, frame: Frame, listener: Listener, clock: PhaseClock) -> Inputs:
    """Find the line that a case asks for; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        Reference image, mesh and settings.
    frame : Frame
        The deformed image.
    listener : Listener
        Told what happens.
    clock : PhaseClock
        Of the phases.

    Returns
    -------
    Inputs
        With the line, or without discontinuities where none is found; the same where the case asks for none.

    Raises
    ------
    InputError, SingularSubdomainError, ConvergenceError
        On all ranks.
    """
    case = inputs.case
    if not is_line_wanted(case):
        return inputs
    from ddic.detection.line_of_case import find_line_of_case

    team.together(lambda: refuse_kinematics(inputs))
    listener.note("detection: continuous elements first")
    continuous = replace(inputs, case=_measure_continuously(case))
    with Session(team, continuous, WithoutNotes(listener), clock, frame) as session:
        try:
            measurement = session.measure(frame)
        except StoppedError:
            raise
        except ConvergenceError as error:
            raise as_collective(ConvergenceError("detection: the continuous field in which a line is looked for does "
                                                 f"not converge; give discontinuity.vertices ({error})",
                                                 error.last)) from error
    with clock.phase(Phase.START):
        displacement = gather_displacement(measurement)
        found = team.on_root(lambda: find_line_of_case(inputs, frame, require_held(displacement)))
    sections: Sequence[DiscontinuitySection] = ()
    if found.line is not None:
        sections = [case.discontinuity[0].model_copy(update={"vertices": tuple(map(tuple, found.line.tolist()))})]
    return replace(inputs, case=case.model_copy(update={"discontinuity": tuple(sections)}),
                   notes=(*inputs.notes, found.note))


def _measure_continuously(case: Case) -> Case:
    """The case without discontinuities, to a looser tolerance."""
    section = case.gauss_newton
    loose = {"rms_tolerance": max(section.rms_tolerance, RMS_PX),
             "largest_tolerance": max(section.largest_tolerance, LARGEST_PX)}
    return case.model_copy(update={"discontinuity": (), "gauss_newton": section.model_copy(update=loose)})
