"""Cells whose forces are linear in the unknowns: their functional is expanded to second order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.correlation import Residual
from ddic.functionals.grey_statistics import GreySums

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearizedCells:
    """Cells of owned subdomains, linearized about some unknowns.

    Attributes
    ----------
    cells : list of tuple of (n_cells,) bool array
        Which, by subdomain and view.
    q : list of (n_unknowns,) array
        About which unknowns.
    forces : list of (n_unknowns,) array
        b of these cells there, grey levels squared per pixel.
    operators : list of (n_unknowns, n_unknowns) csr_matrix
        M of these cells there, grey levels squared per pixel squared.
    """

    cells: list[tuple[NDArray[np.bool_], ...]]
    q: list[Array]
    forces: list[Array]
    operators: list[sparse.csr_matrix]

    def compute_forces(self, q: Sequence[Array]) -> list[Array]:
        """Compute b = b_0 + M (q_0 - q).

        Parameters
        ----------
        q : sequence of (n_unknowns,) array
            Unknowns of each subdomain.

        Returns
        -------
        list of (n_unknowns,) array
            Grey levels squared per pixel.
        """
        return [b + hessian @ (about - q_s)
                for b, hessian, about, q_s in zip(self.forces, self.operators, self.q, q, strict=True)]

    def keep_others(self, residuals: Sequence[tuple[Residual, ...]]) -> list[tuple[Residual, ...]]:
        """Keep the residual of the other cells.

        Parameters
        ----------
        residuals : sequence of tuple of Residual
            By subdomain and view.

        Returns
        -------
        list of tuple of Residual
            As if these cells had no pixels.
        """
        return keep_residuals(residuals, [tuple(~of_view for of_view in of_subdomain) for of_subdomain in self.cells])


def keep_residuals(residuals: Sequence[tuple[Residual, ...]],
                   cells: Sequence[tuple[NDArray[np.bool_], ...]]) -> list[tuple[Residual, ...]]:
    """Keep the residual of some cells.

    Parameters
    ----------
    residuals : sequence of tuple of Residual
        By subdomain and view.
    cells : sequence of tuple of (n_cells,) bool array
        Which, likewise.

    Returns
    -------
    list of tuple of Residual
        As if the others had no pixels.
    """
    return [tuple(_keep(residual, kept) for residual, kept in zip(of_subdomain, of_cells, strict=True))
            for of_subdomain, of_cells in zip(residuals, cells, strict=True)]


def _keep(residual: Residual, cells: NDArray[np.bool_]) -> Residual:
    moments = np.where(cells[:, None, None, None], residual.moments, 0.0)
    sums = np.where(cells[:, None], residual.cell_sums.values, 0.0)
    return replace(residual, moments=moments, cell_sums=GreySums(sums))
