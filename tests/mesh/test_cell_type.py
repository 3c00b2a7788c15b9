"""What every registered cell type must fulfil."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.mesh.cell_type import CELL_TYPES, EXPONENTS, HEX8, Q4, T3, TET4, CellType
from ddic.mesh.mesh import build_mesh, compute_shape_gradients
from ddic.mesh.quality import list_corner_edges, measure_areas

EVERY = pytest.mark.parametrize("kind", CELL_TYPES.values(), ids=lambda kind: kind.name)

PLANE = pytest.mark.parametrize("kind", [T3, Q4], ids=lambda kind: kind.name)
IN_SPACE = pytest.mark.parametrize("kind", [TET4, HEX8], ids=lambda kind: kind.name)

AFFINE = np.array([[7.0, 2.0, 1.0], [-3.0, 9.0, 2.0], [1.0, -2.0, 6.0]])


SIMPLICES = {
    "T3": T3.triangles,
    "Q4": Q4.triangles,
    "Tet4": ((0, 1, 2, 3),),
    # About the diagonal from node 0 to node 6.
    "Hex8": tuple((0, a, b, 6) for a, b in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))),
}
"""Nodes of the simplices that together are each cell."""


def reference_area(kind: CellType) -> float:
    return float(measure_areas(build_mesh(kind.nodes, {kind: np.arange(kind.n_nodes)[None]}))[0])


def test_registered_by_their_numbers() -> None:
    assert dict(CELL_TYPES) == {5: T3, 9: Q4, 10: TET4, 12: HEX8}
    for attribute in ("name", "meshio_name"):
        assert len({getattr(kind, attribute) for kind in CELL_TYPES.values()}) == len(CELL_TYPES)


@EVERY
def test_sizes(kind: CellType) -> None:
    # The first monomials, as many as nodes; triangles do not use their fourth.
    assert kind.shapes.shape == (kind.n_nodes, max(kind.n_nodes, 4))
    assert kind.n_nodes <= len(EXPONENTS[kind.dim])
    assert kind.quadrature.points.shape == (len(kind.quadrature.weights), kind.dim)
    assert kind.centre.shape == (kind.dim,)


@EVERY
def test_shape_is_one_at_its_node_and_zero_at_the_others(kind: CellType) -> None:
    np.testing.assert_array_equal(kind.evaluate_shapes(kind.nodes), np.eye(kind.n_nodes))


@EVERY
def test_shapes_sum_to_one(kind: CellType) -> None:
    local = np.random.default_rng(0).uniform(-1, 1, (20, kind.dim))
    np.testing.assert_allclose(kind.evaluate_shapes(local).sum(axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(kind.differentiate_shapes(local).sum(axis=1), 0.0, atol=1e-15)


@EVERY
def test_derivatives_equal_differences(kind: CellType) -> None:
    local = np.random.default_rng(1).uniform(-1, 1, (20, kind.dim))
    h = 0.5  # exact for functions that are linear along each axis
    for axis, step in enumerate(h * np.eye(kind.dim)):
        difference = (kind.evaluate_shapes(local + step) - kind.evaluate_shapes(local - step)) / (2 * h)
        np.testing.assert_allclose(kind.differentiate_shapes(local)[..., axis], difference, atol=1e-15)


@EVERY
def test_weights_sum_to_the_area_and_points_lie_about_the_centre(kind: CellType) -> None:
    points, weights = kind.quadrature.points, kind.quadrature.weights
    assert weights.sum() == pytest.approx(reference_area(kind), rel=1e-15)
    np.testing.assert_allclose(weights @ points / weights.sum(), kind.centre, atol=1e-15)
    # Shape functions of points inside are positive.
    assert (kind.evaluate_shapes(points) > 0).all()


@EVERY
def test_stiffness_of_an_affine_cell_is_integrated_exactly(kind: CellType) -> None:
    """Against Gauss's rule of four points a side, collapsed onto simplices that together are the cell."""
    mesh = build_mesh(kind.nodes @ AFFINE[:kind.dim, :kind.dim].T, {kind: np.arange(kind.n_nodes)[None]})

    def integrate(points: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        gradients, det = compute_shape_gradients(mesh, mesh.cell_blocks[0], points)
        return np.asarray(np.einsum("paj,pbk,p->ajbk", gradients[0], gradients[0], det[0] * weights))

    x, w = np.polynomial.legendre.leggauss(4)
    s, t, r = (grid.ravel() for grid in np.meshgrid(*[(x + 1) / 2] * 3, indexing="ij"))
    weights = np.einsum("i,j,k->ijk", *[w / 2] * 3).ravel()
    # A cube is shrunk to an edge at s = 0; in the plane r says nothing.
    if kind.dim == 2:
        barycentric, weights = np.stack([1 - s, s * (1 - t), s * t], axis=1), weights * s
    else:
        barycentric = np.stack([1 - s, s * (1 - t), s * t * (1 - r), s * t * r], axis=1)
        weights = weights * s**2 * t
    expected = np.zeros((kind.n_nodes, kind.dim) * 2)
    for corners in SIMPLICES[kind.name]:
        ends = kind.nodes[list(corners)]
        expected += integrate(barycentric @ ends, np.linalg.det(ends[1:] - ends[0]) * weights)
    # Rounding of sums of some thirty terms of order one.
    np.testing.assert_allclose(integrate(kind.quadrature.points, kind.quadrature.weights), expected, atol=1e-14)


@PLANE
def test_edges_close_around_the_cell(kind: CellType) -> None:
    starts, ends = np.array(kind.facets).T
    assert starts.tolist() == list(range(kind.n_nodes))
    assert ends.tolist() == np.roll(starts, -1).tolist()
    # Counter-clockwise from +xi to +eta.
    assert reference_area(kind) > 0


@PLANE
def test_triangles_cover_the_cell(kind: CellType) -> None:
    triangles = build_mesh(kind.nodes, {T3: np.array(kind.triangles)})
    assert measure_areas(triangles).min() > 0
    assert measure_areas(triangles).sum() == pytest.approx(reference_area(kind), rel=1e-15)


@IN_SPACE
def test_faces_close_around_the_cell_and_look_outwards(kind: CellType) -> None:
    """Each edge of a face is one of a single other face, which runs through it the other way round."""
    edges = [(a, b) for face in kind.facets for a, b in zip(face, np.roll(face, -1).tolist(), strict=True)]
    assert sorted(edges) == sorted((b, a) for a, b in edges)
    for face in kind.facets:
        corners = kind.nodes[list(face)]
        assert np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ (corners.mean(axis=0) - kind.centre) > 0


@EVERY
def test_edges_at_corners_are_positive(kind: CellType) -> None:
    edges = list_corner_edges(build_mesh(kind.nodes, {kind: np.arange(kind.n_nodes)[None]}), kind.nodes)
    assert np.linalg.det(edges).min() > 0


@EVERY
def test_a_mirrored_cell_is_turned_inside_out(kind: CellType) -> None:
    """Its nodes in the order ``mirrored`` are again a positive cell, with the same facets."""
    mirror = kind.nodes * np.array([-1.0, 1.0, 1.0])[:kind.dim]
    cells = np.array([kind.mirrored, range(kind.n_nodes)])
    of_mirrored, of_plain = measure_areas(build_mesh(mirror, {kind: cells}))
    assert of_mirrored == pytest.approx(reference_area(kind), rel=1e-15)
    assert of_plain == pytest.approx(-of_mirrored, rel=1e-15)
    turned = {frozenset(kind.mirrored[node] for node in facet) for facet in kind.facets}
    assert turned == {frozenset(facet) for facet in kind.facets}


@PLANE
def test_nodes_and_cells_of_a_regular_mesh(kind: CellType) -> None:
    """Angles around an inner node make a full turn: n corners share (n - 2) pi."""
    mean_angle = np.pi * (kind.n_nodes - 2) / kind.n_nodes
    assert kind.cells_around_node == pytest.approx(2 * np.pi / mean_angle)
