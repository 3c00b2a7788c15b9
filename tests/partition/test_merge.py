"""Blank subdomains join textured neighbours."""

from __future__ import annotations

import numpy as np
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_adjacent_cells
from ddic.partition.split import find_connected_pieces, merge_blank, split_by_blocks
from support.random_meshes import PARTITIONS, SEEDS, delaunay_meshes, grid_mesh, grid_meshes, random_partition

MESHES = st.one_of(grid_meshes(), delaunay_meshes())


def _n_pieces(mesh: Mesh, cells: NDArray[np.bool_]) -> int:
    """Number of connected pieces that some cells form, by the facets that they share."""
    indptr, indices = find_adjacent_cells(mesh)
    graph = sparse.csr_matrix((np.ones(len(indices)), indices, indptr), shape=(mesh.n_cells, mesh.n_cells))
    return int(csgraph.connected_components(graph[cells][:, cells], directed=False)[0])


def _merge(mesh: Mesh, parts: NDArray[np.int64], blank: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Every subdomain taken as one piece."""
    return merge_blank(parts, np.arange(len(blank)), find_adjacent_cells(mesh), blank)


def _within_reach(mesh: Mesh, parts: NDArray[np.int64], blank: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Subdomains with texture, and blank ones that a walk over blank ones leads to some, one step at a time."""
    indptr, indices = find_adjacent_cells(mesh)
    steps = set(zip(np.repeat(parts, np.diff(indptr)).tolist(), parts[indices].tolist(), strict=True))
    found = set(np.flatnonzero(~blank).tolist())
    while True:
        more = {a for a, b in steps if b in found} - found
        if not more:
            return np.isin(np.arange(len(blank)), list(found))
        found |= more


@settings(max_examples=150)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 9), seed=SEEDS, data=st.data())
def test_merging(mesh: Mesh, kind: str, n: int, seed: int, data: st.DataObject) -> None:
    try:
        parts = random_partition(mesh, kind, n, seed)
    except InputError:
        reject()  # METIS may leave a subdomain empty where there are few cells for each.
    n_before = int(parts.max()) + 1
    blank = np.array(data.draw(st.lists(st.booleans(), min_size=n_before, max_size=n_before)))
    merged = _merge(mesh, parts, blank)
    # Numbered without gaps; every old subdomain goes somewhere as a whole.
    assert np.unique(merged).tolist() == list(range(int(merged.max()) + 1))
    target = np.array([np.unique(merged[parts == s]).item() for s in range(n_before)])
    # Subdomains with texture stay apart and keep their order.
    assert (np.diff(target[~blank]) > 0).all()
    # What can reach texture is with exactly one that holds it; what cannot stays alone.
    reach = _within_reach(mesh, parts, blank)
    for s in range(n_before):
        mates = np.flatnonzero(target == target[s])
        assert (~blank[mates]).sum() == reach[s]
        assert reach[s] or mates.tolist() == [s]
    # A subdomain in one piece gains no other.
    for t in range(len(np.unique(merged))):
        pieces = [_n_pieces(mesh, parts == s) for s in np.flatnonzero(target == t)]
        assert _n_pieces(mesh, merged == t) <= 1 + sum(p - 1 for p in pieces)


def test_the_most_facets_win_then_the_lowest_number() -> None:
    mesh = grid_mesh(3, 3, (5.0, 5.0))
    blank = np.array([False, True, False])
    # 1 shares two facets with 0 and two with 2.
    parts = np.array([0, 0, 2, 1, 1, 2, 1, 1, 2])
    assert _merge(mesh, parts, blank).tolist() == [0, 0, 1, 0, 0, 1, 0, 0, 1]
    # One and three.
    parts = np.array([0, 2, 2, 1, 1, 2, 1, 1, 2])
    assert _merge(mesh, parts, blank).tolist() == [0, 1, 1, 1, 1, 1, 1, 1, 1]


def test_a_group_counts_its_facets_together() -> None:
    mesh = grid_mesh(4, 2, (5.0, 5.0))
    # Of the blank ones, 2 shares two facets with 0 and one with 1, and 3 two with 1.
    parts = np.array([0, 2, 1, 1, 0, 2, 3, 1])
    merged = _merge(mesh, parts, np.array([False, False, True, True]))
    assert merged.tolist() == [0, 1, 1, 1, 0, 1, 1, 1]


def test_a_blank_quarter_is_one_subdomain_with_a_neighbour() -> None:
    mesh = grid_mesh(8, 8, (5.0, 5.0))
    parts = split_by_blocks(mesh, (4, 4))
    blank = np.isin(np.arange(16), [10, 11, 14, 15])
    merged = _merge(mesh, parts, blank)
    assert np.bincount(merged).tolist() == [4, 4, 4, 4, 4, 4, 4 + 16, 4, 4, 4, 4, 4]
    assert set(merged[np.isin(parts, [6, 10, 11, 14, 15])]) == {6}


def test_nothing_changes_where_all_or_none_are_blank() -> None:
    mesh = grid_mesh(4, 4, (5.0, 5.0))
    parts = split_by_blocks(mesh, (2, 2))
    for flag in (True, False):
        assert _merge(mesh, parts, np.full(4, flag)).tolist() == parts.tolist()


def test_a_loose_piece_goes_alone() -> None:
    mesh = grid_mesh(4, 4, (5.0, 5.0))
    # Subdomain 1 has a piece that hangs on it by a node; only that piece is blank.
    parts = np.array([[0, 0, 0, 0], [0, 0, 0, 1], [2, 2, 1, 3], [2, 2, 1, 3]])
    pieces = np.array([[0, 0, 0, 0], [0, 0, 0, 1], [3, 3, 2, 4], [3, 3, 2, 4]])
    merged = merge_blank(pieces.ravel(), np.array([0, 1, 1, 2, 3]), find_adjacent_cells(mesh), np.arange(5) == 2)
    # Two facets each with 2 and 3: the lower one takes it.
    assert merged.reshape(4, 4).tolist() == [[0, 0, 0, 0], [0, 0, 0, 1], [2, 2, 2, 3], [2, 2, 2, 3]]
    labels = find_connected_pieces(find_adjacent_cells(mesh.create_submesh(np.flatnonzero(parts.ravel() == 1))[0]))
    assert labels.tolist() == [0, 1, 1]
