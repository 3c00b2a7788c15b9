"""PGD-DIC: successive rank-one corrections of a displacement that is a sum of products, Fig. 2 of [PP12]."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.case.loader import LoadedCase
from ddic.case.schema import Case, ImagesSection
from ddic.check.case import CheckReport, count_bits
from ddic.errors import InputError, Problems
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, StartPoints
from ddic.io import result_schema as schema
from ddic.io.image_chunks import ChunkGrid
from ddic.io.result_pieces import Piece
from ddic.io.result_schema import Verdict
from ddic.io.result_writer import ResultWriter
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.kinematics.strain import compute_strain
from ddic.mesh.cell_type import Q4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.methods.method import MethodSession
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team, require_held
from ddic.problem.region_mesh import describe_cut_off
from ddic.problem.separated_problem import (
    Rectangle,
    SeparatedProblem,
    build_rectangle,
    check_rectangle,
    choose_controlled_lines,
    choose_output_lines,
    prepare_separated_problem,
)
from ddic.problem.weighted_problem import ProblemSize
from ddic.results.fields import convert_to_six_components, describe_nodal_strains
from ddic.results.listener import Listener, note_all
from ddic.results.measurement import last_field_kept
from ddic.results.publishing import describe_images, write_case
from ddic.results.residual_image import Patch, write_patches
from ddic.results.summary import Summary, find_field_ranges
from ddic.results.verdict import Evidence, choose_verdict
from ddic.separated.corrections import CorrectionRecord, SeparatedSolution, correct_displacement
from ddic.separated.field import N_BANDS, LineElements, SeparatedField
from ddic.separated.pixel_bands import FramePixels, ReferenceBands
from ddic.start.separated_start import KnownSeparatedStart, find_separated_start, prepare_separated_search
from ddic.visibility.cell_errors import (
    CellErrors,
    CellResiduals,
    MarkedCells,
    bound_cells,
    describe_doubtful_cells,
    describe_places,
    find_cell_errors,
)
from ddic.visibility.exclusions import KEPT, MASKED, UNSEEN

Rows = tuple[range, NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class _OutputCells:
    """Cells between some lines, row by row; KEPT or why not; RMS of the residual, grey levels, nan without pixels."""

    grid: GridLines
    states: NDArray[np.uint8]
    n_pixels: Array
    residual_rms: Array
    errors: CellErrors
    notes: tuple[str, ...]

    def weigh(self, residual: float, *, may_be_saturated: bool) -> Evidence:
        """Say what speaks for or against a field that leaves a residual, its deviation over the dynamic range."""
        marked = [MarkedCells(state, int((self.states == state).sum()),
                              describe_places(*bound_cells(self.grid.build_mesh(), self.states == state)))
                  for state in np.unique(self.states[self.states != KEPT]).tolist()]
        return Evidence(len(self.states), int(self.errors.doubtful.sum()), marked, residual=residual,
                        may_be_saturated=may_be_saturated)

    def evaluate_displacement(self, field: SeparatedField) -> Array:
        """Evaluate a displacement at their nodes, (n_nodes, 2), row by row, pixels."""
        return field.evaluate_on_grid(*self.grid.lines).reshape(-1, 2)


def _evaluate_output_cells(team: Team, grid: GridLines, reference: ReferenceBands,
                           residual: Sequence[Rows]) -> _OutputCells:
    """Sum the residual over cells, the same on all ranks; collective.

    ``grid`` has the lines between the cells, pixels. ``residual`` is that of this rank's bands, (n_rows, width) each,
    grey levels, grey levels corrected.
    """
    along_x, along_y = map(LineElements, grid.lines)
    sums = team.sum(sum((_sum_band(along_x, along_y, reference, number, rows) for number, rows in enumerate(residual)),
                        np.zeros((5, along_y.n_nodes - 1, along_x.n_nodes - 1))))
    n, r, rr, slopes, n_in_reference = sums.reshape(5, -1)
    safe = np.maximum(n, 1.0)
    # The mean of a cell's residual is brightness, not displacement.
    variance = np.where(n > 0, np.maximum(rr / safe - (r / safe) ** 2, 0.0), np.nan)
    residuals = CellResiduals(2, 0, n, variance, slopes / safe)
    errors = find_cell_errors(team, [residuals] if team.is_root else [])
    notes, _ = describe_doubtful_cells(team, errors)
    rms = np.where(n > 0, np.sqrt(np.maximum(rr / safe, 0.0)), np.nan)
    states = np.select([n > 0, n_in_reference > 0], [KEPT, UNSEEN], MASKED).astype(np.uint8)
    return _OutputCells(grid, states, n, rms, team.broadcast(errors[0] if team.is_root else None), notes)


def _sum_band(along_x: LineElements, along_y: LineElements, reference: ReferenceBands, number: int,
              rows: Rows) -> Array:
    """Sums over the pixels of a band of (1, r, r^2, |grad f|^2, 1 in the reference), (5, n_rows, n_columns)."""
    band, r = reference.bands[number], rows[1].astype(np.float64)
    counts = np.isfinite(r)
    r[~counts] = 0.0
    slopes = np.where(counts, band.by_x.astype(np.float64)**2 + band.by_y.astype(np.float64)**2, 0.0)
    starts = np.searchsorted(np.arange(reference.along_x.pixels.start, reference.along_x.pixels.stop),
                             along_x.nodes[:-1])
    places = np.searchsorted(along_y.nodes, np.array(rows[0]), side="right") - 1
    sums = np.zeros((5, along_y.n_nodes - 1, along_x.n_nodes - 1))
    in_reference = np.isfinite(band.values)
    for k, image in enumerate((counts.astype(np.float64), r, r**2, slopes, in_reference.astype(np.float64))):
        np.add.at(sums[k], np.clip(places, 0, along_y.n_nodes - 2), np.add.reduceat(image, starts, axis=1))
    return sums


def _write_output_cells(writer: ResultWriter, cells: _OutputCells, field: SeparatedField,
                        images: ImagesSection) -> None:
    """Write cells with the displacement at their nodes, which are nodes of the elements too; on rank 0."""
    mesh = cells.grid.build_mesh()
    displacement = cells.evaluate_displacement(field)
    length_unit = None if images.pixel_size is None else images.length_unit
    point_data: dict[str, NDArray[Any]] = {
        schema.DISPLACEMENT: displacement,
        schema.DISPLACEMENT_MESH_UNITS: displacement,
        schema.GLOBAL_NODE_ID: np.arange(mesh.n_nodes),
        **describe_nodal_strains(recover_gradients([mesh], [displacement.ravel()], list)[0]),
    }
    if images.pixel_size is not None:
        point_data[schema.DISPLACEMENT_PHYSICAL] = displacement * images.pixel_size
    piece = Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, point_data,
                  _describe_cells(mesh, cells, displacement))
    writer.write_pieces([piece], (*schema.point_fields(length_unit), *schema.nodal_strain_fields()),
                        schema.cell_fields())


def _describe_cells(mesh: Mesh, cells: _OutputCells, displacement: Array) -> dict[str, NDArray[Any]]:
    strain = compute_strain(mesh, displacement.ravel())
    return {
        schema.STRAIN_INFINITESIMAL: convert_to_six_components(strain.infinitesimal),
        schema.STRAIN_GREEN_LAGRANGE: convert_to_six_components(strain.green_lagrange),
        schema.RESIDUAL_RMS: cells.residual_rms,
        schema.RESIDUAL_N_PIXELS: cells.n_pixels.astype(np.int64),
        schema.EQUIVALENT_ERROR: cells.errors.equivalent,
        schema.DOUBTFUL: cells.errors.doubtful.astype(np.uint8),
        schema.EXCLUDED: cells.states,
        schema.SUBDOMAIN_ID: np.zeros(mesh.n_cells, dtype=np.int32),
        schema.GLOBAL_CELL_ID: np.arange(mesh.n_cells),
    }


@dataclass(frozen=True, eq=False)
class SeparatedMeasurement:
    """A measured displacement as a sum of products, known to all ranks; pixels are spread over them.

    Attributes
    ----------
    problem : SeparatedProblem
        What was measured: reference image, rectangle and settings.
    frame : Frame
        The deformed image.
    solution : SeparatedSolution
        The displacement and its corrections.
    cells : _OutputCells
        On which the displacement is written out, with what the residual says of them.
    residual_rows : list of (range, (n_rows, width) array)
        Residual image of this rank's bands, grey levels.
    notes : tuple of str
        What the user should know.
    failure : str
        Why it is no result; empty where it converged.
    """

    problem: SeparatedProblem
    frame: Frame
    solution: SeparatedSolution
    cells: _OutputCells
    residual_rows: list[tuple[range, NDArray[np.float32]]]
    notes: tuple[str, ...]
    failure: str = ""

    @property
    def grey_correction(self) -> GreyCorrection:
        """Correction of grey levels that was taken."""
        return self.problem.scheme.correction

    @property
    def team(self) -> Team:
        """All ranks."""
        return self.problem.team

    @property
    def inputs(self) -> Inputs:
        """Reference image and settings."""
        return self.problem.inputs

    @property
    def size(self) -> ProblemSize:
        """Sizes and weights."""
        return self.problem.size

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the displacement can be trusted."""
        residual = self.solution.grey.residual_std / (self.size.dynamic_range or 1.0)
        evidence = self.cells.weigh(residual, may_be_saturated=self.inputs.case.imaging.exclude_saturated)
        return choose_verdict(evidence, self.failure)

    @property
    def unknowns(self) -> SeparatedField:
        """What another frame may start from."""
        return self.solution.field

    def write(self, writer: ResultWriter | None) -> None:
        """Write products, displacement on cells, tables and residual image; collective, the writer is rank 0's."""
        self.team.build_on_root(lambda: self._write_on_root(require_held(writer)))
        if self.inputs.case.output.residual_image:
            self._write_residual_image(writer)

    def _write_on_root(self, writer: ResultWriter) -> None:
        _write_output_cells(writer, self.cells, self.solution.field, require_held(self.inputs.case.images))
        writer.write_separated(self.solution.field)
        writer.write_table(schema.CORRECTIONS, _list_corrections(self.solution.records))
        write_case(self, writer, {"largest_jump_px": 0.0, "stop": self.solution.stop})
        writer.write_status(self.failure, self.verdict)

    def _write_residual_image(self, writer: ResultWriter | None) -> None:
        image, columns = self.inputs.cameras[0].reference.image, self.problem.rectangle.along_x.pixels
        patches = [Patch(Window((columns.start, rows.start), (columns.stop, rows.stop)), values)
                   for rows, values in self.residual_rows]
        write_patches(self.team, writer, ChunkGrid(image.extent), [patch.window for patch in patches], iter(patches))

    def summarize(self, of_run: dict[str, Any]) -> Summary:
        """Sum it up in numbers for scripts and people, the same on all ranks; collective."""
        solution, cells = self.solution, self.cells
        u = cells.evaluate_displacement(solution.field)
        return Summary(
            **of_run,
            iterations=len(solution.records),
            residual_std_grey=solution.grey.residual_std,
            residual_percent_of_range=100 * solution.grey.residual_std / (self.size.dynamic_range or 1.0),
            n_pixels=solution.grey.n_pixels,
            n_pixels_outside=self.size.n_pixels - solution.grey.n_pixels,
            krylov_iterations=[],
            largest_jump_px=0.0,
            linear_error_px=float("nan"),
            stop=solution.stop,
            n_modes=solution.field.n_modes,
            method=schema.PGD,
            ranges=find_field_ranges(self.team, [(cells.grid.build_mesh(), u.ravel())]),
            iteration_table=_list_corrections(solution.records),
        )

    def describe_origin(self) -> dict[str, str | int]:
        """Say what it was measured from: sizes, and the images with their checksums."""
        return {"n_ranks": self.size.n_ranks, "n_subdomains": self.size.n_subdomains, "method": schema.PGD,
                **describe_images(self.team, {"reference": self.inputs.cameras[0].reference.image,
                                              "deformed": self.frame[0].image})}


def _list_corrections(records: Sequence[CorrectionRecord]) -> dict[str, list[Any]]:
    """List corrections, columns by name; the residual is that before each of them."""
    return {
        "correction": [r.number for r in records],
        "rms_x_px": [r.rms[0] for r in records],
        "rms_y_px": [r.rms[1] for r in records],
        "relative_x": [r.relative[0] for r in records],
        "relative_y": [r.relative[1] for r in records],
        "relative": [r.eta for r in records],
        "fluctuation_x": [r.fluctuation[0] for r in records],
        "fluctuation_y": [r.fluctuation[1] for r in records],
        "gain": [r.gain for r in records],
        "noise_gain": [r.noise_gain for r in records],
        "sweeps": [r.n_sweeps for r in records],
        "stagnation": [r.stagnation for r in records],
        "modes": [r.n_modes for r in records],
        "residual_std_grey": [r.grey.residual_std for r in records],
        "residual_rms_grey": [r.grey.residual_rms for r in records],
        "n_pixels": [r.grey.n_pixels for r in records],
        "grey_gain": [r.grey.gain for r in records],
        "grey_offset": [r.grey.offset for r in records],
    }


def _finish_separated(problem: SeparatedProblem, frame: Frame, pixels: FramePixels, notes: tuple[str, ...],
                      solution: SeparatedSolution, failure: str = "") -> SeparatedMeasurement:
    """Compute the residual image and judge cells, ``failure`` saying why there is no result, else empty; collective."""
    residual = pixels.compute_residual_rows(solution.field, solution.grey.gain, solution.grey.offset)
    grid = GridLines(choose_output_lines(problem.inputs.case, problem.rectangle))
    cells = _evaluate_output_cells(problem.team, grid, problem.reference, residual)
    notes = (*problem.inputs.notes, *notes, failure or solution.stop, *cells.notes)
    return SeparatedMeasurement(problem, frame, solution, cells, residual, notes, failure)


class SeparatedSession(MethodSession):
    """A prepared PGD-DIC measurement, for any number of frames; use it in a ``with`` statement as other sessions.

    Each rank reads some bands of rows. Raises InputError on all ranks.

    Parameters
    ----------
    team, inputs : Team, Inputs
        All ranks; reference images, mesh and settings.
    listener, clock : Listener, PhaseClock
        Told what happens; the clock of the phases.
    """

    def __init__(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock) -> None:
        self._listener, self._clock = listener, clock
        self._problem = prepare_separated_problem(team, inputs, clock)
        with clock.phase(Phase.START):
            self._search = prepare_separated_search(self._problem)

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
        with (last_field_kept(self._clock, lambda *found: _finish_separated(problem, frame, pixels, notes, *found)),
              self._clock.phase(Phase.LINEAR_STEP)):
            solution = problem.team.alike(lambda: correct_displacement(
                pixels, begin, problem.regularization, problem.scheme, problem.rules, self._report))
        self._listener.note(solution.stop)
        with self._clock.phase(Phase.FINISH):
            return _finish_separated(problem, frame, pixels, notes, solution)

    def _report(self, record: CorrectionRecord) -> None:
        """Tell a correction, and end there where a signal asked for it."""
        self._listener.correction(record)
        stop_if_asked(self._problem.team, f"after correction {record.number}, before it converged")

    def close(self) -> None:
        """Do nothing: there is no object of PETSc to free."""


class _SuccessiveProducts:
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
            check_rectangle(loaded.case, rectangle, reference.extent)
            return _describe_rectangle(loaded.case, reference, rectangle)
        return None

    def build_result_mesh(self, case: Case, extent: Window) -> Mesh:
        """Build the mesh of the result, since elements may be single pixels."""
        grid = GridLines(choose_output_lines(case, build_rectangle(case)))
        return build_mesh(grid.nodes, {Q4: grid.cells}, grid.sides)

    def prepare(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                first_frame: Frame | None = None) -> SeparatedSession:
        """Read the reference image and find the weight of the regularisation."""
        return SeparatedSession(team, inputs, listener, clock)


METHOD = _SuccessiveProducts()


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
        half_amplitudes=describe_cut_off(section, 2),
        most_ranks=N_BANDS,
    )
