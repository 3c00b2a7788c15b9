"""Facets, boundary and adjacency of cells."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.mesh import build_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import (
    find_adjacent_cells,
    find_boundary_facets,
    find_boundary_nodes,
    find_distinct_rows,
    find_facets,
    find_named_nodes,
    find_not_controlled_nodes,
)

Cell = Literal["Q4", "T3"]

# Two quads and a triangle in a row: 0-1-2 below, 5-4-3 above, 6 at the tip.
MIXED = build_mesh(
    np.array([[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1], [3, 0.5]], dtype=float),
    {Q4: np.array([[0, 1, 4, 5], [1, 2, 3, 4]]), T3: np.array([[2, 6, 3]])},
    {"tip": np.array([2, 3, 6]), "none": np.zeros(0, np.int64)},
)


def test_facets_of_mixed_mesh_are_shared_once() -> None:
    found = find_facets(MIXED)
    assert len(found.nodes) == 4 + 4 + 3 - 2
    shared = {tuple(sorted(nodes)) for nodes in found.nodes[found.n_cells == 2].tolist()}
    assert shared == {(1, 4), (2, 3)}
    assert len(found.side_facets) == 11


def test_facet_numbers_name_the_nodes_of_their_sides() -> None:
    found = find_facets(MIXED)
    for facet, cell in zip(found.side_facets, found.side_cells, strict=True):
        assert set(found.nodes[facet]) <= set(MIXED.cells[cell])


def test_boundary_of_mixed_mesh() -> None:
    outer = {tuple(sorted(nodes)) for nodes in find_boundary_facets(MIXED).tolist()}
    assert outer == {(0, 1), (1, 2), (3, 4), (4, 5), (0, 5), (2, 6), (3, 6)}
    assert find_boundary_nodes(MIXED).tolist() == list(range(7))


def test_unknown_and_empty_sets_are_refused() -> None:
    with pytest.raises(InputError, match='did you mean "tip"'):
        find_named_nodes(MIXED, "tipp")
    with pytest.raises(InputError, match="holds no node"):
        find_named_nodes(MIXED, "none")


def test_adjacency_of_mixed_mesh() -> None:
    indptr, indices = find_adjacent_cells(MIXED)
    assert indptr.tolist() == [0, 1, 3, 4]
    assert indices.tolist() == [1, 0, 2, 1]


def test_three_cells_on_one_facet_are_all_neighbours() -> None:
    nodes = np.array([[0, 0], [0, 1], [1, 0.5], [-1, 0.5], [2, 0.5]], dtype=float)
    mesh = build_mesh(nodes, {T3: np.array([[0, 2, 1], [0, 1, 3], [0, 4, 1]])})
    indptr, indices = find_adjacent_cells(mesh)
    assert indptr.tolist() == [0, 2, 4, 6]
    assert indices.tolist() == [1, 2, 0, 2, 0, 1]


@settings(max_examples=25)
@given(nx=st.integers(1, 9), ny=st.integers(1, 9), cell=st.sampled_from(["Q4", "T3"]))
def test_adjacency_is_symmetric_and_complete(nx: int, ny: int, cell: Cell) -> None:
    mesh = build_structured_mesh((0, 0, 8.0 * nx, 8.0 * ny), 8.0, cell)
    indptr, indices = find_adjacent_cells(mesh)
    rows = np.repeat(np.arange(mesh.n_cells), np.diff(indptr))
    pairs = set(zip(rows.tolist(), indices.tolist(), strict=True))
    assert len(pairs) == len(indices)
    assert {(b, a) for a, b in pairs} == pairs
    interior = nx * (ny - 1) + ny * (nx - 1) + (nx * ny if cell == "T3" else 0)
    assert len(pairs) == 2 * interior
    for a, b in pairs:
        assert len(set(mesh.cells[a]) & set(mesh.cells[b]) - {-1}) == 2


def test_boundary_nodes_of_a_grid_are_on_its_sides() -> None:
    mesh = build_structured_mesh((3, 4, 43, 54), 10)
    on_side = np.isin(mesh.nodes[:, 0], (3, 43)) | np.isin(mesh.nodes[:, 1], (4, 54))
    assert find_boundary_nodes(mesh).tolist() == np.flatnonzero(on_side).tolist()


def test_not_controlled_nodes_come_from_names_boundary_and_boxes() -> None:
    mesh = build_structured_mesh((0, 0, 40, 40), 10)
    assert find_not_controlled_nodes(mesh, ["top"], [(-1, 39, 11, 41)]).tolist() == [0, 1, 2, 3, 4, 20, 21]
    assert find_not_controlled_nodes(mesh, ["boundary"], []).tolist() == find_boundary_nodes(mesh).tolist()
    assert find_not_controlled_nodes(mesh, [], []).tolist() == []


def test_all_bad_names_and_boxes_are_reported_together() -> None:
    mesh = build_structured_mesh((0, 0, 40, 40), 10)
    with pytest.raises(InputError) as caught:
        find_not_controlled_nodes(mesh, ["tops", "zzz"], [(1, 1, 2, 2)])
    assert len(caught.value.problems) == 3
    assert 'regularization.not_controlled: no node set is named "tops"; did you mean "top"?' in str(caught.value)
    assert "regularization.boxes" in caught.value.problems[2]


@pytest.mark.parametrize("n_nodes", [5, 300, 70_000, 5_000_000])
@pytest.mark.parametrize("width", [2, 4])
def test_facets_are_numbered_in_the_order_of_their_nodes(n_nodes: int, width: int) -> None:
    rng = np.random.default_rng(width)
    rows = rng.integers(-1, n_nodes, (400, width))
    rows = np.concatenate([rows, rows[rng.permutation(400)[:150]]])
    first, numbers = find_distinct_rows(rows, n_nodes)
    _, expected_first, expected_numbers = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(first, expected_first)
    np.testing.assert_array_equal(numbers, expected_numbers.reshape(-1))
