"""Signed incidence of a subdomain's interface unknowns in the chains' rows, plain and scaled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.partition.subdomain import Interface


def signed_incidence(interface: Interface, row_index: NDArray[np.int64]) -> sparse.csr_matrix:
    """Build B_s: +1 on the row that a copy opens, -1 on the row that it closes.

    Parameters
    ----------
    interface : Interface
        Chains seen from the subdomain.
    row_index : (n_rows,) array of int64
        Sorted numbers of the rows that there are here.

    Returns
    -------
    (n_rows, n interface unknowns) csr_matrix
        B_s, no unit.
    """
    opens = np.flatnonzero(interface.position < interface.multiplicity - 1)
    closes = np.flatnonzero(interface.position > 0)
    opened_rows = interface.first_row[opens] + interface.position[opens]
    closed_rows = interface.first_row[closes] + interface.position[closes] - 1
    rows = np.searchsorted(row_index, np.concatenate([opened_rows, closed_rows]))
    columns = np.concatenate([opens, closes])
    signs = np.repeat([1.0, -1.0], [len(opens), len(closes)])
    return sparse.csr_matrix((signs, (rows, columns)), shape=(len(row_index), len(interface.unknowns)))


def scaled_incidence(interface: Interface, weights: NDArray[np.float64], weight_index: NDArray[np.int64],
                     row_index: NDArray[np.int64]) -> sparse.csr_matrix:
    """Build the columns of (B D^-1 B^T)^-1 B D^-1 that belong to one subdomain.

    With D = diag(weights) the transpose sends jumps v to the copies' displacements w of least D-norm with B w = v. On
    a chain w = z - mean_D(z), where z falls by v_k at row k; hence the entry of row k and copy p is (share of the
    copies after k) if p <= k, else minus (share of the copies up to k), with the shares of D.

    Parameters
    ----------
    interface : Interface
        Chains seen from the subdomain.
    weights : (n_copies,) array
        Values of D by copy.
    weight_index : (n_copies,) array of int64
        Sorted numbers of these copies.
    row_index : (n_rows,) array of int64
        Sorted numbers of the rows that there are here.

    Returns
    -------
    (n_rows, n interface unknowns) csr_matrix
        No unit.
    """
    rows = [np.zeros(0, np.int64)]
    columns = [np.zeros(0, np.int64)]
    values = [np.zeros(0)]
    for m in np.unique(interface.multiplicity):
        members = np.flatnonzero(interface.multiplicity == m)
        copies = interface.first_copy[members][:, None] + np.arange(m)
        d = weights[np.searchsorted(weight_index, copies)]
        share = d / d.sum(axis=1, keepdims=True)
        share_up_to = np.cumsum(share, axis=1)[:, :-1]
        is_before = interface.position[members][:, None] <= np.arange(m - 1)
        chain_rows = interface.first_row[members][:, None] + np.arange(m - 1)
        rows.append(chain_rows.ravel())
        columns.append(np.repeat(members, m - 1))
        values.append(np.where(is_before, 1.0 - share_up_to, -share_up_to).ravel())
    places = np.searchsorted(row_index, np.concatenate(rows))
    entries = (np.concatenate(values), (places, np.concatenate(columns)))
    return sparse.csr_matrix(entries, shape=(len(row_index), len(interface.unknowns)))


def rows_of(interface: Interface) -> NDArray[np.int64]:
    """List the rows of all chains that a subdomain is part of.

    Parameters
    ----------
    interface : Interface
        Chains seen from the subdomain.

    Returns
    -------
    (n,) array of int64
        Numbers of rows, chain after chain.
    """
    return _count_from(interface.first_row, interface.multiplicity - 1)


def copies_of(interface: Interface) -> NDArray[np.int64]:
    """List the copies of all chains that a subdomain is part of.

    Parameters
    ----------
    interface : Interface
        Chains seen from the subdomain.

    Returns
    -------
    (n,) array of int64
        Numbers of copies, chain after chain.
    """
    return _count_from(interface.first_copy, interface.multiplicity)


def _count_from(first: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Counts of numbers from each first one on, one sequence after the other."""
    ends = np.cumsum(counts)
    return np.asarray(np.repeat(first - (ends - counts), counts) + np.arange(counts.sum()))
