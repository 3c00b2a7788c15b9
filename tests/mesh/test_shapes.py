"""Shape functions of T3 and Q4."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from ddic.mesh.cell_type import T3, differentiate_monomials, evaluate_monomials
from ddic.mesh.mesh import Mesh, compute_geometry, compute_shape_gradients, pad_cells, pad_shapes
from ddic.mesh.quality import measure_areas
from support.random_meshes import grid_mesh, grid_meshes


@pytest.mark.parametrize("dim", [2, 3])
def test_gradients_of_monomials_equal_differences(dim: int) -> None:
    local = np.random.default_rng(0).uniform(-1, 1, (20, dim))
    h = 0.5  # exact for bilinear functions
    for axis, step in enumerate(h * np.eye(dim)):
        difference = (evaluate_monomials(local + step) - evaluate_monomials(local - step)) / (2 * h)
        np.testing.assert_allclose(differentiate_monomials(local)[..., axis], difference, atol=1e-15)


@settings(max_examples=40)
@given(mesh=grid_meshes())
def test_map_brings_corners_to_nodes(mesh: Mesh) -> None:
    geometry = compute_geometry(mesh)
    for block in mesh.cell_blocks:
        found = np.einsum("ecm,am->eac", geometry[block.cells], evaluate_monomials(block.type.nodes))
        # Rounding of coordinates of up to a hundred pixels.
        np.testing.assert_allclose(found, mesh.nodes[block.nodes], atol=1e-12)


@settings(max_examples=40)
@given(mesh=grid_meshes())
def test_gradients_of_linear_fields_and_areas_are_exact(mesh: Mesh) -> None:
    slope = np.array([0.3, -0.7])
    found = np.empty(mesh.n_cells)
    for block in mesh.cell_blocks:
        gradients, det = compute_shape_gradients(mesh, block, block.type.quadrature.points)
        values = mesh.nodes[block.nodes] @ slope
        linear = np.einsum("epac,ea->epc", gradients, values)
        # Rounding, magnified by the distortion of the cells (sides 2 to 14 px, sheared).
        np.testing.assert_allclose(linear, np.broadcast_to(slope, linear.shape), atol=1e-11)
        found[block.cells] = det @ block.type.quadrature.weights
    np.testing.assert_allclose(found, measure_areas(mesh), rtol=1e-11)


def test_padding_of_triangles_adds_nothing() -> None:
    mesh = grid_mesh(2, 2, (3.0, 3.0), cells="mixed", seed=1)
    triangles = mesh.types == T3.vtk
    assert triangles.any()
    assert not triangles.all()
    assert (pad_cells(mesh)[triangles, 3] == pad_cells(mesh)[triangles, 0]).all()
    assert (pad_shapes(T3, 4)[3] == 0).all()
    assert (compute_geometry(mesh)[triangles, :, 3] == 0).all()
    assert pad_cells(grid_mesh(1, 1, (3.0, 3.0), cells="T3")).shape == (2, 4)
