"""What one subdomain brings to the linear step.

Also the linear step on the whole mesh by one sparse Cholesky: the oracle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from ddic.arrays import Array
from ddic.functionals.scale_rows import scale_rows
from ddic.parallel.field import Field
from ddic.partition.subdomain import Subdomain
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_operator import LocalOperator


@dataclass(frozen=True)
class LocalSystem:
    """What a subdomain brings to the linear step.

    Attributes
    ----------
    subdomain : Subdomain
        Its unknowns and interfaces.
    hessian : (n_unknowns, n_unknowns) csr_matrix
        M_s, of the unknowns of the field and then of its camera's motion, grey levels squared per pixel squared.
    stiffness : (n_field, n_unknowns) csr_matrix or None
        diag(w) T^T K T: interface rows are weighted, columns of a motion are zero. None without regularization.
    row_weights : (n_field,) array
        Weights w of interface rows (``interface_weights``), no unit.
    eta : float
        Weight of the equilibrium gap.
    projection : (n_field,) array, optional
        Diagonal of P: how much the equilibrium of each unknown counts, 0 to 1; by default all of it.
    """

    subdomain: Subdomain
    hessian: sparse.csr_matrix
    stiffness: sparse.csr_matrix | None
    row_weights: Array
    eta: float
    projection: Array | None = None

    @cached_property
    def controlled_stiffness(self) -> sparse.csr_matrix | None:
        """Kbar_s = P diag(w) T^T K T, Eq. 9 of [BP17], (n_field, n_unknowns); None without regularization."""
        if self.stiffness is None or self.projection is None:
            return self.stiffness
        return scale_rows(self.stiffness, self.projection)

    @cached_property
    def controlled_stiffness_transposed(self) -> sparse.csc_matrix | None:
        """Kbar_s^T; making the matrix anew takes longer than its product with a vector."""
        return None if self.controlled_stiffness is None else self.controlled_stiffness.T

    @property
    def operator(self) -> sparse.csr_matrix:
        """A_s = M_s + eta Kbar_s^T Kbar_s, Eq. 32 of [BP17], (n_unknowns, n_unknowns)."""
        if self.controlled_stiffness is None:
            return self.hessian
        kbar = self.controlled_stiffness
        return (self.hessian + self.eta * (kbar.T @ kbar)).tocsr()

    @property
    def diagonal(self) -> Array:
        """Diagonal of A_s, (n_unknowns,), without the product Kbar_s^T Kbar_s."""
        of_hessian = np.asarray(self.hessian.diagonal())
        if self.controlled_stiffness is None:
            return of_hessian
        sums_of_squares = np.asarray(self.controlled_stiffness.power(2).sum(axis=0)).ravel()
        return np.asarray(of_hessian + self.eta * sums_of_squares)

    @property
    def without_motion(self) -> LocalSystem:
        """The same with the camera's motion held: the unknowns of the field alone."""
        if self.subdomain.motion is None:
            return self
        n = self.subdomain.n_field
        hessian = self.hessian[:n, :n].tocsr()
        stiffness = None if self.stiffness is None else self.stiffness[:, :n].tocsr()
        return replace(self, hessian=hessian, stiffness=stiffness)

    @property
    def motion_columns(self) -> Array:
        """N_s = M_s R_s: what the camera's motion does to the field's equations, (n_field, n_motion)."""
        n = self.subdomain.n_field
        return np.asarray(self.hessian[:n, n:].toarray())

    @property
    def motion_block(self) -> Array:
        """R_s^T M_s R_s of the camera's motion, (n_motion, n_motion)."""
        n = self.subdomain.n_field
        return np.asarray(self.hessian[n:, n:].toarray())

    def right_hand_side(self, b: Array, q: Array) -> Array:
        """Return b_s - eta Kbar_s^T Kbar_s q_s, grey levels squared per pixel, Eq. 24a of [BP17]."""
        if self.controlled_stiffness is None:
            return b
        return np.asarray(b - self.eta * (self.controlled_stiffness_transposed @ (self.controlled_stiffness @ q)))


class MonolithicStep:
    """Solves Eq. 11 of [BP17] directly; also one subdomain's independent step, where it is alone.

    Parameters
    ----------
    system : LocalSystem
        Of the only subdomain.
    operator : LocalOperator
        The factor of its A_s, which stays its maker's to destroy.
    """

    def __init__(self, system: LocalSystem, operator: LocalOperator) -> None:
        self._system = system
        self.operator = operator

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for the only subdomain's dq; the step is direct: without an error, whatever is ``allowed``."""
        dq = self.operator.solve(self._system.right_hand_side(b[0], q[0]))
        return StepResult(q.with_parts([dq]))

    def forget(self) -> None:
        """Do nothing: no step teaches another."""

    def destroy(self) -> None:
        """Nothing to free: the factor belongs to whoever made it."""
