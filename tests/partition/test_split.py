"""Splitting the cells of a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.split import renumber, split_by_blocks, split_by_metis
from support.random_meshes import Cells, grid_mesh, grid_meshes


@pytest.mark.parametrize("n", [2, 3, 8, 9, 16, 45])
@pytest.mark.parametrize("weighted", [False, True])
def test_metis_balances_the_weights(n: int, weighted: bool) -> None:
    mesh = build_structured_mesh((0, 0, 600, 400), 8, circles=[((300, 200), 60)])
    weights = np.random.default_rng(0).integers(1, 60, mesh.n_cells) if weighted else None
    parts = split_by_metis(mesh, n, weights)
    assert parts.shape == (mesh.n_cells,)
    loads = np.bincount(parts, weights=weights, minlength=n)
    assert len(loads) == n
    assert loads.min() > 0
    assert loads.max() <= 1.1 * loads.mean()


def test_metis_gives_the_same_answer_again() -> None:
    mesh = build_structured_mesh((0, 0, 300, 300), 10)
    np.testing.assert_array_equal(split_by_metis(mesh, 12), split_by_metis(mesh, 12))


def test_weight_zero_is_no_error() -> None:
    mesh = grid_mesh(6, 6, (4.0, 4.0))
    assert np.unique(split_by_metis(mesh, 3, np.zeros(36, dtype=np.int64))).tolist() == [0, 1, 2]


def test_one_subdomain_is_the_whole_mesh() -> None:
    mesh = grid_mesh(3, 2, (4.0, 4.0))
    assert split_by_metis(mesh, 1).tolist() == [0] * 6


def test_metis_refuses_more_subdomains_than_cells() -> None:
    with pytest.raises(InputError, match=r"mesh: 6 cells for 7 subdomains.*start fewer ranks"):
        split_by_metis(grid_mesh(3, 2, (4.0, 4.0)), 7)


@settings(max_examples=40)
@given(mesh=grid_meshes(), data=st.data())
def test_metis_numbers_every_subdomain(mesh: Mesh, data: st.DataObject) -> None:
    n = data.draw(st.integers(1, mesh.n_cells))
    assert np.unique(split_by_metis(mesh, n)).tolist() == list(range(n))


@pytest.mark.parametrize("n", [23, 30, 36])
def test_few_cells_for_each_subdomain_leave_none_empty(n: int) -> None:
    """METIS alone gives cells to 13, 16 and 16 of them."""
    counts = np.bincount(split_by_metis(grid_mesh(6, 6, (10.0, 10.0)), n), minlength=n)
    assert counts.min() == 1
    assert counts.max() <= 4


@pytest.mark.parametrize("cells", ["Q4", "T3"])
def test_blocks_are_rectangles_row_by_row(cells: Cells) -> None:
    mesh = grid_mesh(6, 4, (5.0, 5.0), origin=(3.0, 7.0), cells=cells, seed=1)
    parts = split_by_blocks(mesh, (3, 2))
    x, y = (mesh.centroids - [3.0, 7.0]).T
    assert parts.tolist() == (x // 10 + 3 * (y // 10)).astype(int).tolist()
    assert (np.bincount(parts) == mesh.n_cells / 6).all()


def test_blocks_without_cells_are_dropped() -> None:
    mesh = grid_mesh(5, 5, (4.0, 4.0))
    ring = mesh.create_submesh(np.array([e for e in range(25) if e != 12]))[0]
    parts = split_by_blocks(ring, (5, 5))
    assert np.bincount(parts).tolist() == [1] * 24
    assert parts.tolist() == list(range(24))
    # More blocks than cells along a side.
    assert np.unique(split_by_blocks(grid_mesh(2, 2, (4.0, 4.0)), (7, 1))).tolist() == [0, 1]


def test_renumbering_closes_gaps_and_keeps_the_order() -> None:
    assert renumber(np.array([7, 2, 7, 5])).tolist() == [2, 0, 2, 1]
