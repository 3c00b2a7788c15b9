"""Directions kept from earlier interface problems with the same operator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from ddic.parallel.team import Team

LARGEST = 128
"""Directions kept; the oldest go first. They cost two interface vectors each, far less than the local factors. More
save iterations and cost products with them in each."""

_DEPENDENT = 1e-10
"""Share of the largest eigenvalue of the new images' Gram matrix below which they count as dependent."""


class RecycledSpace:
    """Pairs (U, C) with S_tot U = C and C^T C = I, spread over ranks by interface rows.

    Remark 9 of [BP17]: the operator is constant over Gauss-Newton, so what one Krylov solver learnt serves the next.
    With r = t - S_tot v, the step v + U C^T r leaves the least residual over U; the Krylov solver then works on
    (I - C C^T) S_tot (as GCRO does), so that no direction is paid for twice.

    Parameters
    ----------
    team : Team
        All ranks.
    n_owned : int
        How many interface rows this rank owns.
    """

    def __init__(self, team: Team, n_owned: int) -> None:
        self._team, self._n_owned = team, n_owned
        self.forget()

    def forget(self) -> None:
        """Keep nothing."""
        self._directions: NDArray[np.float64] = np.zeros((self._n_owned, 0))
        self._images: NDArray[np.float64] = np.zeros((self._n_owned, 0))

    @property
    def size(self) -> int:
        """Number of directions kept."""
        return self._images.shape[1]

    def reduce(self, residual: NDArray[np.float64], solution: NDArray[np.float64]) -> None:
        """Add U C^T r to a solution and take C C^T r from its residual, in place; collective.

        Parameters
        ----------
        residual : (n_owned,) array
            r, owned rows; overwritten.
        solution : (n_owned,) array
            v, owned rows; overwritten.
        """
        coefficients = self._find_coefficients(residual)
        solution += self._directions @ coefficients
        residual -= self._images @ coefficients

    def project(self, vector: NDArray[np.float64]) -> None:
        """Take C C^T x from x, in place; collective.

        Parameters
        ----------
        vector : (n_owned,) array
            x, owned rows; overwritten.
        """
        vector -= self._images @ self._find_coefficients(vector)

    def learn(self, directions: NDArray[np.float64], images: NDArray[np.float64]) -> None:
        """Keep what is new in some pairs; collective.

        Parameters
        ----------
        directions : (n_owned, k) array
            y, owned rows.
        images : (n_owned, k) array
            S_tot y, owned rows.
        """
        # Twice, for after once the new images are orthogonal to the old ones to a few digits only.
        for _ in range(2):
            coefficients = self._team.sum(self._images.T @ images)
            directions = directions - self._directions @ coefficients
            images = images - self._images @ coefficients
            directions, images = self._orthonormalize(directions, images)
        self._directions = np.hstack([self._directions, directions])[:, -LARGEST:]
        self._images = np.hstack([self._images, images])[:, -LARGEST:]

    def _orthonormalize(self, directions: NDArray[np.float64],
                        images: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Combine pairs so that their images are orthonormal; dependent ones go."""
        gram = self._team.sum(images.T @ images)
        values, vectors = linalg.eigh(gram)
        largest = max(float(values.max(initial=0.0)), 1e-300)
        is_independent = values > _DEPENDENT * largest
        change = vectors[:, is_independent] / np.sqrt(values[is_independent])
        return directions @ change, images @ change

    def _find_coefficients(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """C^T x."""
        return self._team.sum(self._images.T @ vector)
