"""The interface problem S_tot v = t_tot of all subdomains, Eq. 25-31 of [BP17].

Its dual Schur complement S_tot is a PETSc shell operator; what PETSc asks of such operators stands here too. The motion
of near-field set-ups in the interface problem is eliminated exactly by the preconditioner.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from ddic.arrays import Array
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import rows_of
from ddic.solvers.dual.local_dual import LocalDual, RankDual, add_motion_rows, build_local_dual
from ddic.solvers.exchange import Exchange
from ddic.solvers.local_system import LocalOperator, LocalSystem
from ddic.solvers.petsc import PetscStack


class Preconditioning(Protocol):
    """Context of a shell preconditioner."""

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply y = P x to residuals x: PETSc's callback."""
        ...


class Multiplying(Protocol):
    """Context of a shell matrix."""

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply y = S x, x multipliers: PETSc's callback."""
        ...


class DualSchurOperator:
    """Context of the shell matrix: S_tot v = sum_s G_s A_s^-1 G_s^T v - H_s v, Eq. 26 of [BP17].

    The matrix is symmetric and quasi-definite; one local solve per subdomain and product. Its blocks, Eq. 27a-c,
    are never formed.

    Parameters
    ----------
    exchange : Exchange
        Of interface rows.
    local_duals : sequence of LocalDual
        This rank's subdomains.

    Attributes
    ----------
    of_rank : RankDual
        All of them side by side.
    """

    def __init__(self, exchange: Exchange, local_duals: Sequence[LocalDual]) -> None:
        self._exchange = exchange
        self.of_rank = RankDual(local_duals)

    @property
    def team(self) -> Team:
        """The ranks that the interface is spread over."""
        return self._exchange.team

    def mult(self, _: PETSc.Mat | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply y = S_tot x, x multipliers: PETSc's callback."""
        v = self._exchange.fetch_ghosts(x)
        self._exchange.add_to_owners(self.of_rank.apply(v), y)

    multTranspose = mult

    def create_vector(self) -> PETSc.Vec:
        """Create a zero vector of interface rows over all ranks, the caller's to destroy."""
        return self._exchange.create_vector()

    def create_matrix(self, context: Multiplying | None = None) -> PETSc.Mat:
        """Create a shell matrix of S_tot's size over all ranks, of S_tot itself by default; the caller's to destroy."""
        size = (self._exchange.n_owned, self._exchange.n_global)
        matrix = PETSc.Mat().createPython((size, size), context or self, comm=self.team.comm)
        matrix.setUp()
        return matrix


class MotionPreconditioner:
    """Context of PETSc's shell preconditioner for [[S, B], [B^T, -D]] (Lambda, alpha), from P for S alone.

    alpha = (B^T P B + D)^-1 (B^T P r - r_alpha), Lambda = P (r - B alpha): exact where P = S^-1. The rows of alpha are
    the last ones, all on one rank; P takes and gives zeros there.

    Parameters
    ----------
    operator : DualSchurOperator
        Is applied to alpha's columns here, by all ranks together.
    inner : Preconditioning
        P, likewise.
    n_motion : int
        Number of unknowns alpha of all set-ups.
    """

    def __init__(self, operator: DualSchurOperator, inner: Preconditioning, n_motion: int) -> None:
        self._team = operator.team
        self._inner = inner
        self._n = n_motion
        columns, products, block = [], [], []
        with PetscStack() as stack:
            unit, column, solved, self._right = (stack.keep(operator.create_vector()) for _ in range(4))
            self._here = _find_last_rows(unit, n_motion)
            for k in range(n_motion):
                unit.set(0.0)
                self._put(unit, np.eye(n_motion)[k])
                operator.mult(None, unit, column)
                block.append(-self._take(column))
                self._put(column, np.zeros(n_motion))
                inner.apply(None, column, solved)
                columns.append(np.array(column.getArray()))
                products.append(np.array(solved.getArray()))
            self._columns = np.stack(columns, axis=1)
            self._products = np.stack(products, axis=1)
            d = np.stack(block, axis=1)
            self._small = self._team.sum(self._columns.T @ self._products) + d
            self._objects = stack.pop_all()

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the preconditioner to x = (r, r_alpha), which gives y = (Lambda, alpha): PETSc's callback."""
        given = self._take(x)
        x.copy(self._right)
        self._put(self._right, np.zeros(self._n))
        self._inner.apply(pc, self._right, y)
        projected = self._team.sum(self._columns.T @ y.getArray(readonly=1))
        alpha = np.linalg.solve(self._small, projected - given)
        y.setArray(y.getArray(readonly=1) - self._products @ alpha)
        self._put(y, alpha)

    def destroy(self, _: PETSc.PC | None = None) -> None:
        """Free PETSc's objects; PETSc calls it too, when the preconditioner goes whose context this is."""
        self._objects.close()

    def _take(self, vector: PETSc.Vec) -> Array:
        """Alpha's rows of a vector, on all ranks; collective."""
        mine = np.zeros(self._n)
        if self._here is not None:
            mine[:] = vector.getArray(readonly=1)[self._here]
        return self._team.sum(mine)

    def _put(self, vector: PETSc.Vec, values: Array) -> None:
        """Overwrite alpha's rows of a vector."""
        if self._here is not None:
            vector.getArray()[self._here] = values


def _find_last_rows(vector: PETSc.Vec, n: int) -> slice | None:
    """Where this rank holds the last n rows of a vector; None where another rank does."""
    first, end = vector.getOwnershipRange()
    begin = vector.getSize() - n
    return slice(begin - first, end - first) if end > begin else None


def sum_motion_scales(team: Team, systems: Sequence[LocalSystem]) -> dict[int, Array]:
    """Sum kappa = sum_s diag R_s^T M_s R_s of every camera whose set-up moves; collective.

    The result, (n_motion,) by the camera's number, has grey levels squared per pixel squared.
    """
    mine = [(system.subdomain.camera, system.motion_block.diagonal())
            for system in systems if system.subdomain.motion is not None]
    scales: dict[int, Array] = {}
    for camera, diagonal in team.gather_lists(mine):
        scales[camera] = scales.get(camera, 0.0) + diagonal
    return scales


class DualProblem:
    """The interface problem, spread over ranks.

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

    Attributes
    ----------
    systems : list of LocalSystem
        The same, motions of cameras held.
    exchange : Exchange
        Of interface rows, its owner.
    local_duals : list of LocalDual
        Of each of these subdomains.
    operator : DualSchurOperator
        S_tot.
    n_motion : int
        Number of unknowns of all cameras' motions.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], operators: Sequence[LocalOperator],
                 scale: float) -> None:
        self.team = team
        self.subdomains = [system.subdomain for system in systems]
        self.systems = [system.without_motion for system in systems]
        scales = sum_motion_scales(team, systems)
        self.n_motion = sum(len(values) for values in scales.values())
        rows = []
        for subdomain in self.subdomains:
            rows += [rows_of(subdomain.jumps), rows_of(subdomain.reactions)]
            if subdomain.motion is not None:
                rows.append(subdomain.motion.rows)
        self.exchange = Exchange(team, sum(s.n_owned_rows for s in self.subdomains), rows)
        self.local_duals = []
        for system, held_system, operator in zip(systems, self.systems, operators, strict=True):
            field = build_local_dual(held_system, operator, self.exchange.ghosts, scale)
            self.local_duals.append(add_motion_rows(field, system, self.exchange.ghosts, scales))
        self.operator = DualSchurOperator(self.exchange, self.local_duals)

    def set_right_hand_side(self, right: PETSc.Vec, free: Field, q: Field, b: Field) -> None:
        """Set a vector to t_tot = sum_s G_s (u_s + free_s), Eq. 27d-e of [BP17]; collective.

        Rows of a camera's motion are (N_s^T free_s - R_s^T b_s) / kappa. Of each owned subdomain, ``free`` is
        A_s^-1 (b_s - eta Kbar_s^T Kbar_s u_s), (n_field,); ``q`` is u_s, then the camera's motion.
        """
        fields = [q_s[:len(free_s)] + free_s for q_s, free_s in zip(q, free, strict=True)]
        total = self.operator.of_rank.sum_jumps(fields)
        for local, q_s, b_s in zip(self.local_duals, q, b, strict=True):
            if local.motion is not None:
                motion, n_field = local.motion, local.operator.n
                total[motion.rows] -= motion.columns.T @ q_s[:n_field] + b_s[n_field:] / motion.scale
        self.exchange.add_to_owners(total, right)

    def correct(self, free: Field, multipliers: PETSc.Vec) -> Field:
        """Correct by the multipliers v: du_s = free_s - A_s^-1 G_s^T v, pixels, Eq. 24a of [BP17]; collective."""
        v = self.exchange.fetch_ghosts(multipliers)
        return free - self.operator.of_rank.solve_forces(v)

    def append_motion(self, du: Field, multipliers: PETSc.Vec) -> Field:
        """Append the corrections of cameras' motions, pixels, to those of the fields; collective.

        They are taken from the multipliers v, among which are kappa alpha.
        """
        v = self.exchange.fetch_ghosts(multipliers)
        return du.with_parts(
            du_s if local.motion is None else np.concatenate([du_s, v[local.motion.rows] / local.motion.scale])
            for du_s, local in zip(du, self.local_duals, strict=True))

    def destroy(self) -> None:
        """Free PETSc's objects; local factors are their maker's."""
        self.exchange.destroy()
