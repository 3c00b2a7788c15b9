"""FE-DIC and R-DIC by dual domain decomposition: the algorithm box of [BP17], for any number of cameras and frames.

``prepare`` does what the reference images alone determine; ``Session.measure`` measures a frame.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.cameras import Frame
from ddic.problem.inputs import Inputs
from ddic.problem.reference_problem import build_whole_mesh, prepare_reference
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import open_frame_views
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement, finish_measurement
from ddic.results.problem_size import measure_problem_size
from ddic.solvers.gauss_newton import Progress, Tolerances, gauss_newton
from ddic.start.coarse_field import prepare_search
from ddic.start.frame_start import FrameStart, find_start


class Session:
    """A prepared measurement, for any number of frames; use it in a ``with`` statement, which frees PETSc's objects.

    M, the partition, the factors and the coarse space come from the reference images. Where a frame hides more than a
    share of a subdomain's pixels, that subdomain's M and factor are renewed, and the log says so.
    """

    def __init__(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                 first_frame: Frame | None = None) -> None:
        """Prepare; collective.

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
            Where it is known already, its coarse field is sought while rank 0 splits the mesh.

        Raises
        ------
        InputError, SingularSubdomainError, FactorizationError
            On all ranks.
        """
        self._team, self._inputs, self._listener, self._clock = team, inputs, listener, clock
        with clock.phase(Phase.MESH):
            region_mesh = build_whole_mesh(team, inputs)
        with clock.phase(Phase.START):
            meshes = None if region_mesh is None else [cells.seen for cells in region_mesh.measured]
            self._search = prepare_search(team, inputs.cameras, inputs.case.start,
                                          inputs.case.correlation.grey_correction, meshes)
            is_sought = first_frame is not None and inputs.case.start.from_result is None
            meanwhile = self._search.prepare(first_frame) if is_sought and first_frame is not None else lambda: None
        self.reference, found = prepare_reference(team, inputs, region_mesh, clock, meanwhile)
        self._found_first = self._search.share(found) if is_sought else None
        self._problem = WeightedProblem(team, self.reference, clock)
        for line in self.reference.notes:
            listener.note(line)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    @property
    def problem(self) -> WeightedProblem:
        """The systems, weighted and factorised, and how often."""
        return self._problem

    def measure(self, frame: Frame, start: Measurement | None = None) -> Measurement:
        """Measure the displacement between the reference images and a frame; collective.

        Parameters
        ----------
        frame : Frame
            One deformed image of each camera.
        start : Measurement, optional
            Of an earlier frame of this session, to start from; by default as the case says.

        Returns
        -------
        Measurement
            Spread over ranks.

        Raises
        ------
        InputError, SingularSubdomainError, ConvergenceError
            On all ranks; the session can measure other frames afterwards.
        """
        inputs, clock, problem = self._inputs, self._clock, self._problem
        views = open_frame_views(inputs.case, frame, self.reference.references)
        found, self._found_first = self._found_first, None
        begun = find_start(FrameStart(self._team, self._search, problem, clock), frame, views, found, _unknowns(start))
        for line in begun.notes:
            self._listener.note(line)
        views = problem.weigh(views)
        with clock.phase(Phase.ASSEMBLE):
            renewal = problem.renew(views, begun.q)
        if renewal:
            self._listener.note(renewal)
        correction = inputs.case.correlation.grey_correction
        model = ResidualModel(self._team, views, correction, len(inputs.cameras))
        size = measure_problem_size(problem)
        self._listener.problem_size(size)
        progress = Progress(clock, self._listener.iteration)
        solution = gauss_newton(model, begun.q, problem.solver.step, _tolerances(inputs.case), progress)
        with clock.phase(Phase.FINISH):
            notes = (*self.reference.notes, *begun.notes, *([renewal] if renewal else []))
            return finish_measurement(problem, model, frame, solution, (size, notes))

    def close(self) -> None:
        """Free PETSc's objects."""
        self._problem.destroy()


def _tolerances(case: Case) -> Tolerances:
    section = case.gauss_newton
    return Tolerances(section.tolerance, section.rms_tolerance, section.max_iterations, case.solver.inexact)


def _unknowns(start: Measurement | None) -> list[NDArray[np.float64]] | None:
    return None if start is None else start.q
