"""What one subdomain brings to the linear step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.partition.subdomain import Subdomain


@dataclass(frozen=True)
class LocalSystem:
    """What a subdomain brings to the linear step.

    subdomain: its mesh and interfaces; hessian: M_s, (n_unknowns, n_unknowns), of the nodal displacements and the
    motion of its camera; controlled_stiffness: Kbar_s with weighted interface rows, (n_dofs, n_unknowns), which a
    motion leaves zero, None without regularization; row_weights: w (n_dofs,); eta: weight of the equilibrium gap.
    """

    subdomain: Subdomain
    hessian: sparse.csr_matrix
    controlled_stiffness: sparse.csr_matrix | None
    row_weights: NDArray[np.float64]
    eta: float

    @property
    def operator(self) -> sparse.csr_matrix:
        """A_s = M_s + eta Kbar_s^T Kbar_s."""
        if self.controlled_stiffness is None:
            return self.hessian
        kbar = self.controlled_stiffness
        return (self.hessian + self.eta * (kbar.T @ kbar)).tocsr()

    @property
    def diagonal(self) -> NDArray[np.float64]:
        """Diagonal of A_s, (n_dofs,), without the product Kbar_s^T Kbar_s."""
        diagonal = self.hessian.diagonal()
        if self.controlled_stiffness is None:
            return np.asarray(diagonal)
        squares = self.controlled_stiffness.power(2).sum(axis=0)
        return np.asarray(diagonal + self.eta * np.asarray(squares).ravel())

    @property
    def displacements(self) -> LocalSystem:
        """The same with the camera's motion held."""
        n = self.subdomain.n_dofs
        if n == self.hessian.shape[0]:
            return self
        kbar = self.controlled_stiffness
        return LocalSystem(self.subdomain, self.hessian[:n, :n].tocsr(), None if kbar is None else kbar[:, :n].tocsr(),
                           self.row_weights, self.eta)

    @property
    def shift_columns(self) -> NDArray[np.float64]:
        """M_s R_s: what the camera's motion does to the displacements' equations, (n_dofs, n_shifts)."""
        n = self.subdomain.n_dofs
        return np.asarray(self.hessian[:n, n:].toarray())

    @property
    def shift_block(self) -> NDArray[np.float64]:
        """R_s^T M_s R_s of the camera's motion, (n_shifts, n_shifts)."""
        n = self.subdomain.n_dofs
        return np.asarray(self.hessian[n:, n:].toarray())

    def right_hand_side(self, b: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        """b_s - eta Kbar_s^T Kbar_s q_s, Eq. 24a of [BP17]."""
        if self.controlled_stiffness is None:
            return b
        kbar = self.controlled_stiffness
        return np.asarray(b - self.eta * (kbar.T @ (kbar @ q)))
