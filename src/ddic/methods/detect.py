"""Discontinuities that the images correct: a line found in a continuous field, and lines that were given, refined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ddic.case.schema import Case, DiscontinuitySection, GaussNewtonSection, RegularizationSection
from ddic.errors import ConvergenceError, SingularSubdomainError, StoppedError, as_collective, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.mesh.quality import measure_cell_size
from ddic.methods.dd_dic import Session
from ddic.methods.recipe import Recipe
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.cut_region import refuse_kinematics
from ddic.results.listener import Listener, WithoutNotes
from ddic.results.measurement import Measurement, gather_displacement

if TYPE_CHECKING:
    from ddic.detection.line_of_case import Refinement
    from ddic.results.separated import SeparatedMeasurement

RMS_PX, LARGEST_PX = 0.01, 1.0
"""Correction at which the continuous measurement is exact enough to look for a line in it: its elements on the line
waver by more."""

ROUGH_CUT_OFF = 4.0
"""Cut-off wavelength, elements, of a field in which lines are refined where they are so far off that none is found with
them: what is on the wrong side of one drags its nodes along without mechanics."""


def is_line_wanted(case: Case) -> bool:
    """Tell whether a case asks for a line to be found: whether one of its discontinuities has no vertices."""
    return any(section.vertices is None for section in case.discontinuity)


def find_discontinuity(team: Team, inputs: Inputs, frame: Frame, listener: Listener, clock: PhaseClock) -> Inputs:
    """Find the line that a case asks for; collective.

    Returns inputs with the line, or without discontinuities where none is found; the same where the case asks for none.
    Raises InputError, SingularSubdomainError or ConvergenceError on all ranks.
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
    return case.model_copy(update={"discontinuity": (), "gauss_newton": _loosen(case.gauss_newton)})


def _loosen(section: GaussNewtonSection) -> GaussNewtonSection:
    """Tolerances of a field in which lines are sought."""
    return section.model_copy(update={"rms_tolerance": max(section.rms_tolerance, RMS_PX),
                                      "largest_tolerance": max(section.largest_tolerance, LARGEST_PX)})


def measure_on_lines(recipe: Recipe, inputs: Inputs, frame: Frame, start: Any, prepare: Callable[[Inputs], Recipe],
                     listener: Listener, clock: PhaseClock
                     ) -> tuple[Recipe, Inputs, Measurement | SeparatedMeasurement]:
    """Measure a frame, and once more where the residual says that lines are off their places; collective.

    The recipe was prepared of ``inputs``, with the lines as they are given; ``start`` is as ``Session.measure`` takes
    it. Returns the recipe, the inputs that it was prepared from, and what it measured: the same recipe, or one that
    ``prepare`` makes with refined lines, and the first one is closed then. Raises InputError, SingularSubdomainError or
    ConvergenceError on all ranks.
    """
    if not isinstance(recipe, Session):
        return recipe, inputs, recipe.measure(frame, start)
    measured = measure_and_look(lambda: recipe.measure(frame, start), recipe.problem.team, inputs, frame, listener,
                                clock)
    if isinstance(measured, Measurement):
        return recipe, inputs, measured
    recipe.close()
    again = prepare(measured)
    return again, measured, again.measure(frame, start)


def measure_and_look(measure: Callable[[], Measurement], team: Team, inputs: Inputs, frame: Frame, listener: Listener,
                     clock: PhaseClock) -> Measurement | Inputs:
    """Measure a frame, and look whether lines are off their places; collective.

    Returns what was measured; or inputs with refined lines, with which the frame is to be measured again: the listener
    is told how they were refined. ``inputs`` are those from which ``measure`` was prepared. Raises InputError,
    SingularSubdomainError or ConvergenceError on all ranks.
    """
    if not _may_be_off(inputs.case):
        return measure()
    try:
        measurement = measure()
        found = _refine_lines(inputs, measurement, frame, clock)
    except (SingularSubdomainError, ConvergenceError) as error:
        if isinstance(error, StoppedError) or not is_collective(error):
            raise
        roughly = _refine_lines_roughly(team, inputs, frame, listener, clock)
        if roughly is None or not roughly.is_any:
            _tell(listener, () if roughly is None else roughly.notes)
            raise
        found = roughly
    _tell(listener, found.notes)
    if not found.is_any:
        return add_notes(measurement, found.notes)
    return replace(inputs, case=inputs.case.model_copy(update={"discontinuity": found.sections}),
                   notes=(*inputs.notes, *found.notes))


def add_notes(measurement: Measurement, notes: Sequence[str]) -> Measurement:
    """Add notes to those of a measurement and of its result."""
    of_result = replace(measurement.inputs, notes=(*measurement.inputs.notes, *notes))
    return replace(measurement, inputs=of_result, notes=(*measurement.notes, *notes))


def _may_be_off(case: Case) -> bool:
    return any(section.vertices is not None and section.uncertainty > 0 for section in case.discontinuity)


def _tell(listener: Listener, notes: Sequence[str]) -> None:
    for note in notes:
        listener.note(note)


def _refine_lines(inputs: Inputs, measurement: Measurement, frame: Frame, clock: PhaseClock) -> Refinement:
    """Lines and tips where the residual says that they lie; collective."""
    from ddic.detection.line_of_case import refine_lines_of_case

    with clock.phase(Phase.START):
        displacement = gather_displacement(measurement)
        return measurement.team.on_root(lambda: refine_lines_of_case(inputs, frame, require_held(displacement)))


def _refine_lines_roughly(team: Team, inputs: Inputs, frame: Frame, listener: Listener,
                          clock: PhaseClock) -> Refinement | None:
    """The same where no field is found with the lines as they are: from one that mechanics hold; collective.

    None where there is no such field either.
    """
    listener.note("no field is found with the discontinuities where they are given; whether they are off is looked for")
    case = inputs.case
    size = team.on_root(lambda: measure_cell_size(inputs.build_mesh()[0]))
    held = case.regularization or RegularizationSection(cut_off_wavelength=ROUGH_CUT_OFF * size)
    correlation = case.correlation.model_copy(update={"spoilt_pixels": "keep"})
    rough = case.model_copy(update={"correlation": correlation, "regularization": held,
                                    "gauss_newton": _loosen(case.gauss_newton)})
    try:
        with Session(team, replace(inputs, case=rough), WithoutNotes(listener), clock, frame) as session:
            return _refine_lines(inputs, session.measure(frame), frame, clock)
    except (SingularSubdomainError, ConvergenceError) as error:
        if isinstance(error, StoppedError) or not is_collective(error):
            raise
        return None
