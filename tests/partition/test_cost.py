"""What a cell costs."""

from __future__ import annotations

import numpy as np

from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import build_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.split import NODE_PIXELS, estimate_cell_costs, split_by_metis
from support.random_meshes import grid_mesh


def test_squares_cost_their_pixels_and_one_node_and_triangles_half() -> None:
    q4 = grid_mesh(4, 3, (10.0, 8.0))
    np.testing.assert_array_equal(estimate_cell_costs(q4), 80.0 + NODE_PIXELS)
    t3 = grid_mesh(4, 3, (10.0, 8.0), cells="T3")
    # Two triangles share the pixels and the node of a square.
    assert estimate_cell_costs(t3).sum() == estimate_cell_costs(q4).sum()
    assert (estimate_cell_costs(t3) >= NODE_PIXELS / 2).all()


def test_subdomain_costs_add_up() -> None:
    costs = np.array([1.0, 2.0, 4.0, 8.0])
    assert np.bincount([1, 0, 1, 2], weights=costs).tolist() == [2.0, 5.0, 8.0]


def test_metis_balances_nodes_where_cells_are_small_and_pixels_where_they_are_large() -> None:
    fine, coarse = build_structured_mesh((0, 0, 256, 256), 4), build_structured_mesh((256, 0, 1280, 256), 32)
    # Two pieces that no cell joins: METIS takes them as they are.
    nodes = np.concatenate([fine.nodes, coarse.nodes])
    cells = np.concatenate([fine.connectivity.reshape(-1, 4), coarse.connectivity.reshape(-1, 4) + fine.n_nodes])
    mesh = build_mesh(nodes, {Q4: cells})
    costs = estimate_cell_costs(mesh)
    loads = np.bincount(split_by_metis(mesh, 8, costs), weights=costs)
    assert loads.max() <= 1.1 * loads.mean()
    by_pixels = np.full(mesh.n_cells, 16.0)
    by_pixels[fine.n_cells:] = 1024.0
    loads = np.bincount(split_by_metis(mesh, 8, by_pixels), weights=costs)
    # By pixels alone one subdomain would hold four fifths of the nodes.
    assert loads.max() > 2 * loads.mean()


def test_weights_of_any_scale_give_the_same_partition() -> None:
    mesh = build_structured_mesh((0, 0, 300, 200), 10)
    costs = np.random.default_rng(0).uniform(0.5, 2.0, mesh.n_cells)
    expected = split_by_metis(mesh, 7, costs)
    for scale in (1e-6, 1e9):
        np.testing.assert_array_equal(split_by_metis(mesh, 7, scale * costs), expected)
