"""Whether every unknown is held by pixels that a frame shows, or by mechanics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import SingularSubdomainError
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import Assembly
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem

DETERMINED = 1e-5
"""Lowest eigenvalue of eta K^T K, relative to the mean diagonal of M, with which equilibrium determines unknowns that
neither pixels nor rows of their own hold. Along an edge whose forces are unknown it falls tenfold with every element;
a larger value refuses more, a smaller one lets errors of the field grow more on their way along the edge."""

CellCounts = tuple[NDArray[np.int64], ...]
"""Pixels of each cell, (n_cells,), by view of a subdomain."""


@dataclass(frozen=True)
class _Rows:
    """What a subdomain adds to rows of K that are controlled, in columns of unknowns that no pixel holds.

    rows, columns: (n,) numbers in the whole problem; values: (n,).
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    values: NDArray[np.float64]


def find_held(subdomain: Subdomain, counts: CellCounts) -> NDArray[np.bool_]:
    """Find the unknowns that pixels hold: those that displace a node of a cell with pixels.

    Parameters
    ----------
    subdomain : Subdomain
        Its cells and unknowns.
    counts : tuple of (n_cells,) array
        Pixels of each cell, by view.

    Returns
    -------
    (n_field,) array of bool
        Whether pixels hold each unknown of the field.
    """
    return sum_pixels(subdomain, counts) > 0


def sum_pixels(subdomain: Subdomain, counts: CellCounts) -> NDArray[np.float64]:
    """Sum the pixels that see each unknown: those of the cells about the nodes that it displaces.

    Parameters
    ----------
    subdomain : Subdomain
        Its cells and unknowns.
    counts : tuple of (n_cells,) array
        Pixels of each cell, by view.

    Returns
    -------
    (n_field,) array
        Pixels, weighted by how far the unknown displaces each node.
    """
    mesh = subdomain.mesh
    n_pixels = np.sum(counts, axis=0)
    of_corners = np.repeat(n_pixels, np.diff(mesh.offsets))
    of_nodes = np.bincount(mesh.connectivity, weights=of_corners, minlength=mesh.n_nodes)
    return np.asarray(abs(subdomain.kinematics.tangent).T @ np.repeat(of_nodes, mesh.dim))


def is_determined(team: Team, unseen: Sequence[NDArray[np.bool_]], assembly: Assembly) -> bool:
    """Tell whether mechanics determine what a frame does not show; collective.

    Unknowns that no pixel holds in any subdomain must follow from the others by equilibrium. They do where each has a
    controlled row of its own. Where some have none, the rows that there are decide: around a corner, say, that of the
    one inner node.

    Parameters
    ----------
    team : Team
        All ranks.
    unseen : sequence of (n_field,) array of bool
        Unknowns of owned subdomains that the frame leaves without pixels there.
    assembly : Assembly
        The systems of the same subdomains.

    Returns
    -------
    bool
        The same on all ranks.
    """
    subdomains = [system.subdomain for system in assembly.systems]
    unheld = find_free_unknowns(team, subdomains, unseen)
    copies = [number for s in subdomains for number in s.kinematics.numbers[~s.controlled].tolist()
              if number in unheld]
    if not team.gather_lists(copies):
        return True
    if assembly.eta == 0:
        return False
    numbers = np.array(sorted(unheld))
    rows = team.gather_to([_find_rows(system, numbers) for system in assembly.systems])

    def check() -> bool:
        found = [of_subdomain for of_rank in require_held(rows) for of_subdomain in of_rank]
        gap = _join_rows(found, numbers)
        operator = (assembly.eta * (gap.T @ gap)).tocsr()
        try:
            LocalOperator(operator, smallest_eigenvalue=DETERMINED * assembly.mean_diagonal,
                          where="what the frame does not show").destroy()
        except SingularSubdomainError:
            return False
        return True

    return bool(team.on_root(check))


def find_free_unknowns(team: Team, subdomains: Sequence[Subdomain], unseen: Sequence[NDArray[np.bool_]]) -> set[int]:
    """Find the unknowns that no pixel holds in any subdomain; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        Owned ones.
    unseen : sequence of (n_field,) array of bool
        Their unknowns without pixels.

    Returns
    -------
    set of int
        Numbers in the whole problem, on all ranks.
    """
    copies = [copy for s, is_unseen in zip(subdomains, unseen, strict=True)
              for copy in zip(s.kinematics.numbers[is_unseen].tolist(), s.multiplicity[is_unseen].tolist(),
                              strict=True)]
    gathered = team.gather_lists(copies)
    n_copies = Counter(number for number, _ in gathered)
    # Held in none of the subdomains that share it.
    return {number for number, multiplicity in gathered if n_copies[number] == multiplicity}


def _find_rows(system: LocalSystem, unheld: NDArray[np.int64]) -> _Rows:
    """A subdomain's part of K in the controlled rows and in the columns of unheld unknowns, given by number."""
    numbers = system.subdomain.kinematics.numbers
    columns = np.flatnonzero(np.isin(numbers, unheld))
    if system.controlled_stiffness is None:
        return _Rows(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    entries = system.controlled_stiffness[:, columns].tocoo()
    # Without the weights of interface rows, a row of the whole K is the sum of the subdomains'.
    return _Rows(numbers[entries.row], numbers[columns[entries.col]], entries.data / system.row_weights[entries.row])


def _join_rows(found: Sequence[_Rows], unheld: NDArray[np.int64]) -> sparse.csr_matrix:
    """Sum the subdomains' parts of rows: (n_rows, n_unheld)."""
    row_numbers, rows = np.unique(np.concatenate([part.rows for part in found]), return_inverse=True)
    columns = np.searchsorted(unheld, np.concatenate([part.columns for part in found]))
    values = np.concatenate([part.values for part in found])
    return sparse.csr_matrix((values, (rows.ravel(), columns)), shape=(len(row_numbers), len(unheld)))
