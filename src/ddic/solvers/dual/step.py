"""The linear step of Gauss-Newton by dual domain decomposition, Eq. 24-31 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import ConvergenceError, on_all_ranks
from ddic.parallel.team import Team
from ddic.partition.incidence import copies_of, rows_of, scaled_incidence
from ddic.solvers.dual.coarse_space import CoarseSpace, coarse_columns
from ddic.solvers.dual.exchange import Exchange
from ddic.solvers.dual.local_dual import local_dual
from ddic.solvers.dual.local_modes import low_energy_modes
from ddic.solvers.dual.preconditioner import (
    DualPreconditioner,
    LocalPreconditioner,
    block_inverse,
    local_schur,
)
from ddic.solvers.dual.schur_operator import DualSchurOperator
from ddic.solvers.dual.two_level import TwoLevelPreconditioner
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc_defaults import DUAL, configured_ksp
from ddic.solvers.step import StepResult

Preconditioner = Literal["none", "paper", "scaled", "two_level"]


@dataclass(frozen=True)
class DualSettings:
    """How the interface problem is solved.

    preconditioner: none, the paper's, the paper's with scaled assembly, or that with a coarse space;
    tolerance: on the interface residual relative to |t_tot|; max_iterations: also GMRES's restart;
    coarse_modes: low-energy modes of each subdomain in the coarse space.
    """

    preconditioner: Preconditioner = "scaled"
    tolerance: float = 1e-6
    max_iterations: int = 1000
    coarse_modes: int = 16


class DualStep:
    """Solves Eq. 24-25 for dq with factors kept, warm-started with the previous multipliers.

    PETSc options (prefix ``dual_``): ``-dual_ksp_monitor``, ``-dual_ksp_type``, ``-dual_ksp_rtol``...
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], operators: Sequence[LocalOperator],
                 scale: float, settings: DualSettings) -> None:
        """Set up the interface operators and the preconditioner.

        systems, operators: this rank's subdomains and their factors; scale: c of ``local_dual``.
        Raises SingularSubdomainError on all ranks.
        """
        comm = team.comm
        self._team = team
        self._systems = systems
        parts = [system.subdomain for system in systems]
        needed = [rows_of(interface) for p in parts for interface in (p.displacement, p.reaction)]
        self._exchange = Exchange(comm, sum(p.n_owned_rows for p in parts), needed)
        self._locals = [local_dual(s, a, self._exchange.ghosts, scale)
                        for s, a in zip(systems, operators, strict=True)]
        self._multipliers = self._exchange.new_vector()
        self._right = self._exchange.new_vector()
        self._coarse: CoarseSpace | None = None
        self._tolerance = settings.tolerance
        self._ksp = self._configure(comm, settings)

    @property
    def ksp(self) -> PETSc.KSP:
        """PETSc's Krylov solver, for monitors."""
        return self._ksp

    @property
    def n_interface(self) -> int:
        """Number of interface unknowns."""
        return self._exchange.n_global

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]]) -> StepResult:
        """Solve for dq_s given q_s and b_s of this rank's subdomains; raises ConvergenceError."""
        right = [system.right_hand_side(b_s, q_s) for system, b_s, q_s in zip(self._systems, b, q, strict=True)]
        free = [local.operator.solve(r) for local, r in zip(self._locals, right, strict=True)]
        history = self._solve_interface([q_s + y for q_s, y in zip(q, free, strict=True)])
        dq = self.correction(free, self._multipliers)
        return StepResult(dq, self._ksp.getIterationNumber() if self.n_interface else 0, history)

    def correction(self, free: Sequence[NDArray[np.float64]], multipliers: PETSc.Vec) -> list[NDArray[np.float64]]:
        """Correction dq_s = free_s - A_s^-1 G_s^T v, free_s the part without multipliers v, Eq. 24a of [BP17]."""
        v = self._exchange.to_ghosts(multipliers)
        return [y - local.operator.solve(local.jump_transposed @ v)
                for y, local in zip(free, self._locals, strict=True)]

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        for thing in (self._ksp, self._matrix, self._multipliers, self._right, self._exchange, self._coarse):
            if thing is not None:
                thing.destroy()

    def _solve_interface(self, freed: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """S_tot v = t_tot = sum_s G_s (q_s + A_s^-1 (b_s - eta Kbar_s^T Kbar_s q_s)), Eq. 25-27 of [BP17]."""
        if self.n_interface == 0:
            return np.zeros(0)
        total = np.zeros(len(self._exchange.ghosts))
        for local, displacement in zip(self._locals, freed, strict=True):
            total += local.jump @ displacement
        self._exchange.add_to_owners(total, self._right)
        if self._coarse is not None:
            self._correct_start(self._coarse)
        self._ksp.setConvergenceHistory(reset=True)
        self._ksp.solve(self._right, self._multipliers)
        size = self._right.norm()
        history = np.array(self._ksp.getConvergenceHistory()) / (size if size > 0 else 1.0)
        if self._ksp.getConvergedReason() < 0:
            raise on_all_ranks(ConvergenceError(
                f"the interface problem did not converge in {self._ksp.getIterationNumber()} Krylov iterations "
                f"(relative residual {self._ksp.getResidualNorm() / (size or 1.0):.1e}); raise solver.max_iterations, "
                'or choose solver.preconditioner = "scaled" or fewer, larger subdomains'))
        return history

    def _correct_start(self, coarse: CoarseSpace) -> None:
        """Add Q (t_tot - S_tot v) to the start v: A-DEF2 expects a residual free of coarse components."""
        residual = self._right.duplicate()
        self._matrix.mult(self._multipliers, residual)
        residual.aypx(-1.0, self._right)
        if residual.norm() > self._tolerance * self._right.norm():
            coarse.correct(residual, None, self._multipliers)
        residual.destroy()

    def _configure(self, comm: MPI.Comm, settings: DualSettings) -> PETSc.KSP:
        ksp = configured_ksp(comm, DUAL)
        self._matrix = DualSchurOperator(self._exchange, self._locals).as_matrix()
        ksp.setOperators(self._matrix)
        ksp.setTolerances(rtol=settings.tolerance, atol=1e-300, divtol=1e12, max_it=settings.max_iterations)
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(min(settings.max_iterations, max(self.n_interface, 1)) + 1)
        ksp.setInitialGuessNonzero(True)
        ksp.setConvergenceHistory(length=settings.max_iterations + 2, reset=True)
        pc = ksp.getPC()
        if settings.preconditioner == "none":
            pc.setType(PETSc.PC.Type.NONE)
        else:
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(self._preconditioner(comm, settings))
        ksp.setFromOptions()
        return ksp

    def _preconditioner(self, comm: MPI.Comm,
                        settings: DualSettings) -> DualPreconditioner | TwoLevelPreconditioner:
        plain = settings.preconditioner == "paper"
        assemblies = [local.incidence for local in self._locals] if plain else self._scaled_assemblies(comm)
        schurs = self._team.together(lambda: [local_schur(local) for local in self._locals])
        terms = self._team.together(lambda: [
            LocalPreconditioner(assembly, block_inverse(schur, local.n_displacement))
            for assembly, schur, local in zip(assemblies, schurs, self._locals, strict=True)
        ])
        one_level = DualPreconditioner(self._exchange, terms)
        if settings.preconditioner != "two_level":
            return one_level
        columns = self._team.together(lambda: [
            coarse_columns(low_energy_modes(system.operator, local.operator, system.subdomain.mesh,
                                            settings.coarse_modes), local)
            for system, local in zip(self._systems, self._locals, strict=True)
        ])
        self._coarse = CoarseSpace(self._team, self._exchange, self._locals, assemblies, schurs, columns)
        return TwoLevelPreconditioner(one_level, self._coarse)

    def _scaled_assemblies(self, comm: MPI.Comm) -> list[sparse.csr_matrix]:
        """(B D^-1 B^T)^-1 B D^-1 per subdomain, D the copies' stiffness diag A_s (1 for reactions)."""
        mine = []
        for system in self._systems:
            part = system.subdomain
            stiffness = system.diagonal[part.displacement.dofs]
            mine.append([(part.displacement, stiffness), (part.reaction, np.ones(len(part.reaction.dofs)))])
        copies = Exchange(comm, sum(s.subdomain.n_owned_copies for s in self._systems),
                          [copies_of(interface) for pair in mine for interface, _ in pair])
        weights = np.zeros(len(copies.ghosts))
        for interface, values in (item for pair in mine for item in pair):
            weights[np.searchsorted(copies.ghosts, interface.first_copy + interface.position)] = values
        owned = copies.new_vector()
        copies.add_to_owners(weights, owned)
        weights = copies.to_ghosts(owned)
        owned.destroy()
        rows = self._exchange.ghosts
        return [
            sparse.hstack([scaled_incidence(interface, weights, copies.ghosts, rows, len(rows))
                           for interface, _ in pair]).tocsr()
            for pair in mine
        ]
