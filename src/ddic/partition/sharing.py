"""Subdomains cut from a mesh, which of them share which nodes and unknowns, and the numbers of interface rows.

Rows are those of C_s and Cbar_s. Nobody knows all subdomains: those that have copies of a thing tell one rank of it,
which decides for all of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import BoolArray, IntArray
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.nodal import NodalKinematics, component_numbers
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.subdomain import Interface, Subdomain, begin_subdomain

BLOCK = 1024
"""Things of neighbouring numbers that one rank decides on. A smaller number spreads that more evenly, and makes more
messages, for things of a subdomain have neighbouring numbers."""

T = TypeVar("T")


class Ranks(Protocol):
    """What ranks do together, each for its own subdomains, which follow those of the rank below."""

    @property
    def size(self) -> int:
        """How many there are."""

    def exchange(self, items: Mapping[int, T]) -> dict[int, T]:
        """Send an item to each of some ranks; what comes back is by rank that sent it, in their order."""

    def sum_below(self, counts: IntArray) -> IntArray:
        """Sum whole numbers, (n,), over the ranks below this one."""


class OneRank:
    """A rank that has all subdomains."""

    size = 1

    def exchange(self, items: Mapping[int, T]) -> dict[int, T]:
        """Give back what this rank sends itself."""
        return dict(items)

    def sum_below(self, counts: IntArray) -> IntArray:
        """Give zeros: there is no rank below."""
        return np.zeros_like(counts)


Decide = Callable[[IntArray, NDArray[Any]], NDArray[Any]]
"""From the numbers (n,) of all copies of some things and what each of them says, (n, k), to what each is told."""


def share_among_copies(ranks: Ranks, numbers: IntArray, said: NDArray[Any], decide: Decide) -> NDArray[Any]:
    """Decide something about things of which subdomains of several ranks have copies; collective.

    ``numbers``, (n,), are those of the things whose copies are here, and ``said``, (n, k), what each copy says. What
    each is told comes back in their order. Copies are decided on in the order of ranks, hence of subdomains.
    """
    rank_of = numbers // BLOCK % ranks.size
    sent = {int(rank): np.flatnonzero(rank_of == rank) for rank in np.unique(rank_of)}
    received = ranks.exchange({rank: (numbers[places], said[places]) for rank, places in sent.items()})
    returned = ranks.exchange(_decide_all(received, decide))
    nothing = decide(numbers[:0], said[:0])
    told = np.empty((len(numbers), *nothing.shape[1:]), nothing.dtype)
    for rank, places in sent.items():
        told[places] = returned[rank]
    return told


def _decide_all(received: Mapping[int, tuple[IntArray, NDArray[Any]]], decide: Decide) -> dict[int, NDArray[Any]]:
    """What each rank that sent (numbers, said) is told."""
    if not received:
        return {}
    told = decide(*(np.concatenate(arrays) for arrays in zip(*received.values(), strict=True)))
    ends = np.cumsum([len(numbers) for numbers, _ in received.values()])[:-1]
    return dict(zip(received, np.split(told, ends), strict=True))


def number_interfaces(subdomains: Sequence[Subdomain], has_row: Sequence[BoolArray], ranks: Ranks) -> list[Subdomain]:
    """Number the interfaces of this rank's subdomains, at least one, which did not know what they share; collective.

    ``has_row`` says by subdomain whether Kbar has a row for each unknown, (n_field,). Rows and copies of jumps and
    reactions are numbered by owner, kind and unknown, on any number of ranks alike.
    """
    indices = [s.index for s in subdomains]
    edges = [find_boundary_nodes(s.mesh) for s in subdomains]
    nodes = _count_copies(ranks, indices, [s.node_ids for s in subdomains],
                          [_limit(s, s.node_ids, edge) for s, edge in zip(subdomains, edges, strict=True)])
    numbers = [s.kinematics.numbers for s in subdomains]
    unknowns = _count_copies(ranks, indices, numbers,
                             [_limit(s, s.kinematics.numbers, component_numbers(edge, s.mesh.dim))
                              for s, edge in zip(subdomains, edges, strict=True)])
    chains = _number_chains(ranks, numbers, unknowns, has_row)
    connected = []
    for s, of_nodes, of_unknowns, (first, n_rows, n_copies) in zip(subdomains, nodes, unknowns, chains, strict=True):
        jumps, reactions = (_cut_interface(*of_unknowns, *of_kind) for of_kind in (first[:2], first[2:]))
        connected.append(replace(s, node_multiplicity=of_nodes[0], multiplicity=of_unknowns[0], jumps=jumps,
                                 reactions=reactions, n_owned_rows=n_rows, n_owned_copies=n_copies))
    return connected


def _limit(subdomain: Subdomain, numbers: IntArray, at_edge: IntArray) -> IntArray:
    """Places of the nodes or unknowns that other subdomains may have.

    Of displacements of nodes they are those at the edge of the subdomain's mesh; of other unknowns they may be all.
    """
    return at_edge if isinstance(subdomain.kinematics, NodalKinematics) else np.arange(len(numbers))


def _count_copies(ranks: Ranks, indices: Sequence[int], numbers: Sequence[IntArray],
                  places: Sequence[IntArray]) -> list[tuple[IntArray, IntArray]]:
    """By subdomain, how many have each of its things, and how many of these are below it, (n,) each.

    ``indices`` are those of the subdomains, ``numbers`` those of their things, (n,), of which others may have those at
    some ``places``.
    """
    at_places = [of_subdomain[at] for of_subdomain, at in zip(numbers, places, strict=True)]
    owners = np.repeat(indices, [len(at) for at in places])
    told = share_among_copies(ranks, np.concatenate(at_places), owners[:, None], _decide_place)
    counted = []
    for of_subdomain, at, of_places in zip(numbers, places, _split_by(told, places), strict=True):
        multiplicity, position = np.ones(len(of_subdomain), np.int64), np.zeros(len(of_subdomain), np.int64)
        multiplicity[at], position[at] = of_places.T
        counted.append((multiplicity, position))
    return counted


def _decide_place(numbers: IntArray, subdomains: IntArray) -> IntArray:
    """How many copies there are of each thing, and the place of each in the order of subdomains, (n, 2)."""
    order = np.lexsort((subdomains[:, 0], numbers))
    _, first, counts = np.unique(numbers[order], return_index=True, return_counts=True)
    told = np.empty((len(numbers), 2), np.int64)
    told[order] = np.stack([np.repeat(counts, counts), np.arange(len(numbers)) - np.repeat(first, counts)], axis=1)
    return told


def _number_chains(ranks: Ranks, numbers: Sequence[IntArray], unknowns: Sequence[tuple[IntArray, IntArray]],
                   has_row: Sequence[BoolArray]) -> list[tuple[IntArray, int, int]]:
    """By subdomain the numbers of chains' first rows and copies, and how many rows and copies it owns.

    The numbers, (4, n_field), are those of the jump's first row and copy and of the reaction's, -1 where there is no
    such chain. ``unknowns`` are multiplicities and positions.
    """
    owned = [_number_owned(*copies, rows) for copies, rows in zip(unknowns, has_row, strict=True)]
    counts = np.array([of_subdomain for _, of_subdomain in owned])
    before = np.cumsum(counts, axis=0) - counts + ranks.sum_below(counts.sum(axis=0))
    # What a chain's owner says of it is told to all copies; who has nothing to say says -1.
    said = [np.where(first < 0, -1, first + np.tile(offset, 2)[:, None])
            for (first, _), offset in zip(owned, before, strict=True)]
    shared = [np.flatnonzero(multiplicity > 1) for multiplicity, _ in unknowns]
    at_shared = [of_subdomain[at] for of_subdomain, at in zip(numbers, shared, strict=True)]
    said_there = [of_subdomain[:, at].T for of_subdomain, at in zip(said, shared, strict=True)]
    told = share_among_copies(ranks, np.concatenate(at_shared), np.concatenate(said_there), find_largest)
    for first, at, of_places in zip(said, shared, _split_by(told, shared), strict=True):
        first[:, at] = of_places.T
    return [(first, int(n_rows), int(n_copies)) for first, (n_rows, n_copies) in zip(said, counts, strict=True)]


def _number_owned(multiplicity: IntArray, position: IntArray, has_row: BoolArray) -> tuple[IntArray, IntArray]:
    """Numbers from 0 of a subdomain's own chains, (4, n_field), as above; how many rows and copies these have, (2,)."""
    jumps = np.flatnonzero((multiplicity > 1) & (position == 0))
    reactions = jumps[has_row[jumps]]
    n_copies = multiplicity[np.concatenate([jumps, reactions])]
    first = np.full((4, len(multiplicity)), -1, np.int64)
    for row, counts in enumerate((n_copies - 1, n_copies)):
        first[row, jumps], first[row + 2, reactions] = np.split(np.cumsum(counts) - counts, [len(jumps)])
    return first, np.array([(n_copies - 1).sum(), n_copies.sum()])


def find_largest(numbers: IntArray, values: IntArray) -> IntArray:
    """The largest of what the copies of each thing say, (n, k)."""
    thing = np.unique(numbers, return_inverse=True)[1]
    largest = np.full(values.shape, np.iinfo(np.int64).min)
    np.maximum.at(largest, thing, values)
    return largest[thing]


def _cut_interface(multiplicity: IntArray, position: IntArray, first_row: IntArray, first_copy: IntArray) -> Interface:
    """The chains of one kind at a subdomain's unknowns; -1 where an unknown has none."""
    at = np.flatnonzero(first_row >= 0)
    return Interface(at, multiplicity[at], position[at], first_row[at], first_copy[at])


def _split_by(values: IntArray, places: Sequence[IntArray]) -> list[IntArray]:
    """Values of all subdomains' places, split into those of each."""
    return np.split(values, np.cumsum([len(at) for at in places])[:-1])


def build_subdomains(kinematics: RegionKinematics, parts: IntArray, controlled: BoolArray,
                     interior: BoolArray | None = None) -> list[Subdomain]:
    """Cut a mesh and its unknowns into self-contained subdomains, all of them, by number.

    ``parts`` is the subdomain of each cell, 0 to n - 1 without gaps; ``controlled`` says whether each unknown's
    equilibrium row is controlled (P of Eq. 9 of [BP17]), and Kbar has a row for it. ``interior`` are the nodes at which
    texture is weighed against mechanics, (n_nodes,); by default those that are not on the mesh's boundary.
    """
    if interior is None:
        interior = np.ones(kinematics.mesh.n_nodes, dtype=bool)
        interior[find_boundary_nodes(kinematics.mesh)] = False
    subdomains = cut_subdomains(kinematics, parts, controlled, interior)
    return number_interfaces(subdomains, [s.controlled for s in subdomains], OneRank())


def cut_subdomains(kinematics: RegionKinematics, parts: IntArray, controlled: BoolArray,
                   interior: BoolArray) -> list[Subdomain]:
    """Cut subdomains as ``build_subdomains`` does, which do not know yet what they share with others."""
    subdomains = []
    for number, cells in enumerate(_group_by(parts, int(parts.max()) + 1)):
        mesh, node_ids = kinematics.mesh.create_submesh(cells)
        numbers = np.unique(kinematics.unknowns_at(node_ids)[0])
        subdomains.append(begin_subdomain(number, kinematics.restrict(mesh, node_ids, numbers), node_ids, cells,
                                          controlled[numbers], interior[node_ids]))
    return subdomains


def _group_by(labels: IntArray, n_groups: int) -> list[IntArray]:
    """Sorted places of each label, 0 to n_groups - 1."""
    order = np.argsort(labels, kind="stable")
    ends = np.cumsum(np.bincount(labels, minlength=n_groups))
    return [np.asarray(places, dtype=np.int64) for places in np.split(order, ends[:-1])]
