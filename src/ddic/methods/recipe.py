"""The recipe that a case asks for.

Also what noise leaves in measured displacements, of a pair and of the frames of a series.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from ddic.errors import ConvergenceError, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.methods.dd_dic import Session
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement
from ddic.results.publishing import Publishable
from ddic.solvers.probing import estimate_response
from ddic.visibility.noise_forces import measure_force_noise

if TYPE_CHECKING:
    from ddic.methods.pgd_dic import SeparatedSession


Recipe: TypeAlias = "Session | SeparatedSession"
"""A prepared measurement."""


def prepare_recipe(team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                   first_frame: Frame | None = None) -> Recipe:
    """Prepare the reference images as the case's method does, PGD-DIC where the case has [pgd]; collective.

    ``first_frame`` is given where it is known already. Raises InputError, SingularSubdomainError or FactorizationError
    on all ranks, and StoppedError on all ranks where a signal asked one of them to stop.
    """
    stop_if_asked(team, "before the first iteration")
    if inputs.case.pgd is not None:
        from ddic.methods.pgd_dic import SeparatedSession

        return SeparatedSession(team, inputs, listener, clock)
    return Session(team, inputs, listener, clock, first_frame)


def estimate_noise_floor(recipe: Recipe, measurement: Publishable, clock: PhaseClock) -> float:
    """Estimate what noise of the residual's size leaves in a measured displacement; collective.

    Returns the RMS of a component at a node, pixels; nan for PGD-DIC, and where a linear step fails. The residual is
    taken to be noise, as strong as it acts on displacements; it also holds what the field cannot follow. With several
    cameras the noise is the one that weighs them. ``measurement`` is what the recipe measured last.
    """
    if not isinstance(recipe, Session) or not isinstance(measurement, Measurement):
        return float("nan")
    problem = recipe.problem
    with clock.phase(Phase.FINISH):
        try:
            counted = [~is_unmeasured for is_unmeasured in measurement.unmeasured]
            response = estimate_response(problem.team, problem.solver.assembly.systems, problem.solver.step, counted)
            if problem.noise:
                return problem.noise[0] * response.rms_per_grey
            noise = measure_force_noise(measurement.model, measurement.evaluation, measurement.q,
                                        response.n_determined,
                                        is_regularized=problem.solver.assembly.eta > 0)
            return noise.sigma * response.rms_per_grey
        except ConvergenceError as error:
            # What was measured stands without it; what this rank alone raises must end the job.
            if not is_collective(error):
                raise
            return float("nan")


class NoiseFloor:
    """Noise floors of the frames of a series: of the first by linear steps, of the others by their residuals.

    Parameters
    ----------
    recipe : Session
        That measures them.
    clock : PhaseClock
        Of the phases.
    """

    def __init__(self, recipe: Session, clock: PhaseClock) -> None:
        self._recipe, self._clock = recipe, clock
        self._by_grey_level: float | None = None

    def estimate(self, measurement: Measurement) -> float:
        """Estimate that of a frame, RMS of a component at a node, pixels; nan where a linear step fails; collective."""
        deviation = measurement.evaluation.grey[0].residual_std
        if self._by_grey_level is None:
            floor = estimate_noise_floor(self._recipe, measurement, self._clock)
            self._by_grey_level = floor / max(deviation, 1e-300)
        return self._by_grey_level * deviation
