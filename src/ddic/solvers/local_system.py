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

    subdomain: its mesh and interfaces; hessian: M_s; controlled_stiffness: Kbar_s with weighted interface
    rows, None without regularization; row_weights: w (n_dofs,); eta: weight of the equilibrium gap.
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

    def right_hand_side(self, b: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        """b_s - eta Kbar_s^T Kbar_s q_s, Eq. 24a of [BP17]."""
        if self.controlled_stiffness is None:
            return b
        kbar = self.controlled_stiffness
        return np.asarray(b - self.eta * (kbar.T @ (kbar @ q)))
