"""One subdomain's part of the dual problem, and that of all subdomains of a rank.

A subdomain's matrices are small: to call a product takes longer than to compute it. So there is one product with a
sparse matrix for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.functionals.scale_rows import scale_rows
from ddic.partition.subdomain import signed_incidence
from ddic.solvers.local_system import LocalOperator, LocalSystem


@dataclass(frozen=True)
class LocalDual:
    """A subdomain's operators on the interface: the product of Eq. 30-31 of [BP17] with the two blocks stacked.

    With v = (Lambda, LambdaBar / c), S_tot v = sum_s G_s A_s^-1 G_s^T v - H_s v, where
    G_s = [C_s ; c eta Cbar_s Kbar_s] = B_s T_s,  H_s = c^2 eta Cbar_s Cbar_s^T = B_s D_s B_s^T,
    T_s and D_s act on the subdomain's own interface unknowns (those with jumps first, then those with reactions), B_s
    is the signed incidence.

    Attributes
    ----------
    operator : LocalOperator
        A_s factorised, the camera's motion held.
    incidence : (n ghost rows, n interface unknowns) csc_matrix
        B_s.
    trace : (n interface unknowns, n_field) csr_matrix
        T_s.
    compliance : (n interface unknowns,) array
        Diagonal of D_s, zero for jumps.
    jump : (n ghost rows, n_field) csc_matrix
        G_s.
    n_jumps : int
        Number of interface unknowns with jumps.
    motion : MotionRows, optional
        The rows of the motion of the subdomain's camera.
    """

    operator: LocalOperator
    incidence: sparse.csc_matrix
    trace: sparse.csr_matrix
    compliance: Array
    jump: sparse.csc_matrix
    n_jumps: int
    motion: MotionRows | None = None

    def multiply_schur(self, columns: Array) -> Array:
        """Multiply by S_s = T_s A_s^-1 T_s^T - D_s, not formed, in blocks: no array of (n_field, k) is held.

        S_tot is the sum of B_s S_s B_s^T, Eq. 34-35 of [BP17].
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
    C_s R_s are alpha's columns in Eq. 20 of [BP17], whose alpha has the other sign (1 from near to far, 0 within one
    side), and the block's part of S_tot vanishes.

    Attributes
    ----------
    rows : (n_motion,) array of int64
        Ghost rows.
    columns : (n_field, n_motion) array
        N_s / kappa.
    block : (n_motion, n_motion) array
        R_s^T M_s R_s / kappa^2.
    scale : (n_motion,) array
        kappa = sum_s diag R_s^T M_s R_s, which makes the rows' residuals pixels.
    """

    rows: IntArray
    columns: Array
    block: Array
    scale: Array


def build_local_dual(system: LocalSystem, operator: LocalOperator, ghosts: IntArray, scale: float) -> LocalDual:
    """Build a subdomain's interface operators, of the field alone: ``system`` is without the motion of its camera.

    Jumps and reactions are split into the assembly B_s and the trace T_s on its own interface, Eq. 33 of [BP17].
    ``ghosts`` are the sorted numbers of the rows that this rank takes part in. ``scale`` is
    c = 1 / sqrt(eta mean diag M), which gives both blocks of unknowns and of residuals one unit and keeps S_tot
    symmetric.
    """
    subdomain = system.subdomain
    jumps = subdomain.jumps
    trace = _select(jumps.unknowns, subdomain.n_field)
    incidence = signed_incidence(jumps, ghosts)
    compliance = np.zeros(len(jumps.unknowns))
    if system.controlled_stiffness is not None:
        reactions = subdomain.reactions
        weights = system.row_weights[reactions.unknowns]
        reaction_rows = system.controlled_stiffness[reactions.unknowns]
        weighted_rows = scale_rows(reaction_rows, scale * system.eta * weights)
        trace = sparse.vstack([trace, weighted_rows]).tocsr()
        incidence = sparse.hstack([incidence, signed_incidence(reactions, ghosts)], format="csc")
        compliance = np.concatenate([compliance, scale**2 * system.eta * weights**2])
    return LocalDual(operator, incidence, trace, compliance, incidence @ trace, len(jumps.unknowns))


def add_motion_rows(local: LocalDual, system: LocalSystem, ghosts: IntArray, scales: dict[int, Array]) -> LocalDual:
    """Add the rows of the motion of the subdomain's camera, where that moves: Eq. 21 of [BP17].

    ``system`` is with the motion of its camera, ``ghosts`` are as for ``build_local_dual``, ``scales`` is kappa of
    ``MotionRows``, (n_motion,), by camera.
    """
    unknowns = system.subdomain.motion
    if unknowns is None:
        return local
    scale = scales[system.subdomain.camera]
    rows = np.searchsorted(ghosts, unknowns.rows)
    motion = MotionRows(rows, system.motion_columns / scale, system.motion_block / np.outer(scale, scale), scale)
    place = _select(rows, len(ghosts)).T
    jump = (local.jump + place @ sparse.csr_matrix(motion.columns.T)).tocsc()
    return replace(local, jump=jump, motion=motion)


def _select(places: IntArray, size: int) -> sparse.csr_matrix:
    """The matrix that takes the entries at some places out of a vector, (n places, size)."""
    n = len(places)
    return sparse.csr_matrix((np.ones(n), places, np.arange(n + 1)), shape=(n, size))


class RankDual:
    """A rank's part of the product S_tot v, Eq. 30-31 of [BP17]: operators of ``LocalDual`` side by side.

    Parameters
    ----------
    local_duals : sequence of LocalDual
        The rank's subdomains, at least one.
    """

    def __init__(self, local_duals: Sequence[LocalDual]) -> None:
        self._local_duals = local_duals
        self._fields = list_places([local.operator.n for local in local_duals])
        self._jump = sparse.hstack([local.jump for local in local_duals], format="csc").tocsr()
        self._jump_transposed = self._jump.T.tocsr()
        incidence = sparse.hstack([local.incidence for local in local_duals], format="csc").tocsr()
        compliance = sparse.diags(np.concatenate([local.compliance for local in local_duals]))
        self._compliance = (incidence @ compliance @ incidence.T).tocsr()

    def apply(self, v: Array) -> Array:
        """Sum G_s A_s^-1 G_s^T v - H_s v, the rank's part of S_tot v, with one local solve of each subdomain."""
        y = np.concatenate(self.solve_forces(v))
        out = np.asarray(self._jump @ y - self._compliance @ v)
        for local in self._local_duals:
            if local.motion is not None:
                out[local.motion.rows] -= local.motion.block @ v[local.motion.rows]
        return out

    def solve_forces(self, v: Array) -> list[Array]:
        """Find what multipliers v, (n ghost rows,), do to the fields: A_s^-1 G_s^T v of each subdomain, (n_field,)."""
        forces = self._jump_transposed @ v
        return [local.operator.solve(forces[place])
                for local, place in zip(self._local_duals, self._fields, strict=True)]

    def sum_jumps(self, fields: Sequence[Array]) -> Array:
        """Sum what fields y_s, (n_field,), contribute to the rows: sum of G_s y_s, (n ghost rows,)."""
        return np.asarray(self._jump @ np.concatenate(fields))


def list_places(sizes: Sequence[int]) -> list[slice]:
    """List where arrays of some sizes lie in all of them, one after the other."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(begin, end) for begin, end in pairwise(ends)]
