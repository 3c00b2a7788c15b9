"""A near field's own mesh in place of the far elements under it, tied to those around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError, first_of
from ddic.mesh.mesh import Mesh
from ddic.mesh.mortar import Mortar, Overlaps, Sides, find_overlaps, integrate_mortar
from ddic.mesh.point_in_mesh import find_cells_with_points, lie_inside_outline
from ddic.mesh.topology import find_boundary_facets, find_facets

TOLERANCE = 1e-6
"""Distance below which points are one, as a share of the far mesh's larger side."""

COVERED = 1e-3
"""Share of an edge that may be missing from what runs along it."""


@dataclass(frozen=True)
class Tying:
    """What the cells of several meshes, put into one, have to do with each other.

    cameras: (n_cells,) the near camera whose own mesh a cell is of, 0 for the far mesh; boundary: sorted nodes on edges
    of one cell that touch no other mesh. weights: (n_nodes, n_unknown_nodes), displacement of each node from that of
    the unknown ones, which come first: far nodes, then free near nodes; the last nodes are near ones tied to far ones.
    """

    cameras: NDArray[np.int64]
    boundary: NDArray[np.int64]
    weights: sparse.csr_matrix

    @property
    def n_unknown_nodes(self) -> int:
        """Number of nodes whose displacement is unknown."""
        return int(self.weights.shape[1])


@dataclass(frozen=True)
class _Piece:
    """A near mesh beside what is left of the far one: edges of both and where they touch."""

    mesh: Mesh
    edges: NDArray[np.int64]
    overlaps: Overlaps
    mortar: Mortar
    touching: NDArray[np.bool_]


def tied_mesh(far: Mesh, near: Mapping[int, Mesh]) -> tuple[Mesh, Tying]:
    """Put near meshes, by number of their cameras, in place of the far cells whose centres they cover.

    Node sets of one name are joined. Raises InputError where a near mesh cuts far cells, touches another near mesh or
    touches no far cell.
    """
    tolerance = TOLERANCE * float(np.ptp(far.nodes, axis=0).max())
    replaced = _replaced(far, near)
    rest, _ = far.submesh(np.flatnonzero(replaced == 0))
    edges = find_boundary_facets(rest)[:, :2]
    pieces = {k: _piece(k, rest, edges, mesh, tolerance) for k, mesh in near.items()}
    cover = np.sum([p.overlaps.far_cover(len(edges)) for p in pieces.values()], axis=0)
    _refuse_cut_cells(far, rest, edges, cover, replaced, pieces, tolerance)
    _refuse_ends_apart(rest, edges, cover, pieces)
    return _joined(rest, edges, cover, pieces)


def _replaced(far: Mesh, near: Mapping[int, Mesh]) -> NDArray[np.int64]:
    """Number of the near camera whose mesh takes the place of each far cell, (n_cells,), 0 for none."""
    replaced = np.zeros(far.n_cells, dtype=np.int64)
    for number, mesh in near.items():
        inside = lie_inside_outline(far.centroids, mesh)
        if (replaced[inside] > 0).any():
            raise InputError(f"near, entry {number}: its mesh overlaps that of entry "
                             f"{int(replaced[inside].max())}; let them cover different far elements")
        replaced[inside] = number
    _refuse_neighbours(far, replaced)
    if (replaced > 0).all():
        raise InputError("near.mesh: the near fields' meshes cover every far element, which leaves none to the "
                         "far-field images; use smaller ones, or measure with the near-field images alone")
    return replaced


def _refuse_neighbours(far: Mesh, replaced: NDArray[np.int64]) -> None:
    """Raise InputError where two near meshes would have a boundary in common."""
    found = find_facets(far)
    sides = replaced[found.side_cells]
    low = np.full(len(found.nodes), np.iinfo(np.int64).max)
    high = np.zeros(len(found.nodes), dtype=np.int64)
    np.minimum.at(low, found.side_facets, sides)
    np.maximum.at(high, found.side_facets, sides)
    for facet in np.flatnonzero((low > 0) & (low < high))[:1]:
        raise InputError(f"near, entry {high[facet]}: its mesh touches that of entry {low[facet]}; leave one far "
                         "element at least between them")


def _piece(number: int, rest: Mesh, edges: NDArray[np.int64], mesh: Mesh, tolerance: float) -> _Piece:
    own = find_boundary_facets(mesh)[:, :2]
    sides = Sides(rest.nodes, edges, mesh.nodes, own, tolerance)
    pieces = find_overlaps(sides)
    if len(pieces.near) == 0:
        raise InputError(f"near, entry {number}: its mesh has no boundary in common with the far elements around it; "
                         "align its outline with edges of far elements")
    return _Piece(mesh, own, pieces, integrate_mortar(sides, pieces), pieces.near_cover(len(own)) > COVERED)


def _refuse_cut_cells(far: Mesh, rest: Mesh, edges: NDArray[np.int64], cover: NDArray[np.float64],
                      replaced: NDArray[np.int64], pieces: Mapping[int, _Piece], tolerance: float) -> None:
    """Raise InputError, with the far cells' numbers, where a near mesh's outline does not follow far edges."""
    kept = np.flatnonzero(replaced == 0)
    problems = []
    found = find_facets(far)
    _, numbers = far.submesh(kept)
    uncovered = _uncovered_inner_facets(found.nodes[:, :2], found.n_cells, numbers[edges[cover < 1.0 - COVERED]])
    on_uncovered = np.isin(found.side_facets, uncovered)
    beside = np.unique(found.side_cells[on_uncovered])
    neighbours = replaced[beside[replaced[beside] > 0]]
    for number, piece in pieces.items():
        ends = piece.mesh.nodes[piece.edges[~piece.touching]]
        points = np.concatenate([ends.mean(axis=1), ends.reshape(-1, 2)])
        cells = kept[np.unique(find_cells_with_points(rest, points, tolerance))]
        if not len(cells) and (neighbours == number).any():
            cells = beside[replaced[beside] == number]
        if len(cells):
            x, y = far.centroids[cells[0]]
            problems.append(f"near, entry {number}: the outline of its mesh cuts {len(cells)} far elements (numbered "
                            f"from 0: {first_of(cells)}; the first around column {x:.0f}, row {y:.0f}); align the near "
                            "mesh with edges of far elements")
    if problems:
        raise InputError(problems)


def _uncovered_inner_facets(nodes: NDArray[np.int64], n_cells: NDArray[np.int64],
                            edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Facets of several cells among edges given by their nodes, (n, 2)."""
    inner = np.flatnonzero(n_cells > 1)
    n = int(nodes.max()) + 1
    key = np.sort(nodes[inner], axis=1) @ np.array([n, 1])
    wanted = np.sort(edges, axis=1) @ np.array([n, 1])
    return np.asarray(inner[np.isin(key, wanted)], dtype=np.int64)


def _refuse_ends_apart(rest: Mesh, edges: NDArray[np.int64], cover: NDArray[np.float64],
                       pieces: Mapping[int, _Piece]) -> None:
    """Raise InputError where an edge touches the other side only in part, or twice."""
    partly = (cover > COVERED) & (np.abs(cover - 1.0) > COVERED)
    if partly.any():
        x, y = rest.nodes[edges[partly]].mean(axis=1)[0]
        raise InputError(f"near.mesh: the edge of a far element around column {x:.0f}, row {y:.0f} touches a near mesh "
                         "in part only; let the common boundary end at nodes of both meshes")
    for number, piece in pieces.items():
        near_cover = piece.overlaps.near_cover(len(piece.edges))
        partly = (near_cover > COVERED) & (np.abs(near_cover - 1.0) > COVERED)
        if partly.any():
            x, y = piece.mesh.nodes[piece.edges[partly]].mean(axis=1)[0]
            raise InputError(f"near, entry {number}: an edge of its mesh around column {x:.1f}, row {y:.1f} touches "
                             "far elements in part only; let the common boundary end at nodes of both meshes")


def _joined(rest: Mesh, edges: NDArray[np.int64], cover: NDArray[np.float64],
            pieces: Mapping[int, _Piece]) -> tuple[Mesh, Tying]:
    """One mesh of all, far nodes first, then free near nodes, then slaves."""
    n_free = rest.n_nodes + sum(p.mesh.n_nodes - len(p.mortar.slaves) for p in pieces.values())
    first_free, first_slave = rest.n_nodes, n_free
    numbers = {0: np.arange(rest.n_nodes)}
    rows = [sparse.identity(n_free, format="csr")]
    for k, piece in pieces.items():
        slaves = piece.mortar.slaves
        free = np.setdiff1d(np.arange(piece.mesh.n_nodes), slaves)
        place = np.empty(piece.mesh.n_nodes, dtype=np.int64)
        place[free] = first_free + np.arange(len(free))
        place[slaves] = first_slave + np.arange(len(slaves))
        numbers[k] = place
        first_free, first_slave = first_free + len(free), first_slave + len(slaves)
        rows.append(sparse.hstack([piece.mortar.weights,
                                   sparse.csr_matrix((len(slaves), n_free - rest.n_nodes))]).tocsr())
    meshes = {0: rest} | {k: p.mesh for k, p in pieces.items()}
    nodes = np.empty((first_slave, rest.dim))
    for k, mesh in meshes.items():
        nodes[numbers[k]] = mesh.nodes
    outer = [numbers[0][edges[cover < COVERED]].ravel(),
             *(numbers[k][p.edges[~p.touching]].ravel() for k, p in pieces.items())]
    names = sorted({name for mesh in meshes.values() for name in mesh.node_sets})
    sets = {name: np.unique(np.concatenate([numbers[k][mesh.node_sets[name]] for k, mesh in meshes.items()
                                            if name in mesh.node_sets])) for name in names}
    counts = np.concatenate([np.diff(mesh.offsets) for mesh in meshes.values()])
    whole = Mesh(nodes, np.concatenate([numbers[k][mesh.connectivity] for k, mesh in meshes.items()]),
                 np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
                 np.concatenate([mesh.types for mesh in meshes.values()]), sets, rest.mapping)
    cameras = np.concatenate([np.full(mesh.n_cells, k, dtype=np.int64) for k, mesh in meshes.items()])
    return whole, Tying(cameras, np.unique(np.concatenate(outer)), sparse.vstack(rows).tocsr())
