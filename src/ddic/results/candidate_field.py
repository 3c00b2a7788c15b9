"""What a candidate of a sweep measured of the image pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ddic.io.result_reader import Result
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.measurement import Measurement
from ddic.results.publishing import gather
from ddic.solvers.probing import estimate_degrees_of_freedom, estimate_response


@dataclass(frozen=True, eq=False)
class CandidateField:
    """What a candidate measured of the pair.

    Attributes
    ----------
    result : Result or None
        The field, on every rank; None where there is none.
    residual : float
        RMS over the pixels that count, grey levels.
    n_pixels : int
        Their number.
    degrees_of_freedom : float
        tr(A^-1 M) and what the correction of grey levels takes, no unit.
    noise : float
        RMS of a component at nodes that noise is expected to leave, pixels.
    failure : str
        Why there is none; empty where there is one.
    """

    result: Result | None
    residual: float = float("nan")
    n_pixels: int = 0
    degrees_of_freedom: float = float("nan")
    noise: float = float("nan")
    failure: str = ""


def collect_candidate_field(problem: WeightedProblem, measurement: Measurement) -> CandidateField:
    """Collect field, residual, degrees of freedom and noise; collective.

    Parameters
    ----------
    problem : WeightedProblem
        That was solved; of one camera.
    measurement : Measurement
        What was measured last.

    Returns
    -------
    CandidateField
        The same on all ranks.

    Raises
    ------
    ConvergenceError
        On all ranks, where a linear step does not converge.
    """
    team, state = problem.team, measurement.evaluation.grey[0]
    systems, step = problem.solver.assembly.systems, problem.solver.step
    freedom = estimate_degrees_of_freedom(team, systems, step)
    counted = [~is_unmeasured for is_unmeasured in measurement.unmeasured]
    noise = state.residual_std / np.sqrt(2.0) * estimate_response(team, systems, step, counted).rms_per_grey
    result = gather(measurement)
    # A gain and an offset of each element follow noise as well.
    n_grey = 2 * result.mesh.n_cells if measurement.grey_correction == "element" else 0
    return CandidateField(result, state.residual_rms, state.n_pixels, freedom + n_grey, noise)
