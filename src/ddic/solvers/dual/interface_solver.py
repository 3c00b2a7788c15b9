"""The Krylov solution of the interface problem S_tot v = t_tot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.errors import ConvergenceError, on_all_ranks
from ddic.solvers.dual.coarse_space import CoarseSpace
from ddic.solvers.dual.recycling import RecycledSpace
from ddic.solvers.dual.schur_operator import DualSchurOperator
from ddic.solvers.dual.shell import Preconditioning
from ddic.solvers.petsc_defaults import DUAL, configured_ksp


@dataclass(frozen=True)
class InterfaceSettings:
    """tolerance: on |t_tot - S_tot v| / |t_tot|; max_iterations: also GMRES's restart; recycle: keep directions."""

    tolerance: float
    max_iterations: int
    recycle: bool


class InterfaceSolver:
    """GMRES on S_tot, right-preconditioned, which remembers earlier right-hand sides.

    ``multipliers`` hold the last solution, from which the next one starts; ``residual`` is t_tot - S_tot v.
    PETSc options (prefix ``dual_``): ``-dual_ksp_monitor``, ``-dual_ksp_type``, ``-dual_ksp_rtol``...
    """

    def __init__(self, operator: DualSchurOperator, preconditioner: Preconditioning | None,
                 coarse: CoarseSpace | None, settings: InterfaceSettings) -> None:
        self._operator = operator
        self._coarse = coarse
        self._schur = operator.as_matrix()
        self.multipliers = self._schur.createVecRight()
        self.residual = self.multipliers.duplicate()
        self._change = self.multipliers.duplicate()
        self._deflated = _Deflated(operator, self.multipliers.getLocalSize()) if settings.recycle else None
        self._matrix = self._schur if self._deflated is None else operator.shell(self._deflated)
        self.ksp = self._configure(preconditioner, settings)
        self.tolerance = float(self.ksp.getTolerances()[0])

    def start(self, right: PETSc.Vec) -> float:
        """Bring coarse space and kept directions to bear on the last solution; returns |t_tot - S_tot v|."""
        self._renew_residual(right)
        norm = float(self.residual.norm())
        if self._coarse is not None and norm > self.tolerance * right.norm():
            # A-DEF2 expects a residual free of coarse components.
            self._coarse.correct(self.residual, self.multipliers)
            self._renew_residual(right)
        return self._use_kept()

    def solve(self, right: PETSc.Vec, stop: float) -> tuple[int, NDArray[np.float64]]:
        """Iterate from ``start`` until the residual's norm is at most ``stop``.

        Returns the number of iterations and the norms. Raises ConvergenceError on all ranks.
        """
        if not np.isfinite(stop):
            raise on_all_ranks(ConvergenceError(
                "the right-hand side of the interface problem is not finite; check the start of the displacement and "
                "the texture"))
        # The system is solved for the change of v, whose right-hand side is no measure of the residual: hence atol.
        self.ksp.setTolerances(rtol=1e-50, atol=max(stop, 1e-300))
        self.ksp.setConvergenceHistory(reset=True)
        self._change.set(0.0)
        self.ksp.solve(self.residual, self._change)
        if self.ksp.getConvergedReason() < 0:
            raise on_all_ranks(ConvergenceError(
                f"the interface problem did not converge in {self.ksp.getIterationNumber()} Krylov iterations "
                f"(relative residual {self.ksp.getResidualNorm() / (right.norm() or 1.0):.1e}); raise "
                'solver.max_iterations, or choose solver.preconditioner = "two_level" or fewer, larger subdomains'))
        self.multipliers.axpy(1.0, self._change)
        iterations = int(self.ksp.getIterationNumber())
        if iterations:
            self._renew_residual(right)
            self._use_kept()
        if self._deflated is not None:
            self._deflated.learn()
        return iterations, np.array(self.ksp.getConvergenceHistory())

    def preconditioned(self) -> PETSc.Vec:
        """P applied to the residual: about the error that is left in the multipliers; the caller destroys it."""
        out = self.residual.duplicate()
        self.ksp.getPC().apply(self.residual, out)
        return out

    def destroy(self) -> None:
        """Free PETSc's objects."""
        for thing in (self.ksp, self._matrix, self._schur, self.multipliers, self.residual, self._change):
            thing.destroy()

    def _renew_residual(self, right: PETSc.Vec) -> None:
        self._schur.mult(self.multipliers, self.residual)
        self.residual.aypx(-1.0, right)

    def _use_kept(self) -> float:
        if self._deflated is not None:
            self._deflated.space.reduce(self.residual.getArray(), self.multipliers.getArray())
        return float(self.residual.norm())

    def _configure(self, preconditioner: Preconditioning | None, settings: InterfaceSettings) -> PETSc.KSP:
        ksp = configured_ksp(self._operator.comm, DUAL)
        ksp.setOperators(self._matrix)
        ksp.setTolerances(rtol=settings.tolerance, atol=1e-300, divtol=1e12, max_it=settings.max_iterations)
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(min(settings.max_iterations, max(self.multipliers.getSize(), 1)) + 1)
        ksp.setConvergenceHistory(length=settings.max_iterations + 2, reset=True)
        pc = ksp.getPC()
        if preconditioner is None:
            pc.setType(PETSc.PC.Type.NONE)
        else:
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(preconditioner)
        ksp.setFromOptions()
        return ksp


class _Deflated:
    """Context of the shell matrix (I - C C^T) S_tot, which notes the products asked of it until it learns them."""

    def __init__(self, operator: DualSchurOperator, n_owned: int) -> None:
        self.space = RecycledSpace(operator.comm, n_owned)
        self._operator = operator
        self._directions: list[NDArray[np.float64]] = []
        self._images: list[NDArray[np.float64]] = []

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = (I - C C^T) S_tot x."""
        self._operator.mult(matrix, x, y)
        self._directions.append(np.array(x.getArray(readonly=1)))
        self._images.append(np.array(y.getArray(readonly=1)))
        self.space.project(y.getArray())

    def learn(self) -> None:
        """Keep the products noted since the last time."""
        if self._directions:
            self.space.learn(np.stack(self._directions, axis=1), np.stack(self._images, axis=1))
            self._directions.clear()
            self._images.clear()
