"""The linear step on the whole region by conjugate gradients, A never formed."""

from collections.abc import Callable, Sequence

import numpy as np
from petsc4py import PETSc

from ddic.errors import ConvergenceError, as_collective
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.solvers.correction_size import measure_unit_size
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc import CONJUGATE_GRADIENT, PetscStack, create_ksp
from ddic.solvers.whole_system import WholeSystem

LOOK_EVERY = 4
"""Iterations between two estimates of the extreme eigenvalues: fewer estimate more often, more may iterate too long."""

OF_ALLOWED = 0.1
"""Share of the allowed error that is left: ten more iterations cost less than one more pass over the pixels. A larger
share iterates less and leaves more error."""


class ConjugateGradientStep:
    """Solves Eq. 11 of [BP17] for all subdomains at once, preconditioned by the diagonal D of A.

    Nothing is factorised: two products with Kbar_s and one with M_s an iteration, whose number grows with the cut-off
    wavelength. PETSc options (prefix ``cg_``): ``-cg_ksp_monitor``, ``-cg_ksp_type``... Making it raises
    SingularSubdomainError on all ranks, where an unknown is held by nothing.

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    systems : sequence of LocalSystem
        This rank's subdomains.
    tolerance : float
        On the relative error, by |e|/|dq| <= cond(D^-1 A) |z|/|z_0| with z = D^-1 times the residual.
    max_iterations : int
        Most iterations of one step.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], tolerance: float, max_iterations: int) -> None:
        self._tolerance = tolerance
        self._unit_size = measure_unit_size(team, [system.subdomain for system in systems])
        with PetscStack() as stack:
            self._whole = stack.keep(WholeSystem(team, systems))
            size = (self._whole.n_owned, PETSc.DETERMINE)
            self._matrix = stack.keep(PETSc.Mat())
            self._matrix.createPython((size, size), self._whole, comm=team.comm)
            self._matrix.setOption(PETSc.Mat.Option.SPD, True)
            self._matrix.setUp()
            self._left = stack.keep(self._whole.create_vector())
            self._right = stack.keep(self._whole.create_vector())
            self._residual = stack.keep(self._whole.create_vector())
            self._preconditioned = stack.keep(self._whole.create_vector())
            self._ksp = stack.keep(create_ksp(team.comm, CONJUGATE_GRADIENT))
            self._configure(max_iterations)
            self._objects = stack.pop_all()
        self.forget()

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq, with an estimate of its error; where copies of an unknown differ in q, q + dq is one field.

        The last solution is taken up again where that helps, as it does when one step is asked for more exactly. Raises
        ConvergenceError on all ranks, where ``max_iterations`` are not enough.
        """
        q_mean = self._whole.average_copies(q)
        self._whole.set_right_hand_side(self._right, q, b, q_mean)
        size = self._preconditioned_norm(self._right)
        begun = self._preconditioned_norm(self._residual_of_last())
        if not begun < size:
            self._left.set(0.0)
            begun = size
        self._ksp.setConvergenceTest(self._make_test(size, begun, allowed))
        self._ksp.setConvergenceHistory(reset=True)
        self._ksp.solve(self._right, self._left)
        iterations = int(self._ksp.getIterationNumber())
        norm = float(self._ksp.getResidualNorm())
        if self._ksp.getConvergedReason() < 0:
            raise as_collective(ConvergenceError(
                f"conjugate gradients did not converge in {iterations} iterations (relative "
                f"residual {norm / (size or 1.0):.1e}): the cut-off wavelength is too long for "
                'them, or nothing holds a part of the region; use solver.method = "dual", or raise '
                "solver.max_iterations"))
        history = np.array(self._ksp.getConvergenceHistory()) / (size or 1.0)
        dq = self._whole.find_correction(self._left, q, q_mean)
        return StepResult(dq, iterations, history, self._estimate_error(norm))

    def forget(self) -> None:
        """Forget the last solution, and the bounds of the eigenvalues that earlier steps found."""
        self._left.set(0.0)
        # Of D^-1 A, from all iterations so far.
        self._largest, self._lowest = 1.0, 1.0

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        self._objects.close()

    def _configure(self, max_iterations: int) -> None:
        """Set up the Krylov solver."""
        self._ksp.setOperators(self._matrix)
        self._ksp.setTolerances(max_it=max_iterations)
        self._ksp.setInitialGuessNonzero(True)
        self._ksp.setComputeSingularValues(True)
        self._ksp.setConvergenceHistory(length=max_iterations + 2, reset=True)
        self._ksp.setFromOptions()
        self._whole.check_diagonal(self._matrix)
        self._ksp.setUp()

    def _residual_of_last(self) -> PETSc.Vec:
        """Residual that the last solution leaves of the present right-hand side."""
        self._matrix.mult(self._left, self._residual)
        self._residual.aypx(-1.0, self._right)
        return self._residual

    def _preconditioned_norm(self, vector: PETSc.Vec) -> float:
        """|D^-1 vector|."""
        self._ksp.getPC().apply(vector, self._preconditioned)
        return float(self._preconditioned.norm())

    def _estimate_error(self, norm: float) -> float:
        """RMS over nodes of dq's error, pixels, from |D^-1 r|: A e = r, hence over the lowest eigenvalue of D^-1 A."""
        return norm / self._lowest * self._unit_size

    def _make_test(self, size: float, begun: float,
                   allowed: AllowedError | None) -> Callable[[PETSc.KSP, int, float], int]:
        """PETSc's test of convergence; size, begun: |D^-1 r| of the right-hand side and of the first guess."""

        def test(ksp: PETSc.KSP, iteration: int, norm: float) -> int:
            if not np.isfinite(norm):
                return int(PETSc.KSP.ConvergedReason.DIVERGED_NANORINF)
            if iteration % LOOK_EVERY:
                return 0
            if iteration:
                largest, lowest = ksp.computeExtremeSingularValues()
                self._largest = max(self._largest, largest)
                self._lowest = min(self._lowest, lowest)
            condition = self._largest / self._lowest
            if norm <= self._tolerance * size / condition:
                return int(PETSc.KSP.ConvergedReason.CONVERGED_RTOL)
            if allowed is None or iteration == 0:
                return 0
            error = OF_ALLOWED * max(allowed.rms, allowed.share * self._estimate_error(begun))
            return int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL) if self._estimate_error(norm) <= error else 0

        return test
