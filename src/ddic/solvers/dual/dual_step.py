"""The linear step of Gauss-Newton by dual domain decomposition: dq_s and S_tot, Eq. 24-31 of [BP17]."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from ddic.arrays import Array
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.dual.dual_problem import DualProblem
from ddic.solvers.dual.interface_solver import InterfaceSolver
from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.dual.preconditioner import LocalInverseKind, Preconditioner, build_preconditioner
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_system import LocalOperator, LocalSystem
from ddic.solvers.petsc import PetscStack


@dataclass(frozen=True)
class DualSettings:
    """How the interface problem is solved.

    Attributes
    ----------
    preconditioner : Preconditioner
        None, the paper's, the paper's with scaled assembly, or that with a coarse space.
    tolerance : float
        On the interface residual relative to |t_tot|.
    max_iterations : int
        Most Krylov iterations of a step, also GMRES's restart.
    recycle : bool
        Whether Krylov directions are kept for later steps; not without a preconditioner.
    local_inverse : LocalInverseKind
        S_s^-1 as an array, by a sparse factor, or as its size asks.
    """

    preconditioner: Preconditioner = "scaled"
    tolerance: float = 1e-6
    max_iterations: int = 1000
    recycle: bool = True
    local_inverse: LocalInverseKind = "auto"


class DualStep:
    """Solves for dq_s by S_tot (Lambda, LambdaBar) = t_tot, Eq. 24-25 of [BP17], with several cameras Eq. 23.

    Factors are kept, and the interface problem starts from the previous multipliers. Making it raises
    SingularSubdomainError on all ranks.

    PETSc options (prefix ``dual_``): ``-dual_ksp_monitor``, ``-dual_ksp_type``, ``-dual_ksp_rtol``...

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    systems : sequence of LocalSystem
        This rank's subdomains.
    operators : sequence of LocalOperator
        Their A_s factorised, motions of cameras held; they stay their maker's to destroy.
    scale : float
        c of ``build_local_dual``.
    settings : DualSettings
        How the interface problem is solved.
    clock : PhaseClock, optional
        Told how far the set-up is.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], operators: Sequence[LocalOperator],
                 scale: float, settings: DualSettings, clock: PhaseClock | None = None) -> None:
        with PetscStack() as stack:
            self._problem = stack.keep(DualProblem(team, systems, operators, scale))
            preconditioner, coarse = build_preconditioner(stack, self._problem, settings.preconditioner,
                                                          settings.local_inverse, clock)
            self._has_preconditioner = preconditioner is not None
            self._interface = stack.keep(InterfaceSolver(
                self._problem.operator, preconditioner, coarse, settings.tolerance, settings.max_iterations,
                recycle=settings.recycle and self._has_preconditioner))
            self._right = stack.keep(self._problem.exchange.create_vector())
            self._objects = stack.pop_all()

    @property
    def ksp(self) -> PETSc.KSP:
        """PETSc's Krylov solver, for monitors."""
        return self._interface.ksp

    @property
    def n_interface(self) -> int:
        """Number of rows of the interface problem."""
        return self._problem.exchange.n_global

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq, with an estimate of its error; collective. Raises ConvergenceError on all ranks."""
        problem = self._problem
        free = q.map(_solve_alone, b, problem.systems, problem.local_duals)
        if self.n_interface == 0:
            return StepResult(free)
        problem.set_right_hand_side(self._right, free, q, b)
        size = float(self._right.norm())
        stop, error = self._find_stop(size, allowed)
        iterations, norms = self._interface.solve(self._right, stop)
        multipliers = self._interface.multipliers
        dq = problem.append_motion(problem.correct(free, multipliers), multipliers)
        if iterations > 0 or error is None:
            error = self._estimate_error()
        return StepResult(dq, iterations, norms / (size or 1.0), error)

    def forget(self) -> None:
        """Forget the last multipliers and the directions that were kept."""
        self._interface.forget()

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        self._objects.close()

    def _find_stop(self, size: float, allowed: AllowedError | None) -> tuple[float, float | None]:
        """Norm of the residual at which GMRES may stop, of the tolerance or of the displacement error allowed.

        And the error before its first iteration, where that was asked for.
        """
        norm = self._interface.start(self._right)
        finest = self._interface.tolerance * size
        if allowed is None or norm <= finest:
            return finest, None
        error = self._estimate_error()
        share = max(allowed.rms / error, allowed.share) if error > 0 else 0.0
        return max(finest, norm * share), error

    def _estimate_error(self) -> float:
        """RMS over nodes of A_s^-1 G_s^T P (t_tot - S_tot v), pixels: dq's error, as far as P is like S_tot^-1."""
        if not self._has_preconditioner:
            return float("nan")
        subdomains = self._problem.subdomains
        nothing = Field(self._problem.team, subdomains, [np.zeros(s.n_field) for s in subdomains])
        with PetscStack() as stack:
            multipliers = stack.keep(self._interface.precondition_residual())
            return self._problem.correct(nothing, multipliers).measure_rms()


def _solve_alone(subdomain: Subdomain, q_s: Array, b_s: Array, system: LocalSystem, local: LocalDual) -> Array:
    """A_s^-1 (b_s - eta Kbar_s^T Kbar_s u_s), the motion of the subdomain's camera held."""
    n = subdomain.n_field
    return local.operator.solve(system.right_hand_side(b_s[:n], q_s[:n]))
