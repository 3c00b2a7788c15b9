"""All subdomains of a rank in the dual problem: one product with a sparse matrix for all of them.

A subdomain's matrices are small: to call a product takes longer than to compute it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.solvers.dual.local_dual import LocalDual


class RankDual:
    """A rank's part of the dual problem, Eq. 30-31 of [BP17]: operators of ``LocalDual`` side by side.

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

    def apply(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply the rank's part of S_tot with one local solve of each subdomain.

        Parameters
        ----------
        v : (n ghost rows,) array
            Multipliers.

        Returns
        -------
        (n ghost rows,) array
            Sum of G_s A_s^-1 G_s^T v - H_s v.
        """
        y = np.concatenate(self.solve_forces(v))
        out = np.asarray(self._jump @ y - self._compliance @ v)
        for local in self._local_duals:
            if local.motion is not None:
                out[local.motion.rows] -= local.motion.block @ v[local.motion.rows]
        return out

    def solve_forces(self, v: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Find what multipliers do to the fields.

        Parameters
        ----------
        v : (n ghost rows,) array
            Multipliers.

        Returns
        -------
        list of (n_field,) arrays
            A_s^-1 G_s^T v of each subdomain.
        """
        forces = self._jump_transposed @ v
        return [local.operator.solve(forces[place])
                for local, place in zip(self._local_duals, self._fields, strict=True)]

    def sum_jumps(self, fields: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum what fields contribute to the rows.

        Parameters
        ----------
        fields : sequence of (n_field,) arrays
            y_s of each subdomain.

        Returns
        -------
        (n ghost rows,) array
            Sum of G_s y_s.
        """
        return np.asarray(self._jump @ np.concatenate(fields))


def list_places(sizes: Sequence[int]) -> list[slice]:
    """List where arrays of some sizes lie in all of them, one after the other.

    Parameters
    ----------
    sizes : sequence of int
        Of the arrays.

    Returns
    -------
    list of slice
        The place of each.
    """
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(begin, end) for begin, end in pairwise(ends)]
