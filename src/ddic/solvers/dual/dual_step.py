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

from ddic.parallel.team import Team
from ddic.partition.incidence import copies_of, rows_of, scaled_incidence
from ddic.solvers.dual.coarse_space import CoarseSpace, coarse_columns
from ddic.solvers.dual.interface_solver import InterfaceSettings, InterfaceSolver
from ddic.solvers.dual.local_dual import local_dual, with_motion
from ddic.solvers.dual.local_inverse import LocalInverseKind, schur_pair
from ddic.solvers.dual.local_modes import low_energy_modes
from ddic.solvers.dual.motion import MotionPreconditioner, motion_scales
from ddic.solvers.dual.preconditioner import DualPreconditioner, LocalInverse, LocalPreconditioner
from ddic.solvers.dual.schur_operator import DualSchurOperator
from ddic.solvers.dual.shell import Preconditioning
from ddic.solvers.dual.two_level import TwoLevelPreconditioner
from ddic.solvers.exchange import Exchange
from ddic.solvers.linear_step import Leave, StepResult
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem

Preconditioner = Literal["none", "paper", "scaled", "two_level"]


@dataclass(frozen=True)
class DualSettings:
    """How the interface problem is solved.

    preconditioner: none, the paper's, the paper's with scaled assembly, or that with a coarse space;
    tolerance: on the interface residual relative to |t_tot|; max_iterations: also GMRES's restart;
    recycle: keep Krylov directions for later steps;
    local_inverse: S_s^-1 as an array, by a sparse factor, or as its size asks.
    """

    preconditioner: Preconditioner = "scaled"
    tolerance: float = 1e-6
    max_iterations: int = 1000
    recycle: bool = True
    local_inverse: LocalInverseKind = "auto"


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
        self._systems = [system.displacements for system in systems]
        parts = [system.subdomain for system in systems]
        needed = [rows_of(interface) for p in parts for interface in (p.displacement, p.reaction)]
        needed += [p.shifts.rows for p in parts if p.shifts is not None]
        self._exchange = Exchange(comm, sum(p.n_owned_rows for p in parts), needed)
        scales = motion_scales(team, systems)
        self._n_shifts = sum(len(values) for values in scales.values())
        self._locals = [with_motion(local_dual(alone, a, self._exchange.ghosts, scale), s, self._exchange.ghosts,
                                    scales.get(s.subdomain.camera, np.ones(0)))
                        for s, alone, a in zip(systems, self._systems, operators, strict=True)]
        self._right = self._exchange.new_vector()
        self._operator = DualSchurOperator(self._exchange, self._locals)
        self._coarse: CoarseSpace | None = None
        self._inverses: list[LocalInverse] = []
        self._preconditioner = None if settings.preconditioner == "none" else self._set_up(comm, settings)
        if self._preconditioner is not None and self._n_shifts:
            self._preconditioner = MotionPreconditioner(self._operator, self._preconditioner, self._n_shifts,
                                                        self._right)
        self._interface = InterfaceSolver(
            self._operator, self._preconditioner, self._coarse,
            InterfaceSettings(settings.tolerance, settings.max_iterations,
                              settings.recycle and self._preconditioner is not None))

    @property
    def ksp(self) -> PETSc.KSP:
        """PETSc's Krylov solver, for monitors."""
        return self._interface.ksp

    @property
    def n_interface(self) -> int:
        """Number of interface unknowns."""
        return self._exchange.n_global

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              leave: Leave | None = None) -> StepResult:
        """Solve for dq_s given q_s and b_s of this rank's subdomains; raises ConvergenceError."""
        u, forces = ([v[:local.operator.n] for v, local in zip(of, self._locals, strict=True)] for of in (q, b))
        right = [system.right_hand_side(b_s, u_s) for system, b_s, u_s in zip(self._systems, forces, u, strict=True)]
        free = [local.operator.solve(r) for local, r in zip(self._locals, right, strict=True)]
        if self.n_interface == 0:
            return StepResult(free, 0, np.zeros(0), 0.0)
        size = self._set_right_hand_side(free, u, b)
        iterations, norms = self._interface.solve(self._right, self._stop(size, leave))
        dq = self._with_motion(self.correction(free, self._interface.multipliers), self._interface.multipliers)
        return StepResult(dq, iterations, norms / (size or 1.0), self._estimated_error())

    def correction(self, free: Sequence[NDArray[np.float64]], multipliers: PETSc.Vec) -> list[NDArray[np.float64]]:
        """Correction dq_s = free_s - A_s^-1 G_s^T v, free_s the part without multipliers v, Eq. 24a of [BP17]."""
        v = self._exchange.to_ghosts(multipliers)
        return [y - local.operator.solve(local.jump_transposed @ v)
                for y, local in zip(free, self._locals, strict=True)]

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        for thing in (self._interface, self._right, self._exchange, self._coarse, *self._inverses):
            if thing is not None:
                thing.destroy()

    def _set_right_hand_side(self, free: Sequence[NDArray[np.float64]], u: Sequence[NDArray[np.float64]],
                             b: Sequence[NDArray[np.float64]]) -> float:
        """t_tot = sum_s G_s (u_s + free_s), Eq. 27 of [BP17]; returns its norm.

        free: A_s^-1 (b_s - eta Kbar_s^T Kbar_s u_s). Rows of a camera's motion: (N_s^T free_s - R_s^T b_s) / kappa.
        """
        total = np.zeros(len(self._exchange.ghosts))
        for local, free_s, u_s, b_s in zip(self._locals, free, u, b, strict=True):
            total += local.jump @ (u_s + free_s)
            if local.motion is not None:
                total[local.motion.rows] -= local.motion.columns.T @ u_s + b_s[len(u_s):] / local.motion.scale
        self._exchange.add_to_owners(total, self._right)
        return float(self._right.norm())

    def _with_motion(self, du: Sequence[NDArray[np.float64]], multipliers: PETSc.Vec) -> list[NDArray[np.float64]]:
        """Corrections of all unknowns, the cameras' motions after the displacements."""
        v = self._exchange.to_ghosts(multipliers)
        return [du_s if local.motion is None else np.concatenate([du_s, v[local.motion.rows] / local.motion.scale])
                for du_s, local in zip(du, self._locals, strict=True)]

    def _stop(self, size: float, leave: Leave | None) -> float:
        """Norm of the residual at which GMRES may stop: of the tolerance, or of the displacement error allowed."""
        norm = self._interface.start(self._right)
        finest = self._interface.tolerance * size
        if leave is None or norm <= finest:
            return finest
        error = self._estimated_error()
        if not error > 0:
            return finest
        return max(finest, norm * max(leave.error / error, leave.share))

    def _estimated_error(self) -> float:
        """RMS over nodes of A_s^-1 G_s^T P (t_tot - S_tot v), pixels: dq's error, as far as P is like S_tot^-1."""
        if self._preconditioner is None:
            return float("nan")
        multipliers = self._interface.preconditioned()
        errors = self.correction([np.zeros(s.hessian.shape[0]) for s in self._systems], multipliers)
        multipliers.destroy()
        shares = [s.subdomain.dof_multiplicity for s in self._systems]
        sums = self._team.ordered_sum([np.array([(e**2 / m).sum(), (1.0 / m).sum()])
                                       for e, m in zip(errors, shares, strict=True)])
        dim = self._systems[0].subdomain.mesh.dim if self._systems else 1
        return float(np.sqrt(sums[0] * dim / sums[1]))

    def _set_up(self, comm: MPI.Comm, settings: DualSettings) -> Preconditioning:
        plain = settings.preconditioner == "paper"
        assemblies = [local.incidence for local in self._locals] if plain else self._scaled_assemblies(comm)
        # Before the inverses: what finds the modes is large, and gone when these are made.
        columns = self._team.together(lambda: [
            coarse_columns(low_energy_modes(system, local.operator), local)
            for system, local in zip(self._systems, self._locals, strict=True)
        ]) if settings.preconditioner == "two_level" else []
        pairs = self._team.together(lambda: [
            schur_pair(system, local, settings.local_inverse)
            for system, local in zip(self._systems, self._locals, strict=True)
        ])
        self._inverses = [pair.inverse for pair in pairs]
        one_level = DualPreconditioner(self._exchange, [
            LocalPreconditioner(*term) for term in zip(assemblies, self._inverses, strict=True)])
        if settings.preconditioner != "two_level":
            return one_level
        products = [pair.product for pair in pairs]
        self._coarse = CoarseSpace(self._team, self._exchange, self._locals, assemblies, products, columns)
        return TwoLevelPreconditioner(self._operator, one_level, self._coarse)

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
