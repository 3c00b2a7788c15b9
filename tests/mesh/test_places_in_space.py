"""Cells in space that hold points, and the points' places in them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.mesh.cell_type import TET4
from ddic.mesh.interpolation import EDGE, interpolate, locate, place_in_cells
from ddic.mesh.mesh import Mesh
from support.random_meshes import box_mesh

MESHES = st.builds(box_mesh, st.integers(0, 2**32 - 1), st.sampled_from(["Hex8", "Tet4", "both"]))


def scatter(mesh: Mesh, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A place in each cell, away from its faces, and where that is."""
    rng = np.random.default_rng(seed)
    local, points = np.empty((mesh.n_cells, 3)), np.empty((mesh.n_cells, 3))
    for block in mesh.cell_blocks:
        shares = rng.dirichlet(np.ones(block.type.n_nodes), len(block.cells))
        local[block.cells] = 0.9 * shares @ block.type.nodes + 0.1 * block.type.centre
        shapes = block.type.evaluate_shapes(local[block.cells])
        points[block.cells] = np.einsum("na,nac->nc", shapes, mesh.nodes[block.nodes])
    return local, points


@settings(max_examples=30)
@given(mesh=MESHES, seed=st.integers(0, 2**32 - 1))
def test_local_coordinates_are_those_of_the_points(mesh: Mesh, seed: int) -> None:
    local, points = scatter(mesh, seed)
    located = locate(mesh, points)
    assert located.cells.tolist() == list(range(mesh.n_cells))
    # Newton's last step is of 1e-9, so that what is left is rounding.
    np.testing.assert_allclose(located.local, local, atol=1e-12)


@settings(max_examples=30)
@given(mesh=MESHES, seed=st.integers(0, 2**32 - 1))
def test_affine_fields_are_exact_at_nodes_and_on_faces_too(mesh: Mesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    slope, constant = rng.normal(size=(2, 3)), rng.normal(size=2)
    on_faces = [mesh.nodes[block.nodes[:, list(facet)]].mean(axis=1)
                for block in mesh.cell_blocks for facet in block.type.facets]
    points = np.concatenate([mesh.nodes, *on_faces, scatter(mesh, seed)[1]])
    found = interpolate(mesh, mesh.nodes @ slope.T + constant, points)
    # Rounding of coordinates of some ten pixels.
    np.testing.assert_allclose(found, points @ slope.T + constant, atol=1e-12)


@pytest.mark.parametrize("cells", ["Hex8", "Tet4", "both"])
def test_points_outside_are_in_no_cell(cells: str) -> None:
    mesh = box_mesh(3, cells)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    rng = np.random.default_rng(0)
    near = rng.uniform(low - 3.0, high + 3.0, (2000, 3))
    beyond = ((near < low) | (near > high)).any(axis=1)
    assert (locate(mesh, near[beyond]).cells == -1).all()
    assert (locate(mesh, np.array([[np.nan] * 3, [np.inf, 0.0, 0.0], [1e300] * 3])).cells == -1).all()
    # Within rounding of a face, a point is in the cell.
    corner = mesh.nodes[[0]]
    assert locate(mesh, corner - 0.3 * EDGE).cells[0] >= 0
    assert locate(mesh, corner - 30.0 * EDGE).cells[0] == -1


def test_a_hole_holds_no_point() -> None:
    mesh = box_mesh(1, "Hex8")
    _, points = scatter(mesh, 1)
    kept = np.arange(mesh.n_cells) != 27
    located = locate(mesh.keep_cells(np.flatnonzero(kept)), points)
    assert (located.cells >= 0).tolist() == kept.tolist()
    assert np.isnan(located.local[27]).all()


def test_a_cell_goes_on_beyond_its_faces() -> None:
    """An affine field of it too."""
    mesh = box_mesh(2, "Tet4")
    points = mesh.centroids + 11.0
    placed = place_in_cells(mesh, np.arange(mesh.n_cells), points)
    shapes = TET4.evaluate_shapes(placed.local)
    # Rounding in tetrahedra a tenth as thick as long.
    np.testing.assert_allclose(np.einsum("na,nac->nc", shapes, mesh.nodes[mesh.cells]), points, atol=1e-11)
