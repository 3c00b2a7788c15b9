"""A subdomain: its part of the mesh, its unknowns, and the signed incidence of those that it shares with neighbours."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.cell_parts import list_ranges
from ddic.mesh.mesh import Mesh

Weighting = Literal["consistent", "paper"]


@dataclass(frozen=True)
class Interface:
    """Interface unknowns of one kind (displacement jumps or reactions) seen from one subdomain.

    An unknown shared by m subdomains carries m - 1 rows, a chain over the subdomains in increasing order: row k is
    (copy k) - (copy k + 1), so that rows are non-redundant at cross points.

    An unknown's rows and copies are numbered one after the other, over the whole region, independently of the number
    of ranks: those of subdomain 0's chains first (a chain belongs to its lowest subdomain).

    Attributes
    ----------
    unknowns : (n,) array of int64
        The subdomain's unknowns on the interface, by their place in the subdomain.
    multiplicity : (n,) array of int64
        Number m of subdomains that share each.
    position : (n,) array of int64
        Place of this subdomain in each chain, 0 <= position < m.
    first_row, first_copy : (n,) array of int64
        Numbers of each chain's first row and of its first copy; the others follow.
    """

    unknowns: IntArray
    multiplicity: IntArray
    position: IntArray
    first_row: IntArray
    first_copy: IntArray


_NONE = np.zeros(0, np.int64)
NO_CHAINS = Interface(_NONE, _NONE, _NONE, _NONE, _NONE)
"""Of a subdomain that shares nothing."""


@dataclass(frozen=True)
class MotionUnknowns:
    """Unknowns of the motion of a near-field set-up between its two pictures (alpha of Eq. 20 of [BP17]).

    Attributes
    ----------
    numbers : (n,) array of int64
        In the whole problem, after all unknowns of the field.
    rows : (n,) array of int64
        In the interface problem, after all chains.
    n_subdomains : int
        How many subdomains share them.
    owned : bool
        Whether they belong to this subdomain.
    """

    numbers: IntArray
    rows: IntArray
    n_subdomains: int
    owned: bool


@dataclass(frozen=True)
class Subdomain:
    """One subdomain, self-contained: what a rank receives.

    Its unknowns are those of the field, then those of its camera's motion.

    Attributes
    ----------
    index : int
        Its number.
    mesh : Mesh
        Its cells, specimen's frame, pixels.
    node_ids, cell_ids : (n_nodes,) and (n_cells,) array of int64
        Numbers of its nodes and cells in the whole mesh.
    kinematics : Kinematics
        From the field's unknowns to the displacement of its nodes in the specimen's frame.
    controlled : (n_field,) array of bool
        Whether the equilibrium row of each unknown of the field is controlled (P of Eq. 9 of [BP17]).
    interior : (n_nodes,) array of bool
        Whether a node lies inside the whole mesh, where texture is weighed against mechanics.
    node_multiplicity, multiplicity : (n_nodes,) and (n_field,) array of int64
        Number of subdomains that share each node, and each unknown of the field.
    jumps, reactions : Interface
        Rows of C_s (Lambda) and of Cbar_s (LambdaBar).
    n_owned_rows, n_owned_copies : int
        Interface rows that belong to this subdomain, those of its chains and some of motions; copies of these chains.
    camera : int
        Number of the camera whose pixels it has, 0 the first.
    motion : MotionUnknowns, optional
        Unknowns of the motion of that camera's set-up; None where it does not move.
    """

    index: int
    mesh: Mesh
    node_ids: IntArray
    cell_ids: IntArray
    kinematics: Kinematics
    controlled: BoolArray
    interior: BoolArray
    node_multiplicity: IntArray
    multiplicity: IntArray
    jumps: Interface
    reactions: Interface
    n_owned_rows: int
    n_owned_copies: int
    camera: int = 0
    motion: MotionUnknowns | None = None

    @property
    def n_field(self) -> int:
        """Number of unknowns of the field."""
        return self.kinematics.n_unknowns

    @property
    def n_motion(self) -> int:
        """Number of unknowns of its camera's motion."""
        return 0 if self.motion is None else len(self.motion.numbers)

    @property
    def n_unknowns(self) -> int:
        """Number of all its unknowns."""
        return self.n_field + self.n_motion

    @property
    def numbers(self) -> IntArray:
        """Numbers of all its unknowns in the whole problem, (n_unknowns,)."""
        field = self.kinematics.numbers
        return field if self.motion is None else np.concatenate([field, self.motion.numbers])

    @property
    def all_multiplicity(self) -> IntArray:
        """Number of subdomains that share each of its unknowns, (n_unknowns,)."""
        if self.motion is None:
            return self.multiplicity
        of_motion = np.full(self.n_motion, self.motion.n_subdomains, dtype=np.int64)
        return np.concatenate([self.multiplicity, of_motion])

    @property
    def owned(self) -> BoolArray:
        """Whether each unknown belongs to this subdomain, the lowest of those that share it, (n_unknowns,)."""
        owned = np.ones(self.n_unknowns, dtype=bool)
        owned[self.jumps.unknowns[self.jumps.position > 0]] = False
        if self.motion is not None:
            owned[self.n_field:] = self.motion.owned
        return owned

    def displacement(self, unknowns: Array) -> Array:
        """Displace the mesh's nodes in the specimen's frame, (mesh.n_dofs,), node by node, pixels.

        ``unknowns`` are those of the field; those of a motion after them do not matter.
        """
        return self.kinematics.displacement(unknowns[:self.n_field])


def begin_subdomain(index: int, kinematics: Kinematics, node_ids: IntArray, cell_ids: IntArray, controlled: BoolArray,
                    interior: BoolArray) -> Subdomain:
    """Begin a subdomain, which does not know yet what it shares with others; arguments are as its attributes."""
    return Subdomain(index, kinematics.mesh, node_ids, cell_ids, kinematics, controlled, interior,
                     node_multiplicity=np.ones(len(node_ids), np.int64),
                     multiplicity=np.ones(kinematics.n_unknowns, np.int64),
                     jumps=NO_CHAINS, reactions=NO_CHAINS, n_owned_rows=0, n_owned_copies=0)


def interface_weights(multiplicity: IntArray, weighting: Weighting) -> Array:
    """Weigh the interface rows of Kbar_s and of Cbar_s^T, from the multiplicity of each unknown, (n_field,).

    "consistent": sqrt(m), which makes the decomposed solution the one-domain solution. "paper": 1, which makes it that
    of the one-domain problem with interface rows weighted 1/sqrt(m).
    """
    if weighting == "paper":
        return np.ones(len(multiplicity))
    return np.sqrt(multiplicity.astype(np.float64))


Entries = tuple[IntArray, IntArray, Array]
"""Of a sparse matrix: numbers of rows, columns, values; each (n_entries,)."""


def signed_incidence(interface: Interface, row_index: IntArray) -> sparse.csc_matrix:
    """Build B_s: +1 on the row that a copy opens, -1 on the row that it closes.

    (n_rows, n interface unknowns); ``row_index`` are the sorted numbers of the rows that there are here.
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


def scaled_incidence(interface: Interface, weights: Array, weight_index: IntArray,
                     row_index: IntArray) -> sparse.csc_matrix:
    """Build the columns of (B D^-1 B^T)^-1 B D^-1 that belong to one subdomain, (n_rows, n interface unknowns).

    With D = diag(weights) the transpose sends jumps v to the copies' displacements w of least D-norm with B w = v. On a
    chain w = z - mean_D(z), where z falls by v_k at row k; hence the entry of row k and copy p is (share of the copies
    after k) if p <= k, else minus (share of the copies up to k), with the shares of D.

    ``weights`` are the values of D at the copies whose sorted numbers are ``weight_index``; ``row_index`` are the
    sorted numbers of the rows that there are here.
    """
    no_entries = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    entries = [no_entries]
    for multiplicity in np.unique(interface.multiplicity):
        members = np.flatnonzero(interface.multiplicity == multiplicity)
        entries.append(_scaled_entries(interface, members, weights, weight_index))
    rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return _build_matrix(interface, row_index, (rows, columns, values))


def _scaled_entries(interface: Interface, members: IntArray, weights: Array, weight_index: IntArray) -> Entries:
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


def _build_matrix(interface: Interface, row_index: IntArray, entries: Entries) -> sparse.csc_matrix:
    """From entries by number of row to a matrix of the rows that there are here."""
    rows, columns, values = entries
    places = np.searchsorted(row_index, rows)
    shape = (len(row_index), len(interface.unknowns))
    # By columns, of which a subdomain has few: rows are those of all subdomains of a rank.
    return sparse.csc_matrix((values, (places, columns)), shape=shape)


def rows_of(interface: Interface) -> IntArray:
    """List the rows of all chains that a subdomain is part of, by number, chain after chain."""
    return list_ranges(interface.first_row, interface.multiplicity - 1)


def copies_of(interface: Interface) -> IntArray:
    """List the copies of all chains that a subdomain is part of, by number, chain after chain."""
    return list_ranges(interface.first_copy, interface.multiplicity)
