"""The linear step on the whole mesh by conjugate gradients, A never formed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.errors import ConvergenceError, on_all_ranks
from ddic.parallel.team import Team
from ddic.solvers.linear_step import Leave, StepResult
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc_defaults import CONJUGATE_GRADIENT, configured_ksp
from ddic.solvers.whole_system import WholeSystem

LOOK_EVERY = 4
"""Iterations between two estimates of the extreme eigenvalues."""

OF_ALLOWED = 0.1
"""Share of the allowed error that is left: ten more iterations cost less than one more pass over the pixels."""


class ConjugateGradientStep:
    """Solves Eq. 11 of [BP17] for all subdomains at once, preconditioned by the diagonal D of A.

    Nothing is factorised: two products with Kbar_s and one with M_s an iteration, whose number grows with the cut-off
    wavelength. PETSc options (prefix ``cg_``): ``-cg_ksp_monitor``, ``-cg_ksp_type``...
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], tolerance: float, max_iterations: int) -> None:
        """Set up; collective.

        systems: this rank's subdomains; tolerance: on the relative error, by |e|/|dq| <= cond(D^-1 A) |z|/|z_0| with
        z = D^-1 times the residual. Raises SingularSubdomainError on all ranks where a dof is held by nothing.
        """
        self._tolerance = tolerance
        self._whole = WholeSystem(team, systems)
        size = (self._whole.n_owned, PETSc.DETERMINE)
        self._matrix = PETSc.Mat().createPython((size, size), _Product(self._whole), comm=team.comm)
        self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._matrix.setUp()
        self._left, self._right, self._residual = (self._whole.new_vector() for _ in range(3))
        self._root_n_nodes = float(np.sqrt(self._left.getSize() / systems[0].subdomain.mesh.dim))
        self._largest, self._lowest = 1.0, 1.0
        self._ksp = configured_ksp(team.comm, CONJUGATE_GRADIENT)
        try:
            self._configure(max_iterations)
        except BaseException:
            self.destroy()
            raise

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              leave: Leave | None = None) -> StepResult:
        """Solve for dq_s; where copies of a node differ in q, q + dq is one field. Raises ConvergenceError.

        The last solution is taken up again where that helps, as it does when one step is asked for more exactly.
        """
        mean = self._whole.mean_of_copies(q)
        self._whole.set_right_hand_side(self._right, q, b, mean)
        size = self._preconditioned_norm(self._right)
        begun = self._preconditioned_norm(self._residual_of_last())
        if not begun < size:
            self._left.set(0.0)
            begun = size
        self._ksp.setConvergenceTest(self._stop(size, begun, leave))
        self._ksp.setConvergenceHistory(reset=True)
        self._ksp.solve(self._right, self._left)
        if self._ksp.getConvergedReason() < 0:
            raise on_all_ranks(ConvergenceError(
                f"conjugate gradients did not converge in {self._ksp.getIterationNumber()} iterations (relative "
                f"residual {self._ksp.getResidualNorm() / (size or 1.0):.1e}): the cut-off wavelength is too long for "
                'them, or nothing holds a part of the region; use solver.method = "dual", or raise '
                "solver.max_iterations"))
        return StepResult(self._whole.corrections(self._left, q, mean), int(self._ksp.getIterationNumber()),
                          np.array(self._ksp.getConvergenceHistory()) / (size or 1.0),
                          self._error(self._ksp.getResidualNorm()))

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        for thing in (self._ksp, self._matrix, self._left, self._right, self._residual, self._whole):
            thing.destroy()

    def _configure(self, max_iterations: int) -> None:
        self._ksp.setOperators(self._matrix)
        self._ksp.setTolerances(max_it=max_iterations)
        self._ksp.setInitialGuessNonzero(True)
        self._ksp.setComputeSingularValues(True)
        self._ksp.setConvergenceHistory(length=max_iterations + 2, reset=True)
        self._ksp.setFromOptions()
        self._whole.refuse_unheld(self._matrix)
        self._ksp.setUp()

    def _residual_of_last(self) -> PETSc.Vec:
        self._matrix.mult(self._left, self._residual)
        self._residual.aypx(-1.0, self._right)
        return self._residual

    def _preconditioned_norm(self, vector: PETSc.Vec) -> float:
        out = vector.duplicate()
        self._ksp.getPC().apply(vector, out)
        norm = float(out.norm())
        out.destroy()
        return norm

    def _error(self, norm: float) -> float:
        """RMS over nodes of dq's error, pixels, from |D^-1 r|: A e = r, hence over the lowest eigenvalue of D^-1 A."""
        return norm / (self._lowest * self._root_n_nodes)

    def _stop(self, size: float, begun: float, leave: Leave | None) -> Callable[[PETSc.KSP, int, float], int]:
        """PETSc's test of convergence; size, begun: |D^-1 r| of the right-hand side and of the first guess."""

        def test(ksp: PETSc.KSP, iteration: int, norm: float) -> int:
            if not np.isfinite(norm):
                return int(PETSc.KSP.ConvergedReason.DIVERGED_NANORINF)
            if iteration % LOOK_EVERY:
                return 0
            if iteration:
                largest, lowest = ksp.computeExtremeSingularValues()
                self._largest, self._lowest = max(self._largest, largest), min(self._lowest, lowest)
            if norm <= self._tolerance * size * self._lowest / self._largest:
                return int(PETSc.KSP.ConvergedReason.CONVERGED_RTOL)
            if leave is None or iteration == 0:
                return 0
            allowed = OF_ALLOWED * max(leave.error, leave.share * self._error(begun))
            return int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL) if self._error(norm) <= allowed else 0

        return test


class _Product:
    """Context of the shell matrix A."""

    def __init__(self, whole: WholeSystem) -> None:
        self._whole = whole

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = A x."""
        exchange = self._whole.exchange
        exchange.add_to_owners(self._whole.apply(exchange.to_ghosts(x)), y)

    def getDiagonal(self, _: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """PETSc's callback for D; rows of Kbar on interfaces are squared one by one, for it only preconditions."""
        whole = self._whole
        parts = [s.hessian.diagonal() + s.eta * np.asarray(kbar.power(2).sum(axis=0)).ravel()
                 for s, kbar in zip(whole.systems, whole.kbars, strict=True)]
        whole.exchange.add_to_owners(whole.added(parts), diagonal)
