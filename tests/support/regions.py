"""Outlines of regions, and what the node sets of their meshes are to be."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse

from ddic.mesh.mesh import Mesh
from ddic.mesh.rotation import build_rotation
from ddic.mesh.topology import find_adjacent_cells, find_facets

Array = NDArray[np.float64]
SIDES = ("left", "right", "top", "bottom")
SHAPES: dict[str, Array] = {
    "rectangle": np.array([(-120, -60), (120, -60), (120, 60), (-120, 60)], float),
    "triangle": np.array([(-100, 60), (100, 60), (0, -110)], float),
    "L": np.array([(-100, -100), (100, -100), (100, -20), (0, -20), (0, 100), (-100, 100)], float),
    "bone": np.array([(-150, -80), (-90, -80), (-70, -40), (70, -40), (90, -80), (150, -80), (150, 80), (90, 80),
                      (70, 40), (-70, 40), (-90, 80), (-150, 80)], float),
}


def turned(name: str, degrees: float) -> Array:
    return np.asarray(SHAPES[name] @ build_rotation(np.deg2rad(degrees)).T + [203.3, 197.1])


def area_of(vertices: Array) -> float:
    x, y = vertices.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def is_in_one_piece(mesh: Mesh) -> bool:
    indptr, indices = find_adjacent_cells(mesh)
    graph = sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (mesh.n_cells, mesh.n_cells))
    return bool(sparse.csgraph.connected_components(graph)[0] == 1)


def outward_normals(mesh: Mesh) -> tuple[NDArray[np.int64], Array]:
    """Edges of the boundary, and for each the vector from its cell's centre to its middle, made normal to it."""
    found = find_facets(mesh)
    at_edge = found.n_cells[found.side_facets] == 1
    edges = found.nodes[found.side_facets[at_edge]][:, :2]
    middles = mesh.nodes[edges].mean(axis=1)
    along = mesh.nodes[edges[:, 1]] - mesh.nodes[edges[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    outward = middles - mesh.centroids[found.side_cells[at_edge]]
    return edges, outward - (outward * along).sum(axis=1, keepdims=True) * along


def expected_sets(mesh: Mesh, holes: list[tuple[tuple[float, float], float]]) -> dict[str, NDArray[np.int64]]:
    """Node sets by what is nearest to each edge's middle, then by where it faces."""
    edges, normals = outward_normals(mesh)
    # A facet at 45 degrees faces two ways.
    is_clear = np.abs(np.abs(normals[:, 0]) - np.abs(normals[:, 1])) > 1e-3 * np.abs(normals).max(axis=1)
    if not is_clear.all():
        reject()
    middles = mesh.nodes[edges].mean(axis=1)
    names = np.array(["left", "top", "right", "bottom"])[
        (np.floor((np.arctan2(normals[:, 1], normals[:, 0]) + 5 * np.pi / 4) / (np.pi / 2)) % 4).astype(int)]
    for k, (center, radius) in enumerate(holes):
        names = np.where(np.linalg.norm(middles - center, axis=1) < radius + 1, f"hole_{k}", names)
    return {str(name): np.unique(edges[names == name]) for name in np.unique(names)}


def assert_sets(mesh: Mesh, holes: list[tuple[tuple[float, float], float]]) -> None:
    expected = expected_sets(mesh, holes)
    assert set(mesh.node_sets) == set(expected)
    for name, nodes in expected.items():
        np.testing.assert_array_equal(mesh.node_sets[name], nodes)


@st.composite
def simple_polygons(draw: Any) -> Array:
    """Random outlines that do not cross themselves, seen whole from a point inside: convex or not, with tips."""
    n = draw(st.integers(3, 9))
    gaps = np.array(draw(st.lists(st.floats(0.7, 1.4), min_size=n, max_size=n)))
    angles = draw(st.floats(0, 2 * np.pi)) + np.cumsum(gaps / gaps.sum()) * 2 * np.pi
    radii = np.array(draw(st.lists(st.floats(40, 110), min_size=n, max_size=n)))
    return np.asarray(150 + radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]))
