"""PGD-DIC: successive rank-one corrections of a displacement that is a sum of products, Fig. 2 of [PP12]."""

from typing import Self

from ddic.case.loader import LoadedCase
from ddic.case.schema import Case
from ddic.check.case import CheckReport, count_bits
from ddic.errors import InputError, Problems
from ddic.images.source import ImageSource
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, StartPoints
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.structured import GridLines
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.problem.region_mesh import describe_cut_off
from ddic.problem.separated_problem import (
    Rectangle,
    build_rectangle,
    check_rectangle,
    choose_controlled_lines,
    choose_output_lines,
    prepare_separated_problem,
)
from ddic.results.listener import Listener, note_all
from ddic.results.measurement import last_field_kept
from ddic.results.separated import SeparatedMeasurement, finish_separated
from ddic.separated.band_sums import N_BANDS
from ddic.separated.corrections import CorrectionRecord, correct_displacement
from ddic.start.separated_start import KnownSeparatedStart, find_separated_start, prepare_separated_search


class SeparatedSession:
    """A prepared PGD-DIC measurement, for any number of frames; use it in a ``with`` statement as other sessions.

    Each rank reads some bands of rows. Raises InputError on all ranks.

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
    """

    # No operator of a mesh is assembled or factorised.
    n_assembled = n_factorized = 0

    def __init__(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock) -> None:
        self._listener, self._clock = listener, clock
        self._problem = prepare_separated_problem(team, inputs, clock)
        with clock.phase(Phase.START):
            self._search = prepare_separated_search(self._problem)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def measure(self, frame: Frame, start: KnownSeparatedStart | None = None) -> SeparatedMeasurement:
        """Measure the displacement between the reference image and a frame; collective.

        ``start`` is a displacement to start from, or to go on from; by default the case says where. Raises InputError,
        SingularSubdomainError, or ConvergenceError with the last field, on all ranks; the session can measure other
        frames afterwards.
        """
        problem = self._problem
        with self._clock.phase(Phase.START):
            begin, notes = find_separated_start(problem, self._search, frame, start)
        note_all(self._listener, notes)
        self._listener.problem_size(problem.size)
        pixels = problem.open_frame(frame)
        with (last_field_kept(self._clock, lambda *found: finish_separated(problem, frame, pixels, notes, *found)),
              self._clock.phase(Phase.LINEAR_STEP)):
            solution = problem.team.alike(lambda: correct_displacement(
                pixels, begin, problem.regularization, problem.scheme, problem.rules, self._report))
        self._listener.note(solution.stop)
        with self._clock.phase(Phase.FINISH):
            return finish_separated(problem, frame, pixels, notes, solution)

    def estimate_noise_floor(self, measured: SeparatedMeasurement) -> float:
        """Tell that it is not known, nan: it follows from linear steps on a mesh."""
        return float("nan")

    def _report(self, record: CorrectionRecord) -> None:
        """Tell a correction, and end there where a signal asked for it."""
        self._listener.correction(record)
        stop_if_asked(self._problem.team, f"after correction {record.number}, before it converged")

    def close(self) -> None:
        """Do nothing: there is no object of PETSc to free."""


class SuccessiveProducts:
    """A displacement that is a sum of products on a rectangle; a ``Method``."""

    def check_ranks(self, loaded: LoadedCase, n_ranks: int) -> None:
        """Refuse ranks that would have no band of rows."""
        if n_ranks > N_BANDS:
            raise InputError(f"[pgd]: the rows of the images are divided into {N_BANDS} bands, and {n_ranks} MPI ranks "
                             f"were started; start at most {N_BANDS}")

    def check(self, loaded: LoadedCase, reference: ImageSource | None, points: StartPoints | None,
              problems: Problems) -> CheckReport | None:
        """Check the rectangle and what refers to it; whether it holds ``points`` is not asked."""
        if reference is None:
            return None
        with problems.gathered(loaded.path):
            rectangle = build_rectangle(loaded.case)
            check_rectangle(loaded.case, rectangle, reference.width, reference.height)
            return _describe_rectangle(loaded.case, reference, rectangle)
        return None

    def build_result_mesh(self, case: Case, width: int, height: int) -> Mesh:
        """Build the mesh of the result, since elements may be single pixels."""
        grid = GridLines(*choose_output_lines(case, build_rectangle(case)))
        return build_mesh(grid.nodes, {Q4: grid.quads}, grid.sides)

    def prepare(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                first_frame: Frame | None = None) -> SeparatedSession:
        """Read the reference image and find the weight of the regularisation."""
        return SeparatedSession(team, inputs, listener, clock)


METHOD = SuccessiveProducts()


def _describe_rectangle(case: Case, reference: ImageSource, rectangle: Rectangle) -> CheckReport:
    """Describe inputs with [pgd] that were found fit."""
    n_nodes = rectangle.along_x.n_nodes * rectangle.along_y.n_nodes
    n_cells = (rectangle.along_x.n_nodes - 1) * (rectangle.along_y.n_nodes - 1)
    of_x, of_y = (line.count_pixels() for line in (rectangle.along_x, rectangle.along_y))
    n_controlled = n_nodes
    section = case.regularization
    if section is None:
        n_controlled = 0
    elif section.operator == "equilibrium_gap":
        lines = choose_controlled_lines(section, rectangle)
        n_controlled = int(lines.x.sum()) * int(lines.y.sum())
    return CheckReport(
        image_size=(reference.width, reference.height),
        bits=count_bits(reference),
        n_nodes=n_nodes,
        n_cells=n_cells,
        n_dofs=2 * n_nodes,
        cell_counts={"Q4": n_cells},
        node_sets={},
        pixels_min=int(of_x.min() * of_y.min()),
        pixels_mean=float(of_x.mean() * of_y.mean()),
        n_controlled_dofs=2 * n_controlled,
        output=case.output.file,
        discontinuities=None,
        half_amplitudes=describe_cut_off(section),
        most_ranks=N_BANDS,
    )
