"""Which subdomains share which unknowns, and the numbering of interface rows (C_s, Cbar_s)."""

from dataclasses import dataclass

import numpy as np

from ddic.arrays import BoolArray, IntArray
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.subdomain import Interface, Subdomain

JUMPS, REACTIONS = 0, 1
"""The two kinds of chains: of C_s and of Cbar_s."""


@dataclass(frozen=True)
class Sharing:
    """Copies of things (nodes, or unknowns) in subdomains, sorted by thing and then by subdomain.

    Attributes
    ----------
    numbers, subdomains : (n_copies,) array of int64
        Number of the thing, and subdomain that has the copy.
    multiplicity : (n_things,) array of int64
        Number of subdomains at each thing.
    """

    numbers: IntArray
    subdomains: IntArray
    multiplicity: IntArray

    @property
    def position(self) -> IntArray:
        """Place of each copy among those of its thing, from 0, (n_copies,)."""
        first = np.cumsum(self.multiplicity) - self.multiplicity
        return np.asarray(np.arange(len(self.numbers)) - first[self.numbers])

    @property
    def lowest(self) -> IntArray:
        """Lowest subdomain of each thing, (n_things,)."""
        lowest = np.zeros(len(self.multiplicity), dtype=np.int64)
        is_first = self.position == 0
        lowest[self.numbers[is_first]] = self.subdomains[is_first]
        return lowest


@dataclass(frozen=True)
class Chains:
    """Numbering of the chains of both kinds over the whole region.

    Attributes
    ----------
    first_row, first_copy : (2, n_unknowns) array of int64
        By kind and unknown; -1 where an unknown has no chain of that kind.
    owned_rows, owned_copies : (n_subdomains,) array of int64
        How many belong to each subdomain.
    """

    first_row: IntArray
    first_copy: IntArray
    owned_rows: IntArray
    owned_copies: IntArray


def share_nodes(mesh: Mesh, parts: IntArray) -> Sharing:
    """Find which subdomains share each node of the whole mesh.

    ``parts`` is the subdomain of each cell, from 0 without gaps.
    """
    owner = np.repeat(parts, np.diff(mesh.offsets))
    return _share(mesh.connectivity, owner, mesh.n_nodes)


def share_unknowns(nodes: Sharing, kinematics: RegionKinematics) -> Sharing:
    """Find which subdomains share each unknown: those with a node that it displaces."""
    unknowns, counts = kinematics.unknowns_at(nodes.numbers)
    return _share(unknowns, np.repeat(nodes.subdomains, counts), kinematics.n_unknowns)


def _share(numbers: IntArray, subdomains: IntArray, n_things: int) -> Sharing:
    """Pairs of a thing and a subdomain, each once, sorted by thing and then by subdomain."""
    n_subdomains = int(subdomains.max()) + 1
    pairs = np.unique(numbers * n_subdomains + subdomains)
    things, of_things = np.divmod(pairs, n_subdomains)
    return Sharing(things, of_things, np.bincount(things, minlength=n_things))


def number_chains(sharing: Sharing, has_row: BoolArray, n_subdomains: int) -> Chains:
    """Number rows and copies of jumps and reactions by owner, kind and unknown.

    ``sharing`` is that of the unknowns; ``has_row`` says whether Kbar has a row for each, (n_unknowns,).
    """
    n_unknowns = len(has_row)
    shared = sharing.multiplicity > 1
    with_jump = np.flatnonzero(shared)
    with_reaction = np.flatnonzero(shared & has_row)
    unknown = np.concatenate([with_jump, with_reaction])
    kind = np.repeat([JUMPS, REACTIONS], [len(with_jump), len(with_reaction)])
    owner = sharing.lowest[unknown]

    order = np.lexsort((unknown, kind, owner))
    unknown, kind, owner = unknown[order], kind[order], owner[order]
    n_copies = sharing.multiplicity[unknown]
    n_rows = n_copies - 1
    first_row = np.full((2, n_unknowns), -1, dtype=np.int64)
    first_copy = np.full((2, n_unknowns), -1, dtype=np.int64)
    first_row[kind, unknown] = np.cumsum(n_rows) - n_rows
    first_copy[kind, unknown] = np.cumsum(n_copies) - n_copies
    owned_rows = np.bincount(owner, weights=n_rows, minlength=n_subdomains)
    owned_copies = np.bincount(owner, weights=n_copies, minlength=n_subdomains)
    return Chains(first_row, first_copy, owned_rows.astype(np.int64), owned_copies.astype(np.int64))


def build_subdomains(kinematics: RegionKinematics, parts: IntArray, controlled: BoolArray,
                     interior: BoolArray | None = None, has_row: BoolArray | None = None) -> list[Subdomain]:
    """Cut a mesh and its unknowns into self-contained subdomains, all of them, by number.

    ``parts`` is the subdomain of each cell, 0 to n - 1 without gaps; ``controlled`` says whether each unknown's
    equilibrium row is controlled (P of Eq. 9 of [BP17]), ``has_row`` whether Kbar has a row for it, of whatever
    weight: by default for controlled ones. ``interior`` are the nodes at which texture is weighed against mechanics,
    (n_nodes,); by default those that are not on the mesh's boundary.
    """
    mesh = kinematics.mesh
    n_subdomains = int(parts.max()) + 1
    nodes = share_nodes(mesh, parts)
    unknowns = share_unknowns(nodes, kinematics)
    chains = number_chains(unknowns, controlled if has_row is None else has_row, n_subdomains)
    if interior is None:
        interior = np.ones(mesh.n_nodes, dtype=bool)
        interior[find_boundary_nodes(mesh)] = False
    # Place of each copy of an unknown in its chain.
    position = unknowns.position
    subdomains = []
    for number, (cells, copies) in enumerate(zip(_group_by(parts, n_subdomains),
                                                 _group_by(unknowns.subdomains, n_subdomains), strict=True)):
        submesh, node_ids = mesh.create_submesh(cells)
        numbers = unknowns.numbers[copies]
        multiplicity = unknowns.multiplicity[numbers]
        jumps, reactions = (_cut_interface(chains, kind, numbers, multiplicity, position[copies])
                            for kind in (JUMPS, REACTIONS))
        subdomains.append(Subdomain(
            index=number, mesh=submesh, node_ids=node_ids, cell_ids=cells,
            kinematics=kinematics.restrict(submesh, node_ids, numbers),
            controlled=controlled[numbers],
            interior=interior[node_ids],
            node_multiplicity=nodes.multiplicity[node_ids],
            multiplicity=multiplicity,
            jumps=jumps,
            reactions=reactions,
            n_owned_rows=int(chains.owned_rows[number]),
            n_owned_copies=int(chains.owned_copies[number]),
        ))
    return subdomains


def _cut_interface(chains: Chains, kind: int, numbers: IntArray, multiplicity: IntArray,
                   position: IntArray) -> Interface:
    """The chains of one kind at a subdomain's unknowns, each (n,): numbers, sharing subdomains, place in the chain."""
    first_row = chains.first_row[kind, numbers]
    at = np.flatnonzero(first_row >= 0)
    return Interface(unknowns=at, multiplicity=multiplicity[at], position=position[at], first_row=first_row[at],
                     first_copy=chains.first_copy[kind, numbers[at]])


def _group_by(labels: IntArray, n_groups: int) -> list[IntArray]:
    """Sorted places of each label, 0 to n_groups - 1."""
    order = np.argsort(labels, kind="stable")
    ends = np.cumsum(np.bincount(labels, minlength=n_groups))
    return [np.asarray(places, dtype=np.int64) for places in np.split(order, ends[:-1])]
