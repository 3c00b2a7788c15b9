"""Values at points of a mesh."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.mesh.cell_type import Q4
from ddic.mesh.interpolation import CellSearch, interpolate, interpolate_located, is_inside_outline, locate
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.structured import build_structured_mesh
from support.random_meshes import SEEDS, delaunay_meshes, grid_mesh, grid_meshes

MESHES = st.one_of(grid_meshes(), delaunay_meshes())


def points_in_cells(mesh: Mesh, n: int, seed: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cells at random, and a point in each: a mean of its corners."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, mesh.n_cells, n)
    padded = mesh.cells[cells]
    weights = rng.uniform(0.01, 1.0, padded.shape) * (padded >= 0)
    weights /= weights.sum(axis=1, keepdims=True)
    return cells, np.einsum("na,nac->nc", weights, mesh.nodes[padded])


@settings(max_examples=60)
@given(mesh=MESHES, seed=SEEDS)
def test_affine_fields_are_exact_everywhere(mesh: Mesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    slope, constant = rng.normal(size=(3, 2)), rng.normal(size=3)
    _, points = points_in_cells(mesh, 200, seed)
    found = interpolate(mesh, mesh.nodes @ slope.T + constant, points)
    # Rounding of coordinates of up to a hundred pixels, in cells a hundred times longer than they are thick.
    np.testing.assert_allclose(found, points @ slope.T + constant, atol=1e-9)


@settings(max_examples=60)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_local_coordinates_are_those_of_the_points(mesh: Mesh, seed: int) -> None:
    """Any field of the mesh, hence a bilinear one too, at points given by their places in the cells."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(mesh.n_nodes, 2))
    for block in mesh.cell_blocks:
        corners = rng.dirichlet(np.ones(block.type.n_nodes), len(block.cells))
        # Away from the edges, so that no other cell holds the point.
        local = 0.9 * corners @ block.type.nodes + 0.1 * block.type.centre
        shapes = block.type.evaluate_shapes(local)
        points = np.einsum("na,nac->nc", shapes, mesh.nodes[block.nodes])
        located = locate(mesh, points)
        assert located.cells.tolist() == block.cells.tolist()
        np.testing.assert_allclose(located.local, local, atol=1e-10)
        expected = np.einsum("na,nac->nc", shapes, values[block.nodes])
        np.testing.assert_allclose(interpolate(mesh, values, points), expected, atol=1e-9)


@settings(max_examples=40)
@given(mesh=MESHES, seed=SEEDS)
def test_cells_near_a_point_are_all_that_touch_its_surroundings(mesh: Mesh, seed: int) -> None:
    """At least those within two sides of the mean cell's square; everywhere, beside the mesh too."""
    search = CellSearch(mesh)
    low, high = mesh.outlines.find_boxes()
    reach = 2.0 * np.sqrt(np.ptp(mesh.nodes, axis=0).prod() / mesh.n_cells)
    rng = np.random.default_rng(seed)
    for point in rng.uniform(mesh.nodes.min(axis=0) - reach, mesh.nodes.max(axis=0) + reach, (10, 2)):
        touches = ((low <= point + reach) & (high >= point - reach)).all(axis=1)
        assert set(np.flatnonzero(touches)) <= set(search.list_near((point[0], point[1])))
    assert not len(search.list_near((1e6, -1e6)))


@pytest.mark.parametrize("corner", [(52.0, 47.0), (44.0, 43.0), (38.6, 36.6), (37.5, 36.9)])
def test_distorted_quadrilaterals(corner: tuple[float, float]) -> None:
    """The third corner approaches the diagonal, where det J = 0."""
    nodes = np.array([[20.2, 20.3], [53.1, 21.4], corner, [21.6, 52.3]])
    mesh = build_mesh(nodes, {Q4: np.arange(4)[None]})
    xi, eta = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)))
    local = np.stack([xi, eta], axis=1)
    points = Q4.evaluate_shapes(local) @ nodes
    located = locate(mesh, points)
    assert (located.cells == 0).all()
    # Where the map is singular the place is not unique, but the point that it stands for is.
    np.testing.assert_allclose(Q4.evaluate_shapes(located.local) @ nodes, points, atol=1e-8)


@settings(max_examples=60)
@given(mesh=MESHES, seed=SEEDS)
def test_nodes_and_points_on_edges_are_found(mesh: Mesh, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(mesh.n_nodes, 2))
    np.testing.assert_allclose(interpolate(mesh, values, mesh.nodes), values, atol=1e-7)
    share = np.random.default_rng(seed).random((len(mesh.connectivity), 1))
    for block in mesh.cell_blocks:
        for a, b in block.type.facets:
            one, other = block.nodes[:, a], block.nodes[:, b]
            s = share[:len(one)]
            found = interpolate(mesh, values, (1 - s) * mesh.nodes[one] + s * mesh.nodes[other])
            np.testing.assert_allclose(found, (1 - s) * values[one] + s * values[other], atol=1e-7)


@settings(max_examples=40)
@given(mesh=delaunay_meshes(), seed=SEEDS)
def test_nothing_outside_and_in_holes(mesh: Mesh, seed: int) -> None:
    """Cells that share only nodes, slits and single cells left out: where no outline encloses a point, no value."""
    low, high = mesh.nodes.min(axis=0) - 5, mesh.nodes.max(axis=0) + 5
    points = np.random.default_rng(seed).uniform(low, high, (500, 2))
    found = interpolate(mesh, mesh.nodes, points)
    held = ~np.isnan(found).any(axis=1)
    # A random point is not within 1e-6 px of an edge but once in a million.
    np.testing.assert_array_equal(held, is_inside_outline(points, mesh))
    np.testing.assert_allclose(found[held], points[held], atol=1e-9)


def test_a_hole_is_not_bridged() -> None:
    mesh = build_structured_mesh((0, 0, 400, 300), 16, circles=[((200.0, 150.0), 80.0)])
    points = np.array([[200.0, 150.0], [270.0, 150.0], [300.0, 150.0], [-1e-3, 150.0], [-1e-8, 150.0], [400.5, 150.0],
                       [np.nan, 150.0], [np.inf, 150.0], [-1e300, 150.0]])
    found = np.isfinite(interpolate(mesh, mesh.nodes, points)).all(axis=1)
    assert found.tolist() == [False, False, True, False, True, False, False, False, False]


def test_cells_of_a_crack_keep_their_sides() -> None:
    """Two cells side by side that share no node: values jump between them, and a point takes those of its own side."""
    nodes = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10], [10, 0], [20, 0], [20, 10], [10, 10]])
    mesh = build_mesh(nodes, {Q4: np.arange(8).reshape(2, 4)})
    values = np.repeat([[1.0], [2.0]], 4, axis=0)
    points = np.array([[9.9999, 5.0], [10.0001, 5.0]])
    np.testing.assert_allclose(interpolate(mesh, values, points), [[1.0], [2.0]])


def test_many_fields_at_the_same_points() -> None:
    mesh = grid_mesh(5, 4, (9.0, 7.0), cells="mixed", seed=1, jitter=0.2)
    _, points = points_in_cells(mesh, 50, 2)
    located = locate(mesh, points[:, ::-1][:, ::-1])
    for seed in range(3):
        values = np.random.default_rng(seed).normal(size=(mesh.n_nodes, 4))
        np.testing.assert_array_equal(interpolate_located(mesh, values, located), interpolate(mesh, values, points))


def test_no_points_and_no_cells() -> None:
    mesh = grid_mesh(2, 2, (5.0, 5.0))
    assert interpolate(mesh, mesh.nodes, np.zeros((0, 2))).shape == (0, 2)
    empty = build_mesh(mesh.nodes, {})
    assert locate(empty, np.zeros((3, 2))).cells.tolist() == [-1, -1, -1]
    assert np.isnan(interpolate(empty, mesh.nodes, np.zeros((3, 2)))).all()


def test_a_million_points_in_a_hundred_thousand_cells() -> None:
    mesh = grid_mesh(320, 320, (10.0, 10.0), cells="mixed", jitter=0.2, seed=0)
    assert mesh.n_cells > 1e5
    points = np.random.default_rng(0).uniform(0, 3200, (1_000_000, 2))
    interpolate(mesh, mesh.nodes, points[:10])
    begin = time.perf_counter()
    found = interpolate(mesh, mesh.nodes, points)
    # One or two seconds on a core; ten only where the search is not by place.
    assert time.perf_counter() - begin < 10
    held = ~np.isnan(found).any(axis=1)
    assert held.mean() > 0.99
    np.testing.assert_allclose(found[held], points[held], atol=1e-9)


def test_a_node_without_a_value_leaves_those_beside_it_theirs() -> None:
    mesh = build_structured_mesh((0, 0, 30, 30), 10)
    values = 0.1 * mesh.nodes + (1.0, -2.0)
    unknown = int(np.flatnonzero((mesh.nodes == (10.0, 10.0)).all(axis=1))[0])
    values[unknown] = np.nan
    found = interpolate(mesh, values, mesh.nodes)
    np.testing.assert_allclose(np.delete(found, unknown, axis=0), np.delete(values, unknown, axis=0), atol=1e-12)
    assert np.isnan(found[unknown]).all()
    # On an edge that it is no end of, and nowhere else in its cells.
    edge, inside, away = np.array([[20.0, 13.0]]), np.array([[19.0, 13.0]]), np.array([[21.0, 13.0]])
    for points, is_known in ((edge, True), (inside, False), (away, True)):
        of_point = interpolate(mesh, values, points)
        assert np.isfinite(of_point).all() == is_known
        if is_known:
            np.testing.assert_allclose(of_point, 0.1 * points + (1.0, -2.0), atol=1e-12)


def test_a_cell_with_a_node_twice_holds_no_point_and_spoils_no_other() -> None:
    # As in a damaged result file.
    whole = build_structured_mesh((0.0, 0.0, 32.0, 16.0), 16.0, "Q4")
    connectivity = whole.connectivity.copy()
    connectivity[5] = connectivity[4]
    damaged = Mesh(whole.nodes, connectivity, whole.offsets, whole.types)
    found = locate(damaged, np.array([[8.0, 8.0], [30.0, 14.0]]))
    assert found.cells[0] == 0
    assert found.cells[1] in (-1, 1)
