"""One subdomain's part of the dual problem."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.partition.incidence import signed_incidence
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem


@dataclass(frozen=True)
class LocalDual:
    """A subdomain's operators on the interface, Eq. 30-31 of [BP17] with the two blocks stacked.

    With v = (Lambda, LambdaBar / c), S_tot v = sum_s G_s A_s^-1 G_s^T v - H_s v, where
    G_s = [C_s ; c eta Cbar_s Kbar_s] = B_s T_s,  H_s = c^2 eta Cbar_s Cbar_s^T = B_s D_s B_s^T,
    T_s and D_s act on the subdomain's own interface dofs, B_s is the signed incidence.

    operator: A_s factorised.
    incidence: B_s, (n ghost rows, n interface dofs), displacement dofs first, then reaction dofs.
    trace: T_s, (n interface dofs, n_dofs).
    compliance: diagonal of D_s, (n interface dofs,), zero on displacement dofs.
    jump: G_s, (n ghost rows, n_dofs).
    n_displacement: number of displacement interface dofs.
    motion: the rows of the subdomain's camera's motion, None without.
    """

    operator: LocalOperator
    incidence: sparse.csr_matrix
    trace: sparse.csr_matrix
    compliance: NDArray[np.float64]
    jump: sparse.csr_matrix
    jump_transposed: sparse.csr_matrix
    n_displacement: int
    motion: MotionRows | None = None

    def apply(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        """G_s A_s^-1 G_s^T v - H_s v on ghost rows, with one local solve."""
        y = self.operator.solve(self.jump_transposed @ v)
        out = np.asarray(self.jump @ y - self.incidence @ (self.compliance * (self.incidence.T @ v)))
        if self.motion is not None:
            out[self.motion.rows] -= self.motion.block @ v[self.motion.rows]
        return out

    def schur_product(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """S_s X = T_s A_s^-1 T_s^T X - D_s X, S_s not formed; columns: X, (n interface dofs, k).

        A block of columns at a time, so that no array of (n_dofs, k) is held.
        """
        out = np.empty(columns.shape, order="F")
        step = self.operator.block
        for begin in range(0, columns.shape[1], step):
            block = columns[:, begin: begin + step]
            y = self.operator.solve_many(self.trace.T @ block)
            out[:, begin: begin + step] = self.trace @ y - self.compliance[:, None] * block
        return out


@dataclass(frozen=True)
class MotionRows:
    """Rows of the interface problem for the motion alpha of a near-field set-up, unknowns kappa alpha.

    With R_s the displacements that alpha makes and N_s = M_s R_s, alpha's equation N_s^T u_s + R_s^T M_s R_s alpha
    = R_s^T b_s, summed over subdomains, has the form of the others: G_s gains the rows N_s^T / kappa, H_s the block
    R_s^T M_s R_s / kappa^2. Where the near camera alone sees its subdomains, A_s^-1 N_s = R_s, since K R_s = 0: then
    C_s R_s are alpha's columns R of Eq. 20 of [BP17] (1 from near to far, 0 within one side), and the block's part
    of S_tot vanishes.

    rows: (n_shifts,) ghost rows; columns: N_s / kappa, (n_dofs, n_shifts); block: (n_shifts, n_shifts);
    scale: kappa, (n_shifts,), sum_s diag R_s^T M_s R_s, which makes the rows' residuals pixels.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.float64]
    block: NDArray[np.float64]
    scale: NDArray[np.float64]


def with_motion(local: LocalDual, system: LocalSystem, ghosts: NDArray[np.int64],
                scale: NDArray[np.float64]) -> LocalDual:
    """The same with the rows of its camera's motion; scale: kappa of ``MotionRows``."""
    shifts = system.subdomain.shifts
    if shifts is None:
        return local
    rows = np.searchsorted(ghosts, shifts.rows)
    motion = MotionRows(rows, system.shift_columns / scale, system.shift_block / np.outer(scale, scale), scale)
    n_rows = local.jump.shape[0]
    place = sparse.csr_matrix((np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=(n_rows, len(rows)))
    jump = (local.jump + place @ sparse.csr_matrix(motion.columns.T)).tocsr()
    return replace(local, jump=jump, jump_transposed=jump.T.tocsr(), motion=motion)


def local_dual(system: LocalSystem, operator: LocalOperator, ghosts: NDArray[np.int64],
               scale: float) -> LocalDual:
    """Set up a subdomain's interface operators.

    ghosts: sorted numbers of the rows this rank takes part in; scale: c, which gives both blocks of
    unknowns and of residuals one unit (DESIGN: LambdaBar scaled symmetrically by 1 / sqrt(eta mean diag M)).
    """
    part = system.subdomain
    n_dofs = part.n_dofs
    jumps = part.displacement
    trace = _selection(jumps.dofs, n_dofs)
    incidence = signed_incidence(jumps, ghosts, len(ghosts))
    compliance = np.zeros(len(jumps.dofs))
    if system.controlled_stiffness is not None:
        reactions = part.reaction
        weights = system.row_weights[reactions.dofs]
        rows = sparse.diags(scale * system.eta * weights) @ system.controlled_stiffness[reactions.dofs]
        trace = sparse.vstack([trace, rows]).tocsr()
        incidence = sparse.hstack([incidence, signed_incidence(reactions, ghosts, len(ghosts))]).tocsr()
        compliance = np.concatenate([compliance, scale**2 * system.eta * weights**2])
    jump = (incidence @ trace).tocsr()
    return LocalDual(operator, incidence, trace, compliance, jump, jump.T.tocsr(), len(jumps.dofs))


def _selection(dofs: NDArray[np.int64], n_dofs: int) -> sparse.csr_matrix:
    n = len(dofs)
    return sparse.csr_matrix((np.ones(n), (np.arange(n), dofs)), shape=(n, n_dofs))
