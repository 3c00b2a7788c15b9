"""A measured field, spread over ranks, and how it was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective, list_first
from ddic.io.result_writer import ResultWriter
from ddic.kinematics.strain import find_inverted_cells
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.cameras import Camera, Frame
from ddic.problem.inputs import Inputs
from ddic.problem.problem_size import ProblemSize
from ddic.problem.region_mesh import Region
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.camera_images import write_residual_images
from ddic.results.cell_errors import (
    CellErrors,
    describe_doubtful_cells,
    find_cell_errors,
    measure_cell_residuals,
)
from ddic.results.field_pieces import write_pieces
from ddic.results.histories import write_attributes, write_histories
from ddic.results.provenance import describe_image
from ddic.results.setup_motion import SetupMotion, collect_motions, describe_motions, estimate_covariances
from ddic.solvers.dual.continuity import average_copies
from ddic.solvers.gauss_newton import IterationRecord, Solution

Array = NDArray[np.float64]


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
    model : ResidualModel
        Owned subdomains with their pixels.
    q : list of (n_unknowns,) array
        Unknowns of each, one value for the copies of an interface unknown (Eq. 41 of [BP17]).
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
    stop : str
        Which tolerances ended Gauss-Newton.
    failure : str
        Why it is no result; empty where it converged.
    """

    inputs: Inputs
    frame: Frame
    region: Region
    model: ResidualModel
    q: list[Array]
    largest_jump: float
    evaluation: Evaluation
    size: ProblemSize
    records: list[IterationRecord]
    notes: tuple[str, ...]
    motions: tuple[SetupMotion, ...]
    noise: tuple[float, ...]
    cell_errors: list[CellErrors]
    stop: str
    failure: str = ""

    @property
    def team(self) -> Team:
        """All ranks."""
        return self.model.team

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras with their reference images."""
        return self.inputs.cameras

    @property
    def subdomains(self) -> list[Subdomain]:
        """Owned subdomains."""
        return [of_subdomain.subdomain for of_subdomain in self.model.views]

    @property
    def displacements(self) -> list[Array]:
        """Displacement of each owned subdomain's nodes, node by node, specimen's frame, (n_dofs,), pixels."""
        return [s.displacement(q_s) for s, q_s in zip(self.subdomains, self.q, strict=True)]

    @property
    def unknowns(self) -> list[Array]:
        """What another frame may start from."""
        return self.q

    def at(self, points: Array) -> Array:
        """Interpolate the displacement by shape functions, never across a hole; collective.

        Parameters
        ----------
        points : (n, 2) array
            Positions, specimen's frame, pixels; the same on all ranks.

        Returns
        -------
        (n, 2) array
            Displacement, pixels, on all ranks; nan outside the mesh.
        """
        total, n_found = np.zeros(points.shape), np.zeros(len(points))
        for subdomain, q_s in zip(self.subdomains, self.q, strict=True):
            found = subdomain.kinematics.at(points, q_s[:subdomain.n_field])
            inside = np.isfinite(found).all(axis=1)
            total[inside] += found[inside]
            n_found += inside
        # A point on an interface lies in several subdomains, which hold the same displacement there.
        total, n_found = self.team.sum(total), self.team.sum(n_found)
        return np.where(n_found[:, None] > 0, total / np.maximum(n_found, 1.0)[:, None], np.nan)

    def write(self, writer: ResultWriter | None) -> None:
        """Write fields, histories and residual images; collective.

        Parameters
        ----------
        writer : ResultWriter or None
            Open on rank 0, None elsewhere.
        """
        write_pieces(self, writer)
        self.team.build_on_root(lambda: self._write_histories(require_held(writer)))
        if self.inputs.case.output.residual_image:
            write_residual_images(self, writer)

    def _write_histories(self, writer: ResultWriter) -> None:
        write_histories(self, writer)
        write_attributes(self, writer)
        writer.write_status(self.failure)

    def describe_origin(self) -> dict[str, str | int]:
        """Say what it was measured from.

        Returns
        -------
        dict
            Sizes, and the first camera's images with their checksums.
        """
        reference, deformed = self.cameras[0].reference.image, self.frame[0].image
        return {"n_ranks": self.size.n_ranks, "n_subdomains": self.size.n_subdomains,
                **describe_image("reference", reference), **describe_image("deformed", deformed)}


def finish_measurement(problem: WeightedProblem, model: ResidualModel, frame: Frame, notes: tuple[str, ...],
                       solution: Solution, failure: str = "") -> Measurement:
    """Average the copies of interface unknowns and evaluate the residual there; collective.

    Parameters
    ----------
    problem : WeightedProblem
        That was solved.
    model : ResidualModel
        Of the frame.
    frame : Frame
        The deformed images.
    notes : tuple of str
        What the user should know.
    solution : Solution
        Of Gauss-Newton.
    failure : str, optional
        Why the field is no result; nothing where it converged.

    Returns
    -------
    Measurement
        Spread over ranks.

    Raises
    ------
    ConvergenceError
        On all ranks, where the field leaves no pixel of a camera; with the measurement, where a field that converged
        turns cells inside out.
    """
    team, inputs = problem.team, problem.reference.inputs
    subdomains = problem.reference.subdomains
    field = average_copies(team, subdomains, solution.q)
    inverted = describe_inverted_cells(team, subdomains, field.q)
    motions: tuple[SetupMotion, ...] = ()
    if any(camera.setup.n_motion_unknowns for camera in inputs.cameras):
        solver = problem.solver
        spread = estimate_covariances(team, solver.assembly.systems, solver.step, problem.noise[0])
        motions = describe_motions(inputs.cameras, collect_motions(team, inputs.cameras, subdomains, field.q), spread)
    evaluation = model.evaluate(field.q)
    cell_errors = _judge_cells(problem, model, evaluation)
    notes = (*notes, *describe_doubtful_cells(team, cell_errors))
    measurement = Measurement(inputs, frame, problem.reference.region, model, field.q, field.largest_jump, evaluation,
                              problem.size, solution.records, notes, motions, problem.noise, cell_errors,
                              solution.stop, failure or inverted)
    if inverted and not failure:
        raise as_collective(ConvergenceError(inverted, measurement))
    return measurement


def _judge_cells(problem: WeightedProblem, model: ResidualModel, evaluation: Evaluation) -> list[CellErrors]:
    """What the residual says about the cells of each owned subdomain; collective."""
    team = problem.team
    residuals = team.together(lambda: [
        measure_cell_residuals(of_subdomain.views[0].view, hessians[0], of_views[0])
        for of_subdomain, hessians, of_views in zip(model.views, problem.reference.hessians, evaluation.residuals,
                                                    strict=True)])
    return find_cell_errors(team, residuals)


def describe_inverted_cells(team: Team, subdomains: Sequence[Subdomain], q: Sequence[Array]) -> str:
    """Say which cells a field turns inside out, however small the last correction: no matter moves so; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        Owned ones.
    q : sequence of (n_unknowns,) array
        Their unknowns.

    Returns
    -------
    str
        Why the field is no result; empty where no cell is inverted.
    """
    found = team.gather_lists([s.cell_ids[find_inverted_cells(s.mesh, s.displacement(q_s))]
                               for s, q_s in zip(subdomains, q, strict=True)])
    cells = np.sort(np.concatenate(found))
    if not len(cells):
        return ""
    return (f"the measured field turns {len(cells)} elements inside out (numbers {list_first(cells)}): the images do "
            "not determine it; use larger elements or a longer regularization.cut_off_wavelength")
