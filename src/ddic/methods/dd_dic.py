"""FE-DIC and R-DIC by dual domain decomposition: the algorithm box of [BP17], for any number of cameras and frames."""

from __future__ import annotations

from typing import Self

from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.methods.solve_frame import solve_frame
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.reference_problem import build_whole_mesh, prepare_reference
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement, finish_measurement, last_field_kept
from ddic.start.coarse_field import prepare_search
from ddic.start.frame_start import FrameStart, KnownStart, find_start


class Session:
    """A prepared measurement, for any number of frames; use it in a ``with`` statement, which frees PETSc's objects.

    M, the partition, the factors and the coarse space come from the reference images. Where a frame hides more than a
    share of a subdomain's pixels, that subdomain's M and factor are renewed, and the log says so.

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

    Attributes
    ----------
    problem : WeightedProblem
        The systems, weighted and factorised, and how often.

    Raises
    ------
    InputError, SingularSubdomainError, FactorizationError
        On all ranks.
    """

    def __init__(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                 first_frame: Frame | None = None) -> None:
        self._listener, self._clock = listener, clock
        self._first_frame = first_frame
        with clock.phase(Phase.MESH):
            region_mesh = build_whole_mesh(team, inputs)
        with clock.phase(Phase.START):
            measured = None if region_mesh is None else region_mesh.measured
            search = prepare_search(team, inputs, measured)
            begin_search = search.prepare(first_frame)
        reference, found = prepare_reference(team, inputs, region_mesh, clock, begin_search)
        self._found_first = search.share(found)
        self._tell(reference.notes)
        self.problem = WeightedProblem(team, reference, clock, factorize_now=first_frame is None)
        self._start = FrameStart(team, search, self.problem, clock)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin_anew(self) -> None:
        """Forget what earlier frames have changed of the operators; collective."""
        self.problem.begin_anew()

    def measure(self, frame: Frame, start: KnownStart | None = None, least_shown: float = 0.0) -> Measurement:
        """Measure the displacement between the reference images and a frame; collective.

        Parameters
        ----------
        frame : Frame
            One deformed image of each camera.
        start : sequence of (n_unknowns,) array, EarlierResult or StartPoints, optional
            Unknowns of each owned subdomain to start from, or a displacement to go on from; else as the case says.
        least_shown : float, optional
            Share of the cells that the start must show; any by default.

        Returns
        -------
        Measurement
            Spread over ranks.

        Raises
        ------
        InputError, SingularSubdomainError, ConvergenceError
            On all ranks, the last with the last field; the session can measure other frames afterwards.
        """
        problem, first_found = self.problem, None
        if frame is self._first_frame:
            first_found, self._first_frame = self._found_first, None
        views = problem.open_frame(frame)
        started = find_start(self._start, frame, views, first_found, start)
        model = problem.build_residual_model(views)
        self._tell(started.notes)
        notes = (*problem.reference.notes, *started.notes)
        with last_field_kept(self._clock, lambda *last: finish_measurement(problem, frame, notes, *last)):
            solved = solve_frame(problem, model, started.q, self._listener, self._clock, least_shown)
        with self._clock.phase(Phase.FINISH):
            measurement = finish_measurement(problem, frame, notes, solved)
        self._tell(measurement.notes[len(notes) + len(solved.notes):])
        return measurement

    def _tell(self, notes: tuple[str, ...]) -> None:
        for line in notes:
            self._listener.note(line)

    def close(self) -> None:
        """Free PETSc's objects."""
        self.problem.destroy()
