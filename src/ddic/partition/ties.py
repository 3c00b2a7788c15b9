"""A near field's own mesh in place of the far elements under it, tied to those around it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError, list_first
from ddic.mesh.cell_parts import find_offsets
from ddic.mesh.interpolation import find_cells_with_points, is_inside_outline
from ddic.mesh.mesh import Mesh
from ddic.mesh.mortar import Mortar, Sides, find_overlaps, integrate_mortar
from ddic.mesh.topology import Facets, find_boundary_facets, find_facets

TOLERANCE = 1e-6
"""Distance below which points are one, as a share of the far mesh's larger side. A larger value joins edges that lie
further apart."""

COVERED = 1e-3
"""Share of an edge that may be missing from what runs along it. A larger value lets edges end further apart."""


@dataclass(frozen=True)
class _FarSide:
    """The far mesh, pixels, in which near meshes take the place of some cells: by number of their camera, 0 for none.

    ``rest`` is the mesh of the cells that are kept, whose cells and nodes have these numbers in the whole far mesh, and
    whose boundary are ``edges``, (n_edges, 2), by its nodes; ``tolerance`` is the distance below which points are one.
    """

    whole: Mesh
    replaced_by: IntArray
    tolerance: float
    rest: Mesh
    kept_cells: IntArray
    node_ids: IntArray
    edges: IntArray


@dataclass(frozen=True)
class _NearSide:
    """A near mesh, far-field pixels, beside the rest of the far one; its camera is numbered from 1.

    ``edges`` are its boundary, (n_edges, 2), by nodes; ``cover`` is the share of each that far edges cover,
    ``far_cover`` that of each far edge that these cover. The mortar has its nodes on the common line follow far nodes.
    """

    number: int
    mesh: Mesh
    edges: IntArray
    cover: Array
    far_cover: Array
    mortar: Mortar

    @property
    def free_edges(self) -> IntArray:
        """Edges that touch no far cell, by nodes, (n, 2)."""
        return self.edges[self.cover <= COVERED]


@dataclass(frozen=True)
class _Contact:
    """What is left of the far mesh, the near meshes beside it, and the share of each far edge that near edges cover."""

    far: _FarSide
    near: list[_NearSide]
    far_cover: Array


def _find_contact(far: Mesh, near: Mapping[int, Mesh]) -> _Contact:
    """Find which far cells near meshes replace, and where they touch the others.

    What comes back is not checked yet for edges that do not follow each other. Raises InputError where near meshes
    overlap or touch each other, leave no far cell, or touch none.
    """
    replaced_by = _find_replaced_cells(far, near)
    tolerance = TOLERANCE * float(np.ptp(far.nodes, axis=0).max())
    kept_cells = np.flatnonzero(replaced_by == 0)
    rest, node_ids = far.create_submesh(kept_cells)
    far_side = _FarSide(far, replaced_by, tolerance, rest, kept_cells, node_ids, _boundary_edges(rest))
    sides = [_find_near_side(far_side, number, mesh) for number, mesh in near.items()]
    far_cover = np.sum([side.far_cover for side in sides], axis=0)
    return _Contact(far_side, sides, np.asarray(far_cover, dtype=np.float64))


def _find_replaced_cells(far: Mesh, near: Mapping[int, Mesh]) -> IntArray:
    """Number of the near camera whose mesh covers the centre of each far cell, (n_cells,), 0 for none."""
    replaced_by = np.zeros(far.n_cells, dtype=np.int64)
    for number, mesh in near.items():
        inside = is_inside_outline(far.centroids, mesh)
        earlier = int(replaced_by[inside].max(initial=0))
        if earlier > 0:
            raise InputError(f"near, entry {number}: its mesh overlaps that of entry {earlier}; "
                             "let them cover different far elements")
        replaced_by[inside] = number
    _refuse_neighbours(far, replaced_by)
    if (replaced_by > 0).all():
        raise InputError("near.mesh: the near fields' meshes cover every far element, which leaves none to the "
                         "far-field images; use smaller ones, or measure with the near-field images alone")
    return replaced_by


def _refuse_neighbours(far: Mesh, replaced_by: IntArray) -> None:
    """Raise InputError where two near meshes would have a boundary in common."""
    facets = find_facets(far)
    n_facets = len(facets.nodes)
    of_sides = replaced_by[facets.side_cells]
    # The least and the largest number among the cells of each facet.
    low = np.full(n_facets, np.iinfo(np.int64).max)
    high = np.zeros(n_facets, dtype=np.int64)
    np.minimum.at(low, facets.side_facets, of_sides)
    np.maximum.at(high, facets.side_facets, of_sides)
    between = np.flatnonzero((low > 0) & (low < high))
    if len(between):
        first = between[0]
        raise InputError(f"near, entry {high[first]}: its mesh touches that of entry {low[first]}; leave one far "
                         "element at least between them")


def _find_near_side(far: _FarSide, number: int, mesh: Mesh) -> _NearSide:
    edges = _boundary_edges(mesh)
    sides = Sides(far.rest.nodes, far.edges, mesh.nodes, edges, far.tolerance)
    overlaps = find_overlaps(sides)
    if len(overlaps.near) == 0:
        raise InputError(f"near, entry {number}: its mesh has no boundary in common with the far elements around it; "
                         "align its outline with edges of far elements")
    cover, far_cover = overlaps.measure_near_cover(len(edges)), overlaps.measure_far_cover(len(far.edges))
    return _NearSide(number, mesh, edges, cover, far_cover, integrate_mortar(sides, overlaps))


def _boundary_edges(mesh: Mesh) -> IntArray:
    """Edges of one cell, by the nodes of their ends, (n, 2)."""
    return np.asarray(find_boundary_facets(mesh)[:, :2])


def _check_contact(contact: _Contact) -> None:
    """Check that the outline of each near mesh follows far edges from node to node.

    Raises InputError where an outline cuts far cells, or an edge touches the other side only in part, or twice.
    """
    _refuse_cut_cells(contact)
    far = contact.far
    partly = _covered_in_part(contact.far_cover)
    if partly.any():
        x, y = far.rest.nodes[far.edges[partly][0]].mean(axis=0)
        raise InputError(f"near.mesh: the edge of a far element around column {x:.0f}, row {y:.0f} touches a near mesh "
                         "in part only; let the common boundary end at nodes of both meshes")
    for near in contact.near:
        partly = _covered_in_part(near.cover)
        if partly.any():
            x, y = near.mesh.nodes[near.edges[partly][0]].mean(axis=0)
            raise InputError(f"near, entry {near.number}: an edge of its mesh around column {x:.1f}, row {y:.1f} "
                             "touches far elements in part only; let the common boundary end at nodes of both meshes")


def _refuse_cut_cells(contact: _Contact) -> None:
    """Raise InputError, with the far cells' numbers, where a near mesh's outline does not follow far edges."""
    far = contact.far
    beside_gap = _cells_beside_gap(contact)
    problems = []
    for near in contact.near:
        cut = _find_cut_cells(far, near)
        if not len(cut):
            # The near mesh cuts no cell that is kept, but it may end inside one that it replaces.
            cut = beside_gap[far.replaced_by[beside_gap] == near.number]
        if len(cut):
            x, y = far.whole.centroids[cut[0]]
            problems.append(f"near, entry {near.number}: the outline of its mesh cuts {len(cut)} far elements "
                            f"(numbered from 0: {list_first(cut)}; the first around column {x:.0f}, row {y:.0f}); "
                            "align the near mesh with edges of far elements")
    if problems:
        raise InputError(problems)


def _find_cut_cells(far: _FarSide, near: _NearSide) -> IntArray:
    """Kept far cells that hold points of a near edge which should touch nothing; numbers in the whole far mesh."""
    ends = near.mesh.nodes[near.free_edges]
    midpoints = ends.mean(axis=1)
    points = np.concatenate([midpoints, ends.reshape(-1, 2)])
    found = np.unique(find_cells_with_points(far.rest, points, far.tolerance))
    return far.kept_cells[found]


def _cells_beside_gap(contact: _Contact) -> IntArray:
    """Far cells at edges between a kept and a replaced cell that no near edge covers; sorted numbers."""
    far = contact.far
    facets = find_facets(far.whole)
    uncovered_edges = far.edges[contact.far_cover < 1.0 - COVERED]
    uncovered = _inner_facets_among(facets, far.node_ids[uncovered_edges])
    is_at_gap = np.isin(facets.side_facets, uncovered)
    return np.asarray(np.unique(facets.side_cells[is_at_gap]))


def _inner_facets_among(facets: Facets, edges: IntArray) -> IntArray:
    """Facets of several cells that are among edges given by their nodes, (n, 2)."""
    inner = np.flatnonzero(facets.n_cells > 1)
    nodes = facets.nodes[:, :2]
    # One number for each pair of nodes, whatever their order.
    factors = np.array([int(nodes.max()) + 1, 1])
    numbers = np.sort(nodes[inner], axis=1) @ factors
    wanted = np.sort(edges, axis=1) @ factors
    return np.asarray(inner[np.isin(numbers, wanted)], dtype=np.int64)


def _covered_in_part(cover: Array) -> BoolArray:
    """Whether an edge is covered neither not at all nor once, (n_edges,)."""
    is_covered = cover > COVERED
    is_whole = np.abs(cover - 1.0) <= COVERED
    return np.asarray(is_covered & ~is_whole)


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

    cameras: IntArray
    boundary: IntArray
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
    contact = _find_contact(far, near)
    _check_contact(contact)
    numbering = _number_nodes(contact)
    rest = contact.far.rest
    mesh = _put_together([rest, *(side.mesh for side in contact.near)], numbering)
    camera_of_mesh = [0, *(side.number for side in contact.near)]
    n_cells = [rest.n_cells, *(side.mesh.n_cells for side in contact.near)]
    cameras = np.repeat(np.asarray(camera_of_mesh, dtype=np.int64), n_cells)
    return mesh, Tying(cameras, _find_boundary(contact, numbering), _weigh_nodes(contact, numbering))


@dataclass(frozen=True)
class _Numbering:
    """Numbers of nodes in the mesh of all: far ones, then free near ones, then slaves; by mesh, the far one first."""

    of_mesh: list[IntArray]
    n_unknown: int
    n_nodes: int


def _number_nodes(contact: _Contact) -> _Numbering:
    n_far = contact.far.rest.n_nodes
    of_mesh = [np.arange(n_far)]
    next_free = n_far
    next_slave = n_unknown = n_far + sum(near.mesh.n_nodes - len(near.mortar.slaves) for near in contact.near)
    for near in contact.near:
        slaves = near.mortar.slaves
        free = np.setdiff1d(np.arange(near.mesh.n_nodes), slaves)
        numbers = np.empty(near.mesh.n_nodes, dtype=np.int64)
        numbers[free] = next_free + np.arange(len(free))
        numbers[slaves] = next_slave + np.arange(len(slaves))
        of_mesh.append(numbers)
        next_free += len(free)
        next_slave += len(slaves)
    return _Numbering(of_mesh, n_unknown, n_nodes=next_slave)


def _put_together(meshes: Sequence[Mesh], numbering: _Numbering) -> Mesh:
    """One mesh of all cells, those of the first mesh first."""
    first = meshes[0]
    nodes = np.empty((numbering.n_nodes, first.dim))
    connectivity = []
    named_nodes: dict[str, list[IntArray]] = {}
    for mesh, numbers in zip(meshes, numbering.of_mesh, strict=True):
        nodes[numbers] = mesh.nodes
        connectivity.append(numbers[mesh.connectivity])
        for name, members in mesh.node_sets.items():
            named_nodes.setdefault(name, []).append(numbers[members])
    offsets = find_offsets(np.concatenate([np.diff(mesh.offsets) for mesh in meshes]))
    types = np.concatenate([mesh.types for mesh in meshes])
    node_sets = {name: np.unique(np.concatenate(members)) for name, members in sorted(named_nodes.items())}
    return Mesh(nodes, np.concatenate(connectivity), offsets, types, node_sets, first.mapping)


def _find_boundary(contact: _Contact, numbering: _Numbering) -> IntArray:
    """Sorted nodes on edges that touch no other mesh."""
    far_numbers, *near_numbers = numbering.of_mesh
    free_far_edges = contact.far.edges[contact.far_cover < COVERED]
    nodes = [far_numbers[free_far_edges].ravel()]
    for near, numbers in zip(contact.near, near_numbers, strict=True):
        nodes.append(numbers[near.free_edges].ravel())
    return np.asarray(np.unique(np.concatenate(nodes)))


def _weigh_nodes(contact: _Contact, numbering: _Numbering) -> sparse.csr_matrix:
    """Displacement of all nodes from that of the unknown ones."""
    n_free_near = numbering.n_unknown - contact.far.rest.n_nodes
    blocks = [sparse.identity(numbering.n_unknown, format="csr")]
    for near in contact.near:
        of_far_nodes = near.mortar.weights
        of_free_near_nodes = sparse.csr_matrix((len(near.mortar.slaves), n_free_near))
        blocks.append(sparse.hstack([of_far_nodes, of_free_near_nodes]).tocsr())
    return sparse.vstack(blocks).tocsr()
