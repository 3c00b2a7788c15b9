"""A measured field, spread over ranks, and how it was measured; the last field of one that did not converge."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import Case
from ddic.errors import ConvergenceError, DdicError, as_collective, is_collective, list_first, require_collective
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.volume import measure_rounding
from ddic.inputs.cameras import Camera, Frame
from ddic.inputs.inputs import Inputs
from ddic.io.result_schema import Verdict
from ddic.io.result_writer import ResultWriter
from ddic.kinematics.strain import find_inverted_cells
from ddic.mesh.plane import build_tree
from ddic.parallel.field import Field
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.region_mesh import Region, compute_cut_off_wavelength
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import ProblemSize, WeightedProblem
from ddic.results.fields import list_iterations, write_pieces, write_tables
from ddic.results.near import SetupMotion, measure_motions, summarize_near_field
from ddic.results.publishing import describe_images
from ddic.results.residual_image import write_residual_images
from ddic.results.summary import Summary, find_field_ranges
from ddic.results.verdict import Evidence, choose_verdict, find_tear
from ddic.solvers.gauss_newton import IterationRecord
from ddic.visibility.cell_errors import (
    CellErrors,
    MarkedCells,
    describe_doubtful_cells,
    describe_exclusions,
    describe_lost_field,
    find_cell_errors,
    find_marked_cells,
    find_noisy_cells,
    find_unmeasured_nodes,
    measure_cell_residuals,
)
from ddic.visibility.exclusions import SPOILT, Exclusions, find_excluded
from ddic.visibility.slow_nodes import estimate_node_deviations
from ddic.visibility.solved_frame import SeenFrame, SolvedFrame

if TYPE_CHECKING:
    from ddic.detection.find_lines import Detection
    from ddic.results.comparison import Comparison
    from ddic.results.field_uncertainty import FieldUncertainty
    from ddic.results.identification import Identification
    from ddic.results.modes import TimeModes


LEAST_USED = 0.5
"""Share of a cell's pixels in the reference image that must count; with fewer it is marked doubtful."""


@dataclass(frozen=True)
class Measurement:
    """A measured field and how it was measured.

    Attributes
    ----------
    inputs : Inputs
        Reference images, mesh and settings.
    frame : Frame
        The deformed images.
    region : Region
        What is known of the whole mesh.
    model, whole : ResidualModel
        Owned subdomains with their pixels; ``whole`` with all that the frame shows, also those that do not count.
    q : Field
        Unknowns since the reference image in use, one value for the copies of an interface unknown (section
        5.3.2 of [BP17]).
    largest_jump : float
        Largest difference between copies before that, pixels.
    evaluation : Evaluation
        Residuals and grey-level statistics at q.
    size : ProblemSize
        Sizes and weights.
    records : list of IterationRecord
        Gauss-Newton's iterations.
    notes : tuple of str
        What the user should know.
    motions : tuple of SetupMotion
        Of near-field set-ups.
    noise : tuple of float
        Of each camera, grey levels; empty with one camera.
    cell_errors : list of CellErrors
        What the residual says about the cells of each owned subdomain.
    excluded : Exclusions
        Cells and pixels that do not count.
    unmeasured : list of (n_nodes,) bool array
        Nodes of each that nothing holds: their displacement is nan.
    stop, failure : str
        Which tolerances ended Gauss-Newton; why it is no result, empty where it converged.
    method, preconditioner : str
        How the linear steps were solved, as a case calls it.
    evidence : Evidence
        What speaks for or against the field.
    uncertainty : FieldUncertainty or None
        What noise and regularization do to the field, where the case asks for it.
    comparison : Comparison or None
        A simulation beside the field, where the case names one.
    identification : Identification or None
        Parameters of the material, where they were sought.
    detection : Detection or None
        What was seen where lines were looked for in this frame.
    modes : TimeModes or None
        Of the series of which this is the last frame, where its frames were measured together.
    plastic_strain : list of (n_cells,) array, or None
        Equivalent plastic strain of the cells of each, up to this frame, where the material is plastic.
    independent : list of (n_dofs,) array, or None
        What each owned subdomain measured by itself, pixels, where the case asks for it.
    """

    inputs: Inputs
    frame: Frame
    region: Region
    model: ResidualModel
    q: Field
    largest_jump: float
    evaluation: Evaluation
    size: ProblemSize
    records: list[IterationRecord]
    notes: tuple[str, ...]
    motions: tuple[SetupMotion, ...]
    noise: tuple[float, ...]
    cell_errors: list[CellErrors]
    excluded: Exclusions
    unmeasured: list[BoolArray]
    whole: ResidualModel
    evidence: Evidence
    stop: str
    failure: str = ""
    method: str = ""
    preconditioner: str = "none"
    uncertainty: FieldUncertainty | None = None
    comparison: Comparison | None = None
    identification: Identification | None = None
    detection: Detection | None = None
    modes: TimeModes | None = None
    plastic_strain: list[Array] | None = None
    independent: list[Array] | None = None

    @property
    def team(self) -> Team:
        """All ranks."""
        return self.model.team

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras with their reference images."""
        return self.inputs.cameras

    @cached_property
    def subdomains(self) -> list[Subdomain]:
        """Owned subdomains, in the first reference image."""
        subdomains, updated = list(self.model.subdomains), self.inputs.updated
        return subdomains if updated is None else [updated.place_first(subdomain) for subdomain in subdomains]

    @property
    def unknowns(self) -> Field:
        """Unknowns since the first reference image: q, but for updates."""
        updated = self.inputs.updated
        return self.q if updated is None else self.q + updated.restrict(self.subdomains)

    @property
    def displacements(self) -> list[Array]:
        """Displacement of each owned subdomain's nodes since the first reference image, (n_dofs,), pixels."""
        found = []
        for subdomain, q_s, is_unmeasured in zip(self.subdomains, self.unknowns, self.unmeasured, strict=True):
            displacement = np.array(subdomain.displacement(q_s))
            displacement.reshape(subdomain.mesh.nodes.shape)[is_unmeasured] = np.nan
            found.append(displacement)
        return found

    def with_notes(self, notes: Sequence[str]) -> Measurement:
        """Give the same with more notes, which its result has too."""
        of_result = replace(self.inputs, notes=(*self.inputs.notes, *notes))
        return replace(self, inputs=of_result, notes=(*self.notes, *notes))

    @property
    def verdict(self) -> Verdict:
        """Whether the field can be trusted."""
        return choose_verdict(self.evidence, self.failure)

    @property
    def n_iterations(self) -> int:
        """Number of iterations over all pixels."""
        return sum(not record.is_local for record in self.records)

    @property
    def grey_correction(self) -> GreyCorrection:
        """Correction of grey levels that was taken."""
        return self.model.correction

    def write(self, writer: ResultWriter | None) -> None:
        """Write fields, histories and residual images; collective, the writer is rank 0's, None elsewhere."""
        write_pieces(self, writer)
        self.team.build_on_root(lambda: write_tables(self, require_held(writer)))
        if self.inputs.case.output.residual_image:
            write_residual_images(self, writer)

    def summarize(self, of_run: dict[str, Any]) -> Summary:
        """Sum it up in numbers for scripts and people, the same on all ranks; collective."""
        grey, size, records = self.evaluation.grey, self.size, self.records
        n_pixels = sum(camera.n_pixels for camera in grey)
        fields = zip((subdomain.mesh for subdomain in self.subdomains), self.displacements, strict=True)
        return Summary(
            **of_run,
            iterations=self.n_iterations,
            local_iterations=len(records) - self.n_iterations,
            residual_std_grey=grey[0].residual_std,
            residual_percent_of_range=100 * grey[0].residual_std / size.dynamic_range,
            n_pixels=n_pixels,
            n_pixels_outside=size.n_pixels - n_pixels,
            krylov_iterations=[record.krylov_iterations for record in records],
            largest_jump_px=self.largest_jump,
            linear_error_px=records[-1].linear_error if records else float("nan"),
            near=[summarize_near_field(self, motion) for motion in self.motions],
            stop=self.stop,
            method=self.method,
            preconditioner=self.preconditioner,
            ranges=find_field_ranges(self.team, list(fields)),
            iteration_table=list_iterations(self),
            comparison={} if self.comparison is None else self.comparison.regions,
            identification={} if self.identification is None else self.identification.table,
        )

    def describe_origin(self) -> dict[str, str | int]:
        """Say what it was measured from: sizes, and the first camera's images with their checksums."""
        updated, deformed = self.inputs.updated, self.frame[0].image
        # Mesh and fields are those of the first one.
        reference = self.cameras[0].reference.image if updated is None else updated.first_image
        return {"n_ranks": self.size.n_ranks, "n_subdomains": self.size.n_subdomains,
                "method": self.method, "preconditioner": self.preconditioner,
                **describe_images(self.team, {"reference": reference, "deformed": deformed}),
                "compared_with_path": str(self.cameras[0].reference.image.path)}


def finish_measurement(problem: WeightedProblem, frame: Frame, notes: tuple[str, ...], solved: SolvedFrame,
                       failure: str = "") -> Measurement:
    """Evaluate the residual at a field and judge its cells; collective.

    ``failure`` says why the field is no result, nothing where it converged. Raises ConvergenceError on all ranks where
    the field leaves no pixel of a camera; with the measurement, where a field that converged turns cells inside out, or
    where a blurred frame leaves hardly a cell that noise does not move too far.
    """
    team, inputs = problem.team, problem.reference.inputs
    subdomains = problem.reference.subdomains
    field, excluded = solved.field, solved.seen.excluded
    # Cells that are pulled show their residual.
    model = replace(solved.used, pulled=None)
    motions = measure_motions(problem, field.q)
    is_known = solved.is_evaluated and not excluded.is_any(team)
    evaluation = solved.seen.evaluation if is_known else model.evaluate(field.q)
    cell_errors, lost = _judge_cells(problem, model, evaluation, excluded)
    unmeasured = find_unmeasured_nodes(problem, evaluation)
    uncertainty: FieldUncertainty | None = None
    of_uncertainty: tuple[str, ...] = ()
    # A field that is no result has none.
    if inputs.case.output.uncertainty and not failure:
        uncertainty, of_uncertainty = _estimate_uncertainty(problem, model, evaluation, field.q, unmeasured)
    n_cells = problem.reference.region.n_cells
    marked = find_marked_cells(team, subdomains, excluded)
    of_doubtful, n_doubtful = describe_doubtful_cells(team, cell_errors)
    evidence = _collect_evidence(problem, solved.seen, evaluation, marked, n_doubtful, measure_rounding(frame[0].image))
    notes = (*notes, *solved.notes, *_describe_correction(inputs.case, model),
             *describe_exclusions(team, marked, n_cells, excluded), *of_doubtful, *of_uncertainty)
    measurement = Measurement(inputs, frame, problem.reference.region, model, field.q, field.largest_jump, evaluation,
                              problem.size, solved.solution.records, notes, motions, problem.noise, cell_errors,
                              excluded, unmeasured, solved.seen.whole, evidence, solved.solution.stop, failure,
                              problem.solver.method, problem.solver.preconditioner, uncertainty)
    are_used = [~find_excluded(of_views[0]) for of_views in excluded.cells]
    inverted = _describe_inverted_cells(team, measurement.subdomains, measurement.displacements, are_used)
    found = lost or inverted
    if found and not failure:
        raise as_collective(ConvergenceError(found, replace(measurement, failure=found)))
    return measurement


def _collect_evidence(problem: WeightedProblem, seen: SeenFrame, evaluation: Evaluation,
                      marked: Sequence[MarkedCells], n_doubtful: int, rounding: float) -> Evidence:
    """What speaks for or against a field, of which cells are marked and doubtful; collective.

    ``rounding`` is what of the residual comes of rounding alone, grey levels.
    """
    subdomains = problem.reference.subdomains
    is_torn = any(cells.state == SPOILT for cells in marked) and find_tear(problem.team, subdomains, seen.excluded)
    residual = max(evaluation.grey[0].residual_std - rounding, 0.0) / (problem.size.dynamic_range or 1.0)
    return Evidence(problem.reference.region.n_cells, n_doubtful, marked, seen.measure_shown_share(), is_torn, residual,
                    may_be_saturated=problem.reference.inputs.case.imaging.exclude_saturated)


def _estimate_uncertainty(problem: WeightedProblem, model: ResidualModel, evaluation: Evaluation, q: Field,
                          unmeasured: list[BoolArray]) -> tuple[FieldUncertainty | None, tuple[str, ...]]:
    """Standard deviations, and what is said of them; a linear step that fails for them does not lose the field."""
    from ddic.results.field_uncertainty import describe_uncertainty, estimate_field_uncertainty

    try:
        found = estimate_field_uncertainty(problem, model, evaluation, q, unmeasured)
    except ConvergenceError as error:
        require_collective(error)
        return None, (f"no standard deviations were estimated, and the result holds none: {error}",)
    return found, describe_uncertainty(found)


def _describe_correction(case: Case, model: ResidualModel) -> tuple[str, ...]:
    """Say which correction of grey levels was chosen, where the choice was left to the pair."""
    if case.correlation.grey_correction != "auto" or model.correction == "none":
        return ()
    whose = {"global": "one gain and offset for the whole image", "element": "a gain and an offset of every element"}
    return (f"grey levels: {whose[model.correction]}, chosen from the pair (correlation.grey_correction)",)


def _judge_cells(problem: WeightedProblem, model: ResidualModel, evaluation: Evaluation,
                 excluded: Exclusions) -> tuple[list[CellErrors], str]:
    """What the residual says about the cells of each owned subdomain, and why none is believed; collective."""
    team = problem.team
    # Of the own camera, and of the reference image as it was compared.
    hessians = [own for own, *_ in problem.reference.hessians]
    if model.blurs:
        hessians = team.together(lambda: [own.assemble_hessian() for own, *_ in model.views])
    owned = list(zip(model.views, evaluation.residuals, hessians, strict=True))
    errors = find_cell_errors(team, team.together(lambda: [
        measure_cell_residuals(view, hessian, residual) for (view, *_), (residual, *_), hessian in owned]))
    # What is left of a cell that is mostly hidden says little of it, whatever its residual.
    are_hidden = [residual.cell_sums.n_pixels < LEAST_USED * view.prepared.count_pixels()
                  for (view, *_), (residual, *_) in zip(model.views, evaluation.residuals, strict=True)]
    doubts = [are_hidden, _find_cells_near_pulled(problem, excluded)]
    lost = ""
    if model.blurs or problem.reference.inputs.case.regularization is None:
        # Where little contrast is left, the residual of a wrong place may be as small as that of the right one.
        noise = evaluation.grey[0].residual_std ** 2
        deviations = estimate_node_deviations(model, problem.solver.assembly.systems, noise, by_pixels_alone=True)
        are_noisy = [find_noisy_cells(subdomain.mesh, of_nodes)
                     for subdomain, of_nodes in zip(model.subdomains, deviations, strict=True)]
        doubts.append(are_noisy)
        if model.blurs:
            are_shown = [of_views[0].cell_sums.n_pixels > 0 for of_views in evaluation.residuals]
            lost = describe_lost_field(team, are_noisy, are_shown)
    return [replace(of_cells, doubtful=np.logical_or.reduce([of_cells.doubtful, *reasons]))
            for of_cells, *reasons in zip(errors, *doubts, strict=True)], lost


def _find_cells_near_pulled(problem: WeightedProblem, excluded: Exclusions) -> list[BoolArray]:
    """Cells, (n_cells,), within a cut-off wavelength of a pulled one, which mechanics carry on; collective."""
    wavelength = compute_cut_off_wavelength(problem.reference.inputs.case)
    centroids = [subdomain.mesh.centroids for subdomain in problem.reference.subdomains]
    mine = [of_mesh[held.cells] for of_mesh, of_views in zip(centroids, excluded.pulled, strict=True)
            for held in of_views if len(held.cells)]
    pulled = problem.team.gather_lists(mine)
    if not pulled:
        return [np.zeros(len(of_mesh), dtype=bool) for of_mesh in centroids]
    tree = build_tree(np.concatenate(pulled))
    return [tree.query(of_mesh)[0] <= wavelength for of_mesh in centroids]


def _describe_inverted_cells(team: Team, subdomains: Sequence[Subdomain], displacements: Sequence[Array],
                             are_used: Sequence[BoolArray]) -> str:
    """Say which cells a field turns inside out, however small the last correction: no matter moves so; collective.

    Displacements are those of nodes, (n_dofs,), pixels, nan where nothing was measured. ``are_used`` tells which cells
    of each subdomain are not excluded, (n_cells,): what images do not show says nothing against a field. The text says
    why the field is no result, and is empty where no cell is inverted.
    """
    inverted = [np.intersect1d(find_inverted_cells(s.mesh, u), np.flatnonzero(is_used))
                for s, u, is_used in zip(subdomains, displacements, are_used, strict=True)]
    found = team.gather_lists([s.cell_ids[cells] for s, cells in zip(subdomains, inverted, strict=True)])
    cells = np.sort(np.concatenate(found))
    if not len(cells):
        return ""
    return (f"the measured field turns {len(cells)} elements inside out (numbers {list_first(cells)}): the images do "
            "not determine it; use larger elements or a longer regularization.cut_off_wavelength")


@contextmanager
def last_field_kept(clock: PhaseClock, finish: Callable[[Any, str], object]) -> Iterator[None]:
    """Let a ConvergenceError bring the measurement of its last field in place of the solver's solution; collective.

    ``finish`` makes the measurement of a solution and the reason why it is no result. The error is raised as it was,
    without a measurement where its solution shows nothing.
    """
    try:
        yield
    except ConvergenceError as error:
        found, error.last = error.last, None
        # Of one that is not raised on all ranks the job ends.
        if found is not None and is_collective(error):
            with clock.phase(Phase.FINISH):
                try:
                    error.last = finish(found, str(error))
                except DdicError as second:
                    # Where no pixel is left, say, there is nothing to show.
                    require_collective(second)
        raise


def gather_displacement(measurement: Measurement) -> Array | None:
    """Gather the displacement of all nodes on rank 0, (n_nodes, dim), pixels, None elsewhere; collective."""
    values = [(subdomain.node_ids, u.reshape(-1, subdomain.mesh.dim))
              for subdomain, u in zip(measurement.subdomains, measurement.displacements, strict=True)]
    gathered = measurement.team.gather_to(values, 0)
    if gathered is None:
        return None
    return place_at_nodes([of_subdomain for of_rank in gathered for of_subdomain in of_rank],
                          measurement.region.n_nodes, measurement.inputs.case.dim)


def place_at_nodes(values: Iterable[tuple[IntArray, Array]], n_nodes: int, dim: int) -> Array:
    """Put the values of several parts of a mesh in their places, (n_nodes, dim).

    Each part has the numbers of its nodes in the whole mesh and a vector of each, (n, dim). Where parts share a node,
    that of the last counts; nan at nodes of no part.
    """
    placed = np.full((n_nodes, dim), np.nan)
    for node_ids, of_part in values:
        placed[node_ids] = of_part
    return placed
