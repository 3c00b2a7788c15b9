"""One subdomain's part of the dual problem."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.scale_rows import scale_rows
from ddic.partition.subdomain import signed_incidence
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem


@dataclass(frozen=True)
class LocalDual:
    """A subdomain's operators on the interface, Eq. 30-31 of [BP17] with the two blocks stacked.

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
    compliance: NDArray[np.float64]
    jump: sparse.csc_matrix
    n_jumps: int
    motion: MotionRows | None = None

    def multiply_schur(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Multiply by S_s = T_s A_s^-1 T_s^T - D_s, which is not formed.

        Parameters
        ----------
        columns : (n interface unknowns, k) array
            X.

        Returns
        -------
        (n interface unknowns, k) array
            S_s X; a block of columns at a time, so that no array of (n_field, k) is held.
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

    rows: NDArray[np.int64]
    columns: NDArray[np.float64]
    block: NDArray[np.float64]
    scale: NDArray[np.float64]


def build_local_dual(system: LocalSystem, operator: LocalOperator, ghosts: NDArray[np.int64],
                     scale: float) -> LocalDual:
    """Build a subdomain's interface operators, of the field alone.

    Parameters
    ----------
    system : LocalSystem
        The subdomain, without the motion of its camera.
    operator : LocalOperator
        Its A_s factorised.
    ghosts : (n ghost rows,) array of int64
        Sorted numbers of the rows that this rank takes part in.
    scale : float
        c = 1 / sqrt(eta mean diag M), which gives both blocks of unknowns and of residuals one unit and keeps S_tot
        symmetric.

    Returns
    -------
    LocalDual
        Without rows of a motion.
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


def add_motion_rows(local: LocalDual, system: LocalSystem, ghosts: NDArray[np.int64],
                    scales: dict[int, NDArray[np.float64]]) -> LocalDual:
    """Add the rows of the motion of the subdomain's camera, where that moves: Eq. 21 of [BP17].

    Parameters
    ----------
    local : LocalDual
        Of the field alone.
    system : LocalSystem
        The subdomain with the motion of its camera.
    ghosts : (n ghost rows,) array of int64
        Sorted numbers of the rows that this rank takes part in.
    scales : dict of (n_motion,) array
        kappa of ``MotionRows`` by camera.

    Returns
    -------
    LocalDual
        With them.
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


def _select(places: NDArray[np.int64], size: int) -> sparse.csr_matrix:
    """The matrix that takes the entries at some places out of a vector, (n places, size)."""
    n = len(places)
    return sparse.csr_matrix((np.ones(n), places, np.arange(n + 1)), shape=(n, size))
