"""The linear step of Gauss-Newton by dual domain decomposition: dq_s and S_tot, Eq. 24-31 of [BP17].

The interface problem S_tot v = t_tot is solved by GMRES, with directions kept from earlier ones with the same operator.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc
from scipy import linalg

from ddic.arrays import Array
from ddic.errors import ConvergenceError, as_collective
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.dual.coarse_space import CoarseSpace
from ddic.solvers.dual.dual_problem import DualProblem, DualSchurOperator, LocalDual
from ddic.solvers.dual.preconditioner import LocalInverseKind, Preconditioner, Preconditioning, build_preconditioner
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_system import LocalOperator, LocalSystem
from ddic.solvers.petsc import DUAL, PetscOwner, PetscStack, create_ksp


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


LARGEST = 128
"""Directions kept; the oldest go first. They cost two interface vectors each, far less than the local factors. More
save iterations and cost products with them in each."""

_DEPENDENT = 1e-10
"""Share of the largest eigenvalue of the new images' Gram matrix below which they count as dependent."""


class RecycledSpace:
    """Pairs (U, C) with S_tot U = C and C^T C = I, spread over ranks by interface rows.

    Remark 9 of [BP17]: the operator is constant over Gauss-Newton, so what one Krylov solver learnt serves the next.
    With r = t - S_tot v, the step v + U C^T r leaves the least residual over U; the Krylov solver then works on
    (I - C C^T) S_tot (as GCRO does), so that no direction is paid for twice.

    Parameters
    ----------
    team : Team
        All ranks.
    n_owned : int
        How many interface rows this rank owns.
    """

    def __init__(self, team: Team, n_owned: int) -> None:
        self._team, self._n_owned = team, n_owned
        self.forget()

    def forget(self) -> None:
        """Keep nothing."""
        self._directions: Array = np.zeros((self._n_owned, 0))
        self._images: Array = np.zeros((self._n_owned, 0))

    @property
    def size(self) -> int:
        """Number of directions kept."""
        return self._images.shape[1]

    def reduce(self, residual: Array, solution: Array) -> None:
        """Add U C^T r to a solution v and take C C^T r from its residual r, owned rows, in place; collective."""
        coefficients = self._find_coefficients(residual)
        solution += self._directions @ coefficients
        residual -= self._images @ coefficients

    def project(self, vector: Array) -> None:
        """Take C C^T x from x, owned rows, in place; collective."""
        vector -= self._images @ self._find_coefficients(vector)

    def learn(self, directions: Array, images: Array) -> None:
        """Keep what is new in some pairs y, S_tot y, (n_owned, k) both; collective."""
        # Twice, for after once the new images are orthogonal to the old ones to a few digits only.
        for _ in range(2):
            coefficients = self._team.sum(self._images.T @ images)
            directions = directions - self._directions @ coefficients
            images = images - self._images @ coefficients
            directions, images = self._orthonormalize(directions, images)
        self._directions = np.hstack([self._directions, directions])[:, -LARGEST:]
        self._images = np.hstack([self._images, images])[:, -LARGEST:]

    def _orthonormalize(self, directions: Array, images: Array) -> tuple[Array, Array]:
        """Combine pairs so that their images are orthonormal; dependent ones go."""
        gram = self._team.sum(images.T @ images)
        values, vectors = linalg.eigh(gram)
        largest = max(float(values.max(initial=0.0)), 1e-300)
        is_independent = values > _DEPENDENT * largest
        change = vectors[:, is_independent] / np.sqrt(values[is_independent])
        return directions @ change, images @ change

    def _find_coefficients(self, vector: Array) -> Array:
        """C^T x."""
        return self._team.sum(self._images.T @ vector)


class _Deflated:
    """Context of the shell matrix (I - C C^T) S_tot, which notes the products asked of it until it learns them."""

    def __init__(self, operator: DualSchurOperator) -> None:
        self.space = RecycledSpace(operator.exchange.team, operator.exchange.n_owned)
        self._operator = operator
        self._products: list[tuple[Array, Array]] = []

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply by (I - C C^T) S_tot: PETSc's callback."""
        self._operator.mult(matrix, x, y)
        self._products.append((np.array(x.getArray(readonly=1)), np.array(y.getArray(readonly=1))))
        self.space.project(y.getArray())

    def forget_products(self) -> None:
        """Drop the products noted by a solution that failed."""
        self._products.clear()

    def learn(self) -> None:
        """Keep the products noted since the last time."""
        if self._products:
            directions, images = (np.stack(vectors, axis=1) for vectors in zip(*self._products, strict=True))
            self.space.learn(directions, images)
            self._products.clear()


UNREACHED = 1e-300
"""Residual norm that no iteration reaches, where another test is to stop it, and that is not quite zero."""


class _InterfaceSolver(PetscOwner):
    """GMRES on S_tot, right-preconditioned by P, which remembers earlier right-hand sides.

    ``multipliers`` are v, the last solution, from which the next one starts, ``residual`` is t_tot - S_tot v. A
    preconditioner with a coarse space wants residuals free of it.
    """

    def __init__(self, operator: DualSchurOperator, preconditioner: Preconditioning | None,
                 coarse: CoarseSpace | None, settings: DualSettings) -> None:
        self._coarse = coarse
        self._deflated: _Deflated | None = None
        with PetscStack() as stack:
            exchange = operator.exchange
            self._schur = stack.keep(exchange.create_matrix(operator))
            self.multipliers = stack.keep(exchange.create_vector())
            self.residual = stack.keep(exchange.create_vector())
            self._change = stack.keep(exchange.create_vector())
            matrix = self._schur
            if settings.recycle and preconditioner is not None:
                self._deflated = _Deflated(operator)
                matrix = stack.keep(exchange.create_matrix(self._deflated))
            self.ksp = stack.keep(create_ksp(exchange.team.comm, DUAL))
            self.ksp.setOperators(matrix)
            self._configure(preconditioner, settings)
            self._objects = stack.pop_all()
        self.tolerance = float(self.ksp.getTolerances()[0])

    def forget(self) -> None:
        """Forget the last solution and the directions that were kept."""
        self.multipliers.set(0.0)
        if self._deflated is not None:
            self._deflated.space.forget()

    def start(self, right: PETSc.Vec) -> float:
        """Bring coarse space and kept directions to bear on the last solution, return |t_tot - S_tot v|; collective."""
        self._renew_residual(right)
        norm = float(self.residual.norm())
        if not norm <= right.norm():
            # The last solution is further off than none, as it is after a frame that diverged.
            self.multipliers.set(0.0)
            right.copy(self.residual)
            norm = float(self.residual.norm())
        if self._coarse is not None and norm > self.tolerance * right.norm():
            # A-DEF2 expects a residual free of coarse components.
            self._coarse.correct(self.residual, self.multipliers)
            self._renew_residual(right)
        return self._use_kept()

    def solve(self, right: PETSc.Vec, stop: float) -> tuple[int, Array]:
        """Iterate on t_tot from ``start`` until the norm of the residual is no larger than ``stop``; collective.

        Returns the number of iterations and the norms of the residual. Raises ConvergenceError on all ranks.
        """
        if not np.isfinite(stop):
            raise as_collective(ConvergenceError(
                "the right-hand side of the interface problem is not finite; check the start of the displacement and "
                "the texture"))
        # The system is solved for the change of v, whose right-hand side is no measure of the residual: hence atol.
        self.ksp.setTolerances(rtol=1e-50, atol=max(stop, UNREACHED))
        self.ksp.setConvergenceHistory(reset=True)
        self._change.set(0.0)
        if self._deflated is not None:
            self._deflated.forget_products()
        self.ksp.solve(self.residual, self._change)
        n_iterations = int(self.ksp.getIterationNumber())
        if self.ksp.getConvergedReason() < 0:
            raise as_collective(ConvergenceError(
                f"the interface problem did not converge in {n_iterations} Krylov iterations "
                f"(relative residual {self.ksp.getResidualNorm() / (right.norm() or 1.0):.1e}); raise "
                'solver.max_iterations, or choose solver.preconditioner = "two_level" or fewer, larger subdomains'))
        self.multipliers.axpy(1.0, self._change)
        if n_iterations:
            self._renew_residual(right)
            self._use_kept()
        if self._deflated is not None:
            self._deflated.learn()
        return n_iterations, np.array(self.ksp.getConvergenceHistory())

    def precondition_residual(self) -> PETSc.Vec:
        """Apply P to the residual: about the error of the multipliers, a vector the caller's to destroy; collective."""
        out = self.residual.duplicate()
        self.ksp.getPC().apply(self.residual, out)
        return out

    def _renew_residual(self, right: PETSc.Vec) -> None:
        """Set the residual to t_tot - S_tot v."""
        self._schur.mult(self.multipliers, self.residual)
        self.residual.aypx(-1.0, right)

    def _use_kept(self) -> float:
        """Take from the residual what kept directions can; returns its norm."""
        if self._deflated is not None:
            self._deflated.space.reduce(self.residual.getArray(), self.multipliers.getArray())
        return float(self.residual.norm())

    def _configure(self, preconditioner: Preconditioning | None, settings: DualSettings) -> None:
        """Set up the Krylov solver, the user's options last."""
        n_rows, max_iterations = max(self.multipliers.getSize(), 1), settings.max_iterations
        self.ksp.setTolerances(rtol=settings.tolerance, atol=UNREACHED, divtol=1e12, max_it=max_iterations)
        self.ksp.setType(PETSc.KSP.Type.FGMRES)
        self.ksp.setGMRESRestart(min(max_iterations, n_rows) + 1)
        self.ksp.setConvergenceHistory(length=max_iterations + 2, reset=True)
        pc = self.ksp.getPC()
        if preconditioner is None:
            pc.setType(PETSc.PC.Type.NONE)
        else:
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(preconditioner)
        self.ksp.setFromOptions()


class DualStep(PetscOwner):
    """Solves for dq_s by S_tot (Lambda, LambdaBar) = t_tot, Eq. 24-25 of [BP17], with several cameras Eq. 23.

    Factors are kept, and the interface problem starts from the previous multipliers. Making it raises
    SingularSubdomainError on all ranks.

    PETSc options (prefix ``dual_``): ``-dual_ksp_monitor``, ``-dual_ksp_type``, ``-dual_ksp_rtol``...

    Parameters
    ----------
    team, systems, operators, scale : Team, sequence of LocalSystem, sequence of LocalOperator, float
        As ``DualProblem`` takes them.
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
            self._interface = stack.keep(_InterfaceSolver(self._problem.operator, preconditioner, coarse, settings))
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
        free = q.map(_solve_alone, b, problem.local_duals)
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
        nothing = Field(self._problem.team, subdomains, (np.zeros(s.n_field) for s in subdomains))
        with PetscStack() as stack:
            multipliers = stack.keep(self._interface.precondition_residual())
            return self._problem.correct(nothing, multipliers).measure_rms()


def _solve_alone(subdomain: Subdomain, q_s: Array, b_s: Array, local: LocalDual) -> Array:
    """A_s^-1 (b_s - eta Kbar_s^T Kbar_s u_s), the motion of the subdomain's camera held."""
    n = subdomain.n_field
    return local.operator.solve(local.system.right_hand_side(b_s[:n], q_s[:n]))
