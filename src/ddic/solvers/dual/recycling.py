"""Directions kept from earlier interface problems with the same operator."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import linalg

LARGEST = 128
"""Directions kept; the oldest go first. They cost two interface vectors each, far less than the local factors."""

_DEPENDENT = 1e-10


class RecycledSpace:
    """Pairs (U, C) with S_tot U = C and C^T C = I, spread over ranks by interface rows.

    [BP17, Remark 9]: the operator is constant over Gauss-Newton, so what one Krylov solver learnt serves the next.
    With r = t - S_tot v, the step v + U C^T r leaves the least residual over U; the Krylov solver then works on
    (I - C C^T) S_tot (as GCRO does), so that no direction is paid for twice.
    """

    def __init__(self, comm: MPI.Comm, n_owned: int) -> None:
        self._comm = comm
        self._directions: NDArray[np.float64] = np.zeros((n_owned, 0))
        self._images: NDArray[np.float64] = np.zeros((n_owned, 0))

    @property
    def size(self) -> int:
        """Number of directions kept."""
        return self._images.shape[1]

    def reduce(self, residual: NDArray[np.float64], solution: NDArray[np.float64]) -> None:
        """Add U C^T r to ``solution`` and take C C^T r from ``residual``, in place; owned rows (n_owned,)."""
        coefficients = self._coefficients(residual)
        solution += self._directions @ coefficients
        residual -= self._images @ coefficients

    def project(self, vector: NDArray[np.float64]) -> None:
        """Take C C^T x from x in place; owned rows (n_owned,)."""
        vector -= self._images @ self._coefficients(vector)

    def learn(self, directions: NDArray[np.float64], images: NDArray[np.float64]) -> None:
        """Keep what is new in pairs y, S_tot y, each (n_owned, k)."""
        for _ in range(2):
            coefficients = self._sum(self._images.T @ images)
            directions = directions - self._directions @ coefficients
            images = images - self._images @ coefficients
            directions, images = self._orthonormal(directions, images)
        self._directions = np.hstack([self._directions, directions])[:, -LARGEST:]
        self._images = np.hstack([self._images, images])[:, -LARGEST:]

    def _orthonormal(self, directions: NDArray[np.float64],
                     images: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        gram = self._sum(images.T @ images)
        values, vectors = linalg.eigh(gram)
        kept = values > _DEPENDENT * max(float(values.max(initial=0.0)), 1e-300)
        change = vectors[:, kept] / np.sqrt(values[kept])
        return directions @ change, images @ change

    def _coefficients(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._sum(self._images.T @ vector)

    def _sum(self, local: NDArray[np.float64]) -> NDArray[np.float64]:
        total = np.empty_like(local)
        self._comm.Allreduce(np.ascontiguousarray(local), total, op=MPI.SUM)
        return total
