"""FE-DIC and R-DIC by dual domain decomposition [BP17, Fig. 5], for any number of cameras and frames."""

from dataclasses import replace

from ddic.errors import ConvergenceError, as_collective, require_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.methods.method import MethodSession
from ddic.parallel.field import Field
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.reference_problem import build_whole_mesh, prepare_reference
from ddic.problem.residual_model import ResidualModel, read_frame_windows
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.closed_lines import describe_closed_lines
from ddic.results.listener import Listener, note_all
from ddic.results.measurement import Measurement, finish_measurement, last_field_kept
from ddic.solvers.gauss_newton import Progress
from ddic.solvers.probing import estimate_response
from ddic.start.coarse_field import prepare_search
from ddic.start.frame_start import FrameStart, KnownStart, find_start
from ddic.visibility.exclusions import exclude, pull_held_cells
from ddic.visibility.noise_forces import measure_force_noise
from ddic.visibility.solved_frame import (
    SETTLED,
    Looks,
    SeenFrame,
    SolvedFrame,
    accept_noise,
    begin_frame,
    see_solved_frame,
    see_start,
    solve_further,
)

MOST_LOOKS = 20
"""Times that a frame is looked at before it is given up."""


def solve_frame(problem: WeightedProblem, whole: ResidualModel, q: Field, listener: Listener,
                clock: PhaseClock, least_shown: float = 0.0) -> SolvedFrame:
    """Iterate from a start until neither the field nor what the frame shows of it changes; collective.

    The frame is looked at where the start puts it, where a field is roughly found, and where it is found; operators are
    renewed where it asks for it. ``whole`` is of all pixels that the frame shows, cameras weighted; ``q`` is the start;
    ``least_shown`` is the share of the cells that it must show, any by default.
    Raises ConvergenceError with the last SolvedFrame, SingularSubdomainError or FactorizationError, on all ranks.
    """
    with clock.phase(Phase.READ):
        whole.team.together(lambda: read_frame_windows(whole.views, q))
    with clock.phase(Phase.RESIDUAL):
        seen, of_blur = see_start(problem, whole, q)
    if (shown := seen.measure_shown_share()) < least_shown:
        raise as_collective(ConvergenceError(f"{shown:.0%} of the elements are seen where the start puts them"))
    model = seen.whole.with_large_gradients(q)
    is_regularized = problem.reference.inputs.case.regularization is not None
    # Most of what is excluded at a start is seen where a field is roughly found: M waits until then.
    model, notes = problem.fit(model if is_regularized else _use(model, seen, q), q)
    model, notes = _use(model, seen, q) if is_regularized else model, (*of_blur, *notes)
    note_all(listener, notes)
    listener.problem_size(problem.size)
    solved = begin_frame(seen, model, q, notes)
    looks = Looks(is_regularized=is_regularized)
    while looks.number < MOST_LOOKS:
        n_notes = len(solved.notes)
        solved = solve_further(problem, solved, Progress(clock, listener.iteration), roughly=looks.is_rough)
        note_all(listener, solved.notes[n_notes:])
        found = solved.solution
        is_paused = found.paused is not None
        with clock.phase(Phase.RESIDUAL):
            now = see_solved_frame(problem, solved, whole if looks.number == 0 else None)
        seen, is_seen_otherwise = looks.choose(solved.seen, now, solved.field.q, is_paused=is_paused)
        if not (found.converged or is_paused or is_seen_otherwise):
            if seen.typical[0].is_alike:
                found = accept_noise(problem, solved.used, found)
            if not found.converged:
                raise as_collective(ConvergenceError(found.stop, solved))
        # Where the start was far off, other pixels are hidden here.
        followed = model if model.follows else model.with_large_gradients(found.q)
        model, renewed = problem.fit(_use(followed, seen, solved.field.q), found.q)
        note_all(listener, renewed)
        solved = SolvedFrame(solved.field, replace(found, q=solved.field.q), seen, model, (*solved.notes, *renewed))
        # Later, operators that take turns change how fast a field is found, not which.
        is_renewed = bool(renewed) and looks.number < SETTLED
        if not (is_paused or is_seen_otherwise or is_renewed):
            listener.note(found.stop)
            return solved
    raise as_collective(ConvergenceError(
        f"what the frame shows, pixels or how far they turn, still changes after {MOST_LOOKS} looks at it; look at "
        "the masks and the start, or give a longer regularization.cut_off_wavelength", solved))


def _use(model: ResidualModel, seen: SeenFrame, q: Field) -> ResidualModel:
    """What Gauss-Newton goes on with from where the frame was seen."""
    whole = replace(model, views=seen.whole.views, correction=seen.whole.correction, blurs=seen.whole.blurs)
    used = pull_held_cells(exclude(whole, seen.excluded), seen.excluded, q)
    is_changed = seen.excluded.is_any(used.team) or used.pulled is not None
    return replace(used, known=None if is_changed else (q, seen.evaluation))


class DecomposedSession(MethodSession):
    """A measurement prepared on subdomains, for any number of frames; use it in a ``with`` statement.

    M, the partition, the factors and the coarse space come from the reference images. Where a frame hides more than a
    share of a subdomain's pixels, that subdomain's M and factor are renewed, and the log says so. Raises InputError,
    SingularSubdomainError or FactorizationError on all ranks.

    Parameters
    ----------
    team, inputs : Team, Inputs
        All ranks; reference images, mesh and settings.
    listener, clock : Listener, PhaseClock
        Told what happens; the clock of the phases.
    first_frame : Frame, optional
        Where it is known already, its coarse field is sought while rank 0 splits the mesh.

    Attributes
    ----------
    inputs : Inputs
        From which it was prepared.
    problem : WeightedProblem
        The systems, weighted and factorised, and how often.
    """

    def __init__(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                 first_frame: Frame | None = None) -> None:
        self.inputs = inputs
        self._listener, self._clock = listener, clock
        self._first_frame = first_frame
        with clock.phase(Phase.MESH):
            whole = build_whole_mesh(team, inputs)
        with clock.phase(Phase.START):
            measured = None if whole is None else whole.measured
            search = prepare_search(team, inputs, measured)
        reference, self._found_first = prepare_reference(team, inputs, whole, clock,
                                                         lambda split: search.find(first_frame, split))
        note_all(listener, reference.notes)
        self.problem = WeightedProblem(team, reference, clock, factorize_now=first_frame is None)
        self._start = FrameStart(search, self.problem, clock)

    @property
    def n_assembled(self) -> int:
        """Times that this rank assembled M of a subdomain."""
        return self.problem.n_assembled

    @property
    def n_factorized(self) -> int:
        """Operators that this rank factorised."""
        return self.problem.solver.n_factorized

    def begin_anew(self) -> None:
        """Forget what earlier frames have changed of the operators; collective."""
        self.problem.begin_anew()

    def measure(self, frame: Frame, start: KnownStart | None = None, least_shown: float = 0.0) -> Measurement:
        """Measure the displacement between the reference images and a frame; collective.

        ``start`` holds unknowns of each owned subdomain to start from, (n_unknowns,), or is a displacement to go on
        from; else the case says where. ``least_shown`` is the share of the cells that the start must show, any by
        default. Raises InputError, SingularSubdomainError, or ConvergenceError with the last field, on all ranks; the
        session can measure other frames afterwards.
        """
        problem, first_found = self.problem, None
        if frame is self._first_frame:
            first_found, self._first_frame = self._found_first, None
        views = problem.open_frame(frame)
        begin = find_start(self._start, frame, views, first_found, start)
        model = problem.build_residual_model(views)
        note_all(self._listener, begin.notes)
        notes = (*problem.reference.notes, *begin.notes)
        with last_field_kept(self._clock, lambda *last: finish_measurement(problem, frame, notes, *last)):
            solved = solve_frame(problem, model, begin.q, self._listener, self._clock, least_shown)
        with self._clock.phase(Phase.FINISH):
            measurement = finish_measurement(problem, frame, notes, solved)
            measurement = measurement.with_notes(describe_closed_lines(problem, measurement))
            if problem.law is not None:
                share = problem.law.keep(measurement.q)
                measurement = replace(measurement, plastic_strain=problem.law.find_plastic_strains())
                measurement = measurement.with_notes((f"{share:.1%} of the region yields",))
        note_all(self._listener, measurement.notes[len(notes) + len(solved.notes):])
        return replace(measurement, independent=begin.independent)

    def estimate_noise_floor(self, measured: Measurement) -> float:
        """Estimate what noise of the residual's size leaves in what was measured last, pixels; collective.

        The residual is taken to be noise, as strong as it acts on displacements; it also holds what the field cannot
        follow. With several cameras the noise is the one that weighs them. It is the RMS of a component at a node; nan
        where a linear step fails.
        """
        problem, solver = self.problem, self.problem.solver
        counted = [~is_unmeasured for is_unmeasured in measured.unmeasured]
        with self._clock.phase(Phase.FINISH):
            try:
                response = estimate_response(problem.team, solver.assembly.systems, solver.step, counted)
                if problem.noise:
                    return problem.noise[0] * response.rms_per_grey
                noise = measure_force_noise(measured.model, measured.evaluation, measured.q, response.n_determined,
                                            is_regularized=solver.assembly.eta > 0)
                return noise.sigma * response.rms_per_grey
            except ConvergenceError as error:
                # What was measured stands without it.
                require_collective(error)
                return float("nan")

    def close(self) -> None:
        """Free PETSc's objects."""
        self.problem.destroy()
