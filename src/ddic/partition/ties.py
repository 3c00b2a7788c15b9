"""A near field's own mesh in place of the far elements under it, tied to those around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.mesh.mesh import Mesh
from ddic.partition.contact import COVERED, Contact, check_contact, find_contact


@dataclass(frozen=True)
class Tying:
    """What the cells of several meshes, put into one, have to do with each other.

    Attributes
    ----------
    cameras : (n_cells,) array of int64
        Number of the near camera whose own mesh a cell is of; 0 for the far mesh.
    boundary : (n,) array of int64
        Sorted nodes on edges of one cell that touch no other mesh.
    weights : (n_nodes, n_unknown_nodes) csr_matrix
        Displacement of each node from that of the unknown ones, which come first: far nodes, then free near nodes. The
        last nodes are near ones tied to far ones.
    """

    cameras: NDArray[np.int64]
    boundary: NDArray[np.int64]
    weights: sparse.csr_matrix

    @property
    def n_unknown_nodes(self) -> int:
        """Number of nodes whose displacement is unknown."""
        return int(self.weights.shape[1])


def tie_meshes(far: Mesh, near: Mapping[int, Mesh]) -> tuple[Mesh, Tying]:
    """Put near meshes in place of the far cells whose centres they cover, and tell how nodes are tied.

    Near meshes are given by the number of their camera, in far-field pixels. The mesh has all cells that are left; node
    sets of one name are joined. Raises InputError where a near mesh cuts far cells, touches another near mesh or
    touches no far cell.
    """
    contact = find_contact(far, near)
    check_contact(contact)
    return _join(contact)


def _join(contact: Contact) -> tuple[Mesh, Tying]:
    numbering = _number_nodes(contact)
    rest = contact.far.rest
    mesh = _put_together([rest, *(near.mesh for near in contact.near)], numbering)
    camera_of_mesh = [0, *(near.number for near in contact.near)]
    n_cells = [rest.n_cells, *(near.mesh.n_cells for near in contact.near)]
    cameras = np.repeat(np.asarray(camera_of_mesh, dtype=np.int64), n_cells)
    return mesh, Tying(cameras, _find_boundary(contact, numbering), _weigh_nodes(contact, numbering))


@dataclass(frozen=True)
class _Numbering:
    """Numbers of nodes in the mesh of all: far ones, then free near ones, then slaves; by mesh, the far one first."""

    of_mesh: list[NDArray[np.int64]]
    n_unknown: int
    n_nodes: int


def _number_nodes(contact: Contact) -> _Numbering:
    n_far = contact.far.rest.n_nodes
    n_free = [near.mesh.n_nodes - len(near.mortar.slaves) for near in contact.near]
    next_free = n_far
    next_slave = n_unknown = n_far + sum(n_free)
    of_mesh = [np.arange(n_far)]
    for near in contact.near:
        is_slave = np.zeros(near.mesh.n_nodes, dtype=bool)
        is_slave[near.mortar.slaves] = True
        n_slaves = len(near.mortar.slaves)
        numbers = np.empty(near.mesh.n_nodes, dtype=np.int64)
        numbers[~is_slave] = next_free + np.arange(near.mesh.n_nodes - n_slaves)
        numbers[near.mortar.slaves] = next_slave + np.arange(n_slaves)
        of_mesh.append(numbers)
        next_free += near.mesh.n_nodes - n_slaves
        next_slave += n_slaves
    return _Numbering(of_mesh, n_unknown, n_nodes=next_slave)


def _put_together(meshes: Sequence[Mesh], numbering: _Numbering) -> Mesh:
    """One mesh of all cells, those of the first mesh first."""
    first = meshes[0]
    nodes = np.empty((numbering.n_nodes, first.dim))
    connectivity = []
    named_nodes: dict[str, list[NDArray[np.int64]]] = {}
    for mesh, numbers in zip(meshes, numbering.of_mesh, strict=True):
        nodes[numbers] = mesh.nodes
        connectivity.append(numbers[mesh.connectivity])
        for name, members in mesh.node_sets.items():
            named_nodes.setdefault(name, []).append(numbers[members])
    nodes_a_cell = np.concatenate([np.diff(mesh.offsets) for mesh in meshes])
    offsets = np.concatenate([[0], np.cumsum(nodes_a_cell)]).astype(np.int64)
    types = np.concatenate([mesh.types for mesh in meshes])
    node_sets = {name: np.unique(np.concatenate(members)) for name, members in sorted(named_nodes.items())}
    return Mesh(nodes, np.concatenate(connectivity), offsets, types, node_sets, first.mapping)


def _find_boundary(contact: Contact, numbering: _Numbering) -> NDArray[np.int64]:
    """Sorted nodes on edges that touch no other mesh."""
    far_numbers, *near_numbers = numbering.of_mesh
    free_far_edges = contact.far.edges[contact.far_cover < COVERED]
    nodes = [far_numbers[free_far_edges].ravel()]
    for near, numbers in zip(contact.near, near_numbers, strict=True):
        nodes.append(numbers[near.free_edges].ravel())
    return np.asarray(np.unique(np.concatenate(nodes)))


def _weigh_nodes(contact: Contact, numbering: _Numbering) -> sparse.csr_matrix:
    """Displacement of all nodes from that of the unknown ones."""
    n_free_near = numbering.n_unknown - contact.far.rest.n_nodes
    blocks = [sparse.identity(numbering.n_unknown, format="csr")]
    for near in contact.near:
        of_far_nodes = near.mortar.weights
        of_free_near_nodes = sparse.csr_matrix((len(near.mortar.slaves), n_free_near))
        blocks.append(sparse.hstack([of_far_nodes, of_free_near_nodes]).tocsr())
    return sparse.vstack(blocks).tocsr()
