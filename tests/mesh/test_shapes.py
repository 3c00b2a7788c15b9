"""Shape functions of T3 and Q4."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from ddic.mesh.mesh import VTK_QUAD, VTK_TRIANGLE, Mesh
from ddic.mesh.quality import areas
from ddic.mesh.shapes import (
    CENTRES,
    QUADRATURE,
    SHAPE_COEFFICIENTS,
    geometry_coefficients,
    monomial_gradients,
    monomials,
    nodal_to_monomial,
    padded_cells,
    shape_gradients,
)
from support.random_meshes import grid_mesh, grid_meshes

CORNERS = {VTK_TRIANGLE: np.array([[0.0, 0], [1, 0], [0, 1]]),
           VTK_QUAD: np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])}
KINDS = pytest.mark.parametrize("kind", [VTK_TRIANGLE, VTK_QUAD])


@KINDS
def test_shape_is_one_at_its_node_and_zero_at_the_others(kind: int) -> None:
    n = len(CORNERS[kind])
    np.testing.assert_array_equal((monomials(CORNERS[kind]) @ SHAPE_COEFFICIENTS[kind].T)[:, :n], np.eye(n))


@KINDS
def test_shapes_sum_to_one(kind: int) -> None:
    local = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    np.testing.assert_allclose((monomials(local) @ SHAPE_COEFFICIENTS[kind].T).sum(axis=1), 1.0, atol=1e-15)


def test_gradients_of_monomials_equal_differences() -> None:
    local = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    h = 0.5  # exact for bilinear functions
    for axis in range(2):
        step = h * np.eye(2)[axis]
        difference = (monomials(local + step) - monomials(local - step)) / (2 * h)
        np.testing.assert_allclose(monomial_gradients(local)[..., axis], difference, atol=1e-15)


@settings(max_examples=40)
@given(mesh=grid_meshes())
def test_map_brings_corners_to_nodes(mesh: Mesh) -> None:
    geometry = geometry_coefficients(mesh)
    for e in range(mesh.n_cells):
        nodes = mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]
        # Rounding of coordinates of up to a hundred pixels.
        np.testing.assert_allclose(monomials(CORNERS[int(mesh.types[e])]) @ geometry[e].T, mesh.nodes[nodes],
                                   atol=1e-12)


@settings(max_examples=40)
@given(mesh=grid_meshes())
def test_gradients_of_linear_fields_and_areas_are_exact(mesh: Mesh) -> None:
    slope = np.array([0.3, -0.7])
    found = np.empty(mesh.n_cells)
    for kind in np.unique(mesh.types):
        members = np.flatnonzero(mesh.types == kind)
        points, weights = QUADRATURE[int(kind)]
        gradients, det = shape_gradients(mesh, members, points)
        values = mesh.nodes[mesh.cells[members][:, : gradients.shape[2]]] @ slope
        linear = np.einsum("epac,ea->epc", gradients, values)
        # Rounding, magnified by the distortion of the cells (sides 2 to 14 px, sheared).
        np.testing.assert_allclose(linear, np.broadcast_to(slope, linear.shape), atol=1e-11)
        found[members] = det @ weights
    np.testing.assert_allclose(found, areas(mesh), rtol=1e-11)


@KINDS
def test_quadrature_and_centres_lie_in_the_reference_cell(kind: int) -> None:
    points, weights = QUADRATURE[kind]
    assert weights.sum() == pytest.approx(0.5 if kind == VTK_TRIANGLE else 4.0)
    # Points and centres integrate linear functions: their weighted mean is the reference cell's centre.
    np.testing.assert_allclose(weights @ points / weights.sum(), CORNERS[kind].mean(axis=0), atol=1e-15)
    np.testing.assert_allclose(CENTRES[kind][0], CORNERS[kind].mean(axis=0), atol=1e-15)


def test_padding_of_triangles_adds_nothing() -> None:
    mesh = grid_mesh(2, 2, (3.0, 3.0), cells="mixed", seed=1)
    triangles = mesh.types == VTK_TRIANGLE
    assert triangles.any()
    assert not triangles.all()
    assert (padded_cells(mesh)[triangles, 3] == padded_cells(mesh)[triangles, 0]).all()
    assert (nodal_to_monomial(mesh)[triangles, 3] == 0).all()
    assert (geometry_coefficients(mesh)[triangles, :, 3] == 0).all()
    assert padded_cells(grid_mesh(1, 1, (3.0, 3.0), cells="T3")).shape == (2, 4)
