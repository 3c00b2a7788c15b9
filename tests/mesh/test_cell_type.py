"""What every registered cell type must fulfil."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.mesh.cell_type import CELL_TYPES, N_MONOMIALS, Q4, T3, CellType
from ddic.mesh.mesh import build_mesh, compute_shape_gradients
from ddic.mesh.quality import measure_areas

EVERY = pytest.mark.parametrize("kind", CELL_TYPES.values(), ids=lambda kind: kind.name)

AFFINE = np.array([[7.0, 2.0], [-3.0, 9.0]])


def reference_area(kind: CellType) -> float:
    return float(measure_areas(build_mesh(kind.nodes, {kind: np.arange(kind.n_nodes)[None]}))[0])


def test_registered_by_their_numbers() -> None:
    assert dict(CELL_TYPES) == {5: T3, 9: Q4}
    for attribute in ("name", "meshio_name"):
        assert len({getattr(kind, attribute) for kind in CELL_TYPES.values()}) == len(CELL_TYPES)


@EVERY
def test_sizes(kind: CellType) -> None:
    assert kind.shapes.shape == (kind.n_nodes, N_MONOMIALS)
    assert kind.n_nodes <= N_MONOMIALS
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
    """Against Gauss's rule of four points a side, collapsed onto the triangles that the cell is cut into."""
    mesh = build_mesh(kind.nodes @ AFFINE.T, {kind: np.arange(kind.n_nodes)[None]})

    def integrate(points: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        gradients, det = compute_shape_gradients(mesh, mesh.cell_blocks[0], points)
        return np.asarray(np.einsum("paj,pbk,p->ajbk", gradients[0], gradients[0], det[0] * weights))

    x, w = np.polynomial.legendre.leggauss(4)
    s, t = (grid.ravel() for grid in np.meshgrid((x + 1) / 2, (x + 1) / 2))
    barycentric = np.stack([1 - s, s * (1 - t), s * t], axis=1)
    on_triangle = np.outer(w / 2, w / 2).ravel() * s
    expected = np.zeros((kind.n_nodes, kind.dim) * 2)
    for corners in kind.triangles:
        ends = kind.nodes[list(corners)]
        twice_area = np.linalg.det(ends[1:] - ends[0])
        expected += integrate(barycentric @ ends, twice_area * on_triangle)
    # Rounding of sums of some thirty terms of order one.
    np.testing.assert_allclose(integrate(kind.quadrature.points, kind.quadrature.weights), expected, atol=1e-14)


@EVERY
def test_edges_close_around_the_cell(kind: CellType) -> None:
    starts, ends = np.array(kind.facets).T
    assert starts.tolist() == list(range(kind.n_nodes))
    assert ends.tolist() == np.roll(starts, -1).tolist()
    # Counter-clockwise from +xi to +eta.
    assert reference_area(kind) > 0


@EVERY
def test_triangles_cover_the_cell(kind: CellType) -> None:
    triangles = build_mesh(kind.nodes, {T3: np.array(kind.triangles)})
    assert measure_areas(triangles).min() > 0
    assert measure_areas(triangles).sum() == pytest.approx(reference_area(kind), rel=1e-15)


@EVERY
def test_nodes_and_cells_of_a_regular_mesh(kind: CellType) -> None:
    """Angles around an inner node make a full turn: n corners share (n - 2) pi."""
    mean_angle = np.pi * (kind.n_nodes - 2) / kind.n_nodes
    assert kind.cells_around_node == pytest.approx(2 * np.pi / mean_angle)
