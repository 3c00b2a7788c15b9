"""FE-DIC and R-DIC, the method of cases that ask for no other one, with lines that the images tell or correct."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from ddic.case.schema import Case, GaussNewtonSection, RegularizationSection
from ddic.check.case import check_on_mesh
from ddic.check.ranks import check_ranks_of_subdomains
from ddic.errors import ConvergenceError, SingularSubdomainError, StoppedError, as_collective, is_collective
from ddic.images.window import Window
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import build_meshes
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_cell_size
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.method import MethodSession
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team, require_held
from ddic.problem.region_mesh import refuse_kinematics
from ddic.results.listener import Listener, WithoutNotes, note_all
from ddic.results.measurement import Measurement, gather_displacement
from ddic.start.frame_start import KnownStart

if TYPE_CHECKING:
    from ddic.detection.find_lines import Detection
    from ddic.detection.lines_of_case import Refinement

RMS_PX, LARGEST_PX = 0.01, 1.0
"""Correction at which the continuous measurement is exact enough to look for a line in it: its elements on the line
waver by more."""

ROUGH_CUT_OFF = 4.0
"""Cut-off wavelength, elements, of a field in which lines are refined where they are so far off that none is found with
them: what is on the wrong side of one drags its nodes along without mechanics."""


def is_line_wanted(case: Case) -> bool:
    """Tell whether a case asks for a line to be found: whether one of its discontinuities has no vertices."""
    return any(section.vertices is None for section in case.discontinuity)


def _may_be_off(case: Case) -> bool:
    return any(section.may_be_off for section in case.discontinuity)


class _FiniteElements:
    """Displacements of the nodes of a mesh, with jumps across lines; a ``Method``."""

    check_ranks = staticmethod(check_ranks_of_subdomains)
    check = staticmethod(check_on_mesh)

    def build_result_mesh(self, case: Case, extent: Window) -> Mesh:
        """Build the mesh of the case."""
        return build_meshes(case, extent)[0]

    def prepare(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                first_frame: Frame | None = None) -> MethodSession:
        """Prepare M, factors and coarse space."""
        session = _LineSession if is_line_wanted(inputs.case) or _may_be_off(inputs.case) else DecomposedSession
        return session(team, inputs, listener, clock, first_frame)


METHOD = _FiniteElements()


def find_discontinuities(team: Team, inputs: Inputs, frame: Frame, listener: Listener,
                         clock: PhaseClock) -> tuple[Inputs, Detection]:
    """Find the lines that a case asks for; collective.

    Returns inputs with them, or without discontinuities where none is found, and what was seen. Raises InputError,
    SingularSubdomainError or ConvergenceError on all ranks.
    """
    from ddic.detection.find_lines import find_lines_of_case

    case = inputs.case

    team.together(lambda: refuse_kinematics(inputs))
    listener.note("detection: continuous elements first")
    continuous = case.model_copy(update={"discontinuity": (), "gauss_newton": _loosen(case.gauss_newton)})
    with DecomposedSession(team, replace(inputs, case=continuous), WithoutNotes(listener), clock, frame) as session:
        try:
            measurement = session.measure(frame)
        except StoppedError:
            raise
        except ConvergenceError as error:
            raise as_collective(ConvergenceError("detection: the continuous field in which lines are looked for does "
                                                 f"not converge; give discontinuity.vertices ({error})",
                                                 error.last)) from error
    with clock.phase(Phase.START):
        displacement = gather_displacement(measurement)
        found = team.on_root(lambda: find_lines_of_case(inputs, frame, require_held(displacement)))
    section = case.discontinuity[0]
    sections = tuple(section.model_copy(update={"vertices": tuple(map(tuple, line.tolist()))}) for line in found.lines)
    with_lines = replace(inputs, case=case.model_copy(update={"discontinuity": sections}),
                         notes=(*inputs.notes, found.note))
    return with_lines, found


def _loosen(section: GaussNewtonSection) -> GaussNewtonSection:
    """Tolerances of a field in which lines are sought."""
    return section.model_copy(update={"rms_tolerance": max(section.rms_tolerance, RMS_PX),
                                      "largest_tolerance": max(section.largest_tolerance, LARGEST_PX)})


class _LineSession(MethodSession):
    """A measurement with lines that the images correct: looked for in a frame, or refined in any.

    Where a line is to be found, it is prepared when a frame shows it; until then each frame is measured without. A
    first frame is given where it is known already, and no other one will be measured. Else as ``DecomposedSession``.
    """

    def __init__(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                 first_frame: Frame | None = None) -> None:
        self._team, self._listener, self._clock = team, listener, clock
        self._only_frame = first_frame
        # With the lines as the frames so far have corrected them.
        self._inputs = inputs
        self._session: DecomposedSession | None = None
        if not is_line_wanted(inputs.case):
            self._session = self._prepare(inputs)

    def _prepare(self, inputs: Inputs) -> DecomposedSession:
        stop_if_asked(self._team, "before the first iteration")
        return DecomposedSession(self._team, inputs, self._listener, self._clock, self._only_frame)

    @property
    def n_assembled(self) -> int:
        """Times that this rank assembled M of a subdomain, with the lines as they are."""
        return 0 if self._session is None else self._session.n_assembled

    @property
    def n_factorized(self) -> int:
        """Operators that this rank factorised, with the lines as they are."""
        return 0 if self._session is None else self._session.n_factorized

    def measure(self, frame: Frame, start: KnownStart | None = None) -> Measurement:
        """Measure a frame, and once more where the residual says that lines are off their places; collective.

        As ``DecomposedSession.measure``. Lines that are corrected stay so for the frames that follow.
        """
        session, seen = self._find_session(frame)
        measured = measure_and_look(lambda: session.measure(frame, start), self._team, session.inputs, frame,
                                    self._listener, self._clock)
        if not isinstance(measured, Measurement):
            self.close()
            self._inputs = measured
            self._session = self._prepare(measured)
            measured = self._session.measure(frame, start)
        return measured if seen is None else replace(measured, detection=seen)

    def _find_session(self, frame: Frame) -> tuple[DecomposedSession, Detection | None]:
        """The session at hand, or one with the lines that a frame shows and what was seen in it; collective."""
        if self._session is not None and not is_line_wanted(self._inputs.case):
            return self._session, None
        self.close()
        found, seen = find_discontinuities(self._team, self._inputs, frame, self._listener, self._clock)
        if found.case.discontinuity:
            self._inputs = found
        self._session = self._prepare(found)
        return self._session, seen

    def estimate_noise_floor(self, measured: Measurement) -> float:
        """Estimate what noise leaves in what was measured last, as ``DecomposedSession`` does; collective."""
        return require_held(self._session).estimate_noise_floor(measured)

    def close(self) -> None:
        """Free PETSc's objects."""
        if self._session is not None:
            self._session.close()
        self._session = None


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
            note_all(listener, () if roughly is None else roughly.notes)
            raise
        found = roughly
    note_all(listener, found.notes)
    if not found.is_any:
        return measurement.with_notes(found.notes)
    return replace(inputs, case=inputs.case.model_copy(update={"discontinuity": found.sections}),
                   notes=(*inputs.notes, *found.notes))


def _refine_lines(inputs: Inputs, measurement: Measurement, frame: Frame, clock: PhaseClock) -> Refinement:
    """Lines and tips where the residual says that they lie; collective."""
    from ddic.detection.lines_of_case import refine_lines_of_case

    with clock.phase(Phase.START):
        displacement = gather_displacement(measurement)
        return measurement.team.on_root(lambda: refine_lines_of_case(inputs, frame, require_held(displacement)))


def _refine_lines_roughly(team: Team, inputs: Inputs, frame: Frame, listener: Listener,
                          clock: PhaseClock) -> Refinement | None:
    """The same where no field is found with the lines as they are, from one that mechanics hold, if any; collective."""
    listener.note("no field is found with the discontinuities where they are given; whether they are off is looked for")
    case = inputs.case
    size = team.on_root(lambda: measure_cell_size(inputs.build_mesh()[0]))
    held = case.regularization or RegularizationSection(cut_off_wavelength=ROUGH_CUT_OFF * size)
    correlation = case.correlation.model_copy(update={"spoilt_pixels": "keep"})
    rough = case.model_copy(update={"correlation": correlation, "regularization": held,
                                    "gauss_newton": _loosen(case.gauss_newton)})
    try:
        with DecomposedSession(team, replace(inputs, case=rough), WithoutNotes(listener), clock, frame) as session:
            return _refine_lines(inputs, session.measure(frame), frame, clock)
    except (SingularSubdomainError, ConvergenceError) as error:
        if isinstance(error, StoppedError) or not is_collective(error):
            raise
        return None
