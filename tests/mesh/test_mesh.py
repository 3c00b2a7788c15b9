"""The mesh's arrays: cells, restriction, mapping."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.mesh import Mesh, Similarity, build_mesh
from support.random_meshes import SEEDS, grid_mesh, grid_meshes

NODES = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 2.0], [2.0, 2.0], [4.0, 2.0]])


def small_mesh() -> Mesh:
    blocks = {Q4: np.array([[0, 1, 4, 3]]), T3: np.array([[1, 2, 5], [1, 5, 4]])}
    return build_mesh(NODES, blocks, {"left": np.array([0, 3]), "right": np.array([2, 5])})


def test_sizes_and_padded_cells() -> None:
    mesh = small_mesh()
    assert (mesh.dim, mesh.n_nodes, mesh.n_cells, mesh.n_dofs) == (2, 6, 3, 12)
    assert mesh.types.tolist() == [Q4.vtk, T3.vtk, T3.vtk]
    assert mesh.offsets.tolist() == [0, 4, 7, 10]
    assert mesh.cells.tolist() == [[0, 1, 4, 3], [1, 2, 5, -1], [1, 5, 4, -1]]


def test_centroids_are_means_of_the_nodes() -> None:
    # Thirds are rounded once or twice.
    np.testing.assert_allclose(small_mesh().centroids, [[1, 1], [10 / 3, 2 / 3], [8 / 3, 4 / 3]], rtol=1e-15)


def test_cells_among_nodes_have_all_of_theirs_there() -> None:
    is_among = np.ones(6, dtype=bool)
    assert small_mesh().find_cells_among(is_among).tolist() == [0, 1, 2]
    is_among[4] = False
    assert small_mesh().find_cells_among(is_among).tolist() == [1]
    assert small_mesh().find_cells_among(~is_among).tolist() == []


def test_restriction_renumbers_nodes_and_sets() -> None:
    part, node_ids = small_mesh().create_submesh(np.array([2, 1]))
    assert node_ids.tolist() == [1, 2, 4, 5]
    assert part.cells.tolist() == [[0, 3, 2], [0, 1, 3]]
    assert part.nodes.tolist() == NODES[[1, 2, 4, 5]].tolist()
    assert part.node_sets["left"].tolist() == []
    assert part.node_sets["right"].tolist() == [1, 3]


@settings(max_examples=40)
@given(mesh=grid_meshes(), seed=SEEDS, share=st.floats(0.1, 1.0))
def test_restriction_keeps_the_cells_where_they_are(mesh: Mesh, seed: int, share: float) -> None:
    kept = np.flatnonzero(np.random.default_rng(seed).random(mesh.n_cells) < share)
    kept = kept if len(kept) else np.array([0])
    part, node_ids = mesh.create_submesh(kept)
    assert (np.diff(node_ids) > 0).all()
    assert np.unique(part.connectivity).tolist() == list(range(part.n_nodes))
    np.testing.assert_array_equal(part.types, mesh.types[kept])
    for e, whole in enumerate(kept):
        own = part.connectivity[part.offsets[e]: part.offsets[e + 1]]
        assert node_ids[own].tolist() == mesh.connectivity[mesh.offsets[whole]: mesh.offsets[whole + 1]].tolist()


@given(scale=st.floats(0.1, 50), angle=st.floats(-4, 4), y_up=st.booleans(), seed=SEEDS)
def test_mapping_of_points_and_of_displacements_agree(scale: float, angle: float, y_up: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mapping = Similarity(scale, angle, (300.0, -70.0), y_up)
    points, moves = rng.uniform(-10, 10, (8, 2)), rng.uniform(-1, 1, (8, 2))
    in_pixels = mapping.to_pixels(points + moves) - mapping.to_pixels(points)
    # Coordinates of up to a thousand pixels are rounded by 1e-13, then divided by the scale.
    np.testing.assert_allclose(mapping.map_vectors_to_mesh_units(in_pixels), moves, atol=1e-11)


def test_angle_turns_x_towards_y() -> None:
    np.testing.assert_allclose(Similarity(2.0, np.pi / 2, (10.0, 20.0)).to_pixels(np.array([[1.0, 0.0]])),
                               [[10.0, 22.0]], atol=1e-14)


def test_y_of_a_mesh_may_point_up() -> None:
    mapping = Similarity(2.0, 0.0, (10.0, 20.0), y_up=True)
    np.testing.assert_array_equal(mapping.to_pixels(np.array([[1.0, 3.0]])), [[12.0, 14.0]])
    np.testing.assert_array_equal(mapping.map_vectors_to_mesh_units(np.array([[4.0, 6.0]])), [[2.0, -3.0]])


def test_mesh_of_one_kind_has_no_padding() -> None:
    assert grid_mesh(2, 2, (1.0, 1.0), cells="T3").cells.shape == (8, 3)
