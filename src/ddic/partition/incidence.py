"""Signed incidence of a subdomain's interface dofs in the chains' rows, plain and scaled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.partition.subdomain import Interface


def signed_incidence(interface: Interface, row_index: NDArray[np.int64], n_rows: int) -> sparse.csr_matrix:
    """B_s, (n_rows, n interface dofs): +1 on the row that a copy opens, -1 on the row that it closes.

    row_index: local index of each row number that appears, as ``np.searchsorted`` keys (sorted numbers).
    """
    opens = np.flatnonzero(interface.position < interface.multiplicity - 1)
    closes = np.flatnonzero(interface.position > 0)
    rows = np.concatenate([interface.first_row[opens] + interface.position[opens],
                           interface.first_row[closes] + interface.position[closes] - 1])
    values = np.concatenate([np.ones(len(opens)), -np.ones(len(closes))])
    columns = np.concatenate([opens, closes])
    shape = (n_rows, len(interface.dofs))
    return sparse.csr_matrix((values, (np.searchsorted(row_index, rows), columns)), shape=shape)


def scaled_incidence(interface: Interface, weights: NDArray[np.float64], weight_index: NDArray[np.int64],
                     row_index: NDArray[np.int64], n_rows: int) -> sparse.csr_matrix:
    """(B D^-1 B^T)^-1 B D^-1 restricted to one subdomain's columns, (n_rows, n interface dofs).

    With D = diag(weights) the transpose sends jumps v to the copies' displacements w of least D-norm
    with B w = v. On a chain w = z - mean_D(z), where z falls by v_k at row k; hence the entry of row k
    and copy p is (share of the copies after k) if p <= k, else minus (share of the copies up to k), with
    the shares of D.
    weights: values of D by copy; weight_index: their sorted copy numbers; row_index: sorted row numbers.
    """
    rows, columns, values = [], [], []
    for m in np.unique(interface.multiplicity):
        members = np.flatnonzero(interface.multiplicity == m)
        copies = interface.first_copy[members][:, None] + np.arange(m)
        share = weights[np.searchsorted(weight_index, copies)]
        up_to = np.cumsum(share / share.sum(axis=1, keepdims=True), axis=1)[:, :-1]
        before = interface.position[members][:, None] <= np.arange(m - 1)
        rows.append(interface.first_row[members][:, None] + np.arange(m - 1))
        columns.append(np.repeat(members[:, None], m - 1, axis=1))
        values.append(np.where(before, 1.0 - up_to, -up_to))
    shape = (n_rows, len(interface.dofs))
    if not rows:
        return sparse.csr_matrix(shape)
    flat = [np.concatenate([a.ravel() for a in arrays]) for arrays in (rows, columns, values)]
    return sparse.csr_matrix((flat[2], (np.searchsorted(row_index, flat[0]), flat[1])), shape=shape)


def rows_of(interface: Interface) -> NDArray[np.int64]:
    """Numbers of all rows of the chains that this subdomain is part of."""
    return _spread(interface.first_row, interface.multiplicity - 1)


def copies_of(interface: Interface) -> NDArray[np.int64]:
    """Numbers of all copies of the chains that this subdomain is part of."""
    return _spread(interface.first_copy, interface.multiplicity)


def _spread(first: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    ends = np.cumsum(counts)
    return np.asarray(np.repeat(first - (ends - counts), counts) + np.arange(counts.sum()))
