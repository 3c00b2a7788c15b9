"""The monomials (1, xi, eta, xi eta) on which all shape functions are written: what the pixel kernels sum over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

N_MONOMIALS = 4
"""Number of monomials, hence the most nodes that a cell may have."""


def evaluate_monomials(local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Evaluate the monomials (1, xi, eta, xi eta).

    Parameters
    ----------
    local : (n, 2) array
        Points of the reference cell.

    Returns
    -------
    (n, 4) array
        The monomials at each point.
    """
    xi, eta = local[:, 0], local[:, 1]
    return np.stack([np.ones_like(xi), xi, eta, xi * eta], axis=1)


def differentiate_monomials(local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Differentiate the monomials by (xi, eta).

    Parameters
    ----------
    local : (n, 2) array
        Points of the reference cell.

    Returns
    -------
    (n, 4, 2) array
        The derivatives of each monomial at each point.
    """
    xi, eta = local[:, 0], local[:, 1]
    zero, one = np.zeros_like(xi), np.ones_like(xi)
    by_xi = np.stack([zero, one, zero, eta], axis=1)
    by_eta = np.stack([zero, zero, one, xi], axis=1)
    return np.stack([by_xi, by_eta], axis=2)
