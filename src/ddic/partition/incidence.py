"""Signed incidence of a subdomain's interface unknowns in the chains' rows, plain and scaled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.partition.subdomain import Interface

Entries = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
"""Of a sparse matrix: numbers of rows, columns, values; each (n_entries,)."""


def signed_incidence(interface: Interface, row_index: NDArray[np.int64]) -> sparse.csc_matrix:
    """Build B_s: +1 on the row that a copy opens, -1 on the row that it closes.

    Parameters
    ----------
    interface : Interface
        Chains seen from the subdomain.
    row_index : (n_rows,) array of int64
        Sorted numbers of the rows that there are here.

    Returns
    -------
    (n_rows, n interface unknowns) csc_matrix
        B_s, no unit.
    """
    # On a chain of m copies, row k leads from copy k to copy k + 1.
    is_not_last = interface.position < interface.multiplicity - 1
    is_not_first = interface.position > 0
    opens = np.flatnonzero(is_not_last)
    closes = np.flatnonzero(is_not_first)
    opened_rows = interface.first_row[opens] + interface.position[opens]
    closed_rows = interface.first_row[closes] + interface.position[closes] - 1
    rows = np.concatenate([opened_rows, closed_rows])
    columns = np.concatenate([opens, closes])
    signs = np.repeat([1.0, -1.0], [len(opens), len(closes)])
    return _build_matrix(interface, row_index, (rows, columns, signs))


def scaled_incidence(interface: Interface, weights: NDArray[np.float64], weight_index: NDArray[np.int64],
                     row_index: NDArray[np.int64]) -> sparse.csc_matrix:
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
    (n_rows, n interface unknowns) csc_matrix
        No unit.
    """
    no_entries = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    entries = [no_entries]
    for multiplicity in np.unique(interface.multiplicity):
        members = np.flatnonzero(interface.multiplicity == multiplicity)
        entries.append(_scaled_entries(interface, members, weights, weight_index))
    rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return _build_matrix(interface, row_index, (rows, columns, values))


def _scaled_entries(interface: Interface, members: NDArray[np.int64], weights: NDArray[np.float64],
                    weight_index: NDArray[np.int64]) -> Entries:
    """Entries at those interface unknowns, given by place, that are on chains of one length."""
    n_copies = int(interface.multiplicity[members[0]])
    n_rows = n_copies - 1
    copies = interface.first_copy[members, None] + np.arange(n_copies)
    rows = interface.first_row[members, None] + np.arange(n_rows)
    # By member and copy of its chain: the share of D; then by member and row: the share up to the row.
    of_copies = weights[np.searchsorted(weight_index, copies)]
    share = of_copies / of_copies.sum(axis=1, keepdims=True)
    share_up_to_row = np.cumsum(share, axis=1)[:, :n_rows]
    is_before_row = interface.position[members, None] <= np.arange(n_rows)
    values = np.where(is_before_row, 1.0 - share_up_to_row, -share_up_to_row)
    columns = np.repeat(members, n_rows)
    return rows.ravel(), columns, values.ravel()


def _build_matrix(interface: Interface, row_index: NDArray[np.int64], entries: Entries) -> sparse.csc_matrix:
    """From entries by number of row to a matrix of the rows that there are here.

    By columns, of which a subdomain has few: rows are those of all subdomains of a rank.
    """
    rows, columns, values = entries
    places = np.searchsorted(row_index, rows)
    shape = (len(row_index), len(interface.unknowns))
    return sparse.csc_matrix((values, (places, columns)), shape=shape)


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
    starts = ends - counts
    # Counting on through all sequences gives each number plus the place where its sequence starts.
    counted_on = np.arange(counts.sum())
    return np.asarray(counted_on + np.repeat(first - starts, counts))
