"""Meshes of half the size cover the same, with the same field."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.mesh.quality import measure_areas
from ddic.mesh.refinement import refine
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes, find_named_nodes


@given(st.integers(0, 1000), st.sampled_from(["Q4", "T3"]))
@settings(max_examples=20)
def test_parts_cover_their_cells(seed: int, cell: str) -> None:
    mesh = build_structured_mesh((0.0, 0.0, 40.0, 32.0), 8.0, cell)
    rng = np.random.default_rng(seed)
    moved = mesh.nodes + rng.uniform(-1.5, 1.5, mesh.nodes.shape)
    mesh = type(mesh)(moved, mesh.connectivity, mesh.offsets, mesh.types, mesh.node_sets)
    refined = refine(mesh)
    assert refined.mesh.n_cells == 4 * mesh.n_cells
    assert np.array_equal(refined.mesh.nodes[:mesh.n_nodes], mesh.nodes)
    assert np.bincount(refined.parents, measure_areas(refined.mesh)) == pytest.approx(measure_areas(mesh))
    # As many nodes as Euler's formula has: no two at one place.
    assert len(np.unique(refined.mesh.nodes.round(9), axis=0)) == refined.mesh.n_nodes


def test_a_field_stays_and_sets_follow() -> None:
    mesh = build_structured_mesh((0.0, 0.0, 40.0, 32.0), 8.0, circles=[((20.0, 16.0), 6.0)])
    refined = refine(mesh)
    x, y = mesh.nodes.T
    field = np.stack([1.0 + 2.0 * x - y, 0.5 * y], axis=1)
    x, y = refined.mesh.nodes.T
    fine = np.stack([1.0 + 2.0 * x - y, 0.5 * y], axis=1)
    assert refined.interpolate(field.ravel()).reshape(-1, 2) == pytest.approx(fine)
    for name in ("left", "top"):
        nodes = refined.mesh.nodes[find_named_nodes(refined.mesh, name)]
        assert len(nodes) == 2 * len(find_named_nodes(mesh, name)) - 1
        assert nodes[:, 0 if name == "left" else 1] == pytest.approx(0.0)
    assert len(find_boundary_nodes(refined.mesh)) == 2 * len(find_boundary_nodes(mesh))
