"""Unknowns on both sides of a line, and nodes that follow their neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.functionals.line_band import weigh_corners
from ddic.kinematics.enriched import LEAST_SHARE, EnrichedRegion, Opening, enrich
from ddic.mesh.cut_mesh import CutMesh, cut_mesh
from ddic.mesh.structured import build_structured_mesh

MESHES = {kind: build_structured_mesh((20, 20, 180, 180), 16, kind) for kind in ("Q4", "T3")}
START = np.array([0.0, 50.3])
ANGLE = np.deg2rad(23.0)
TANGENT, NORMAL = np.array([np.cos(ANGLE), np.sin(ANGLE)]), np.array([-np.sin(ANGLE), np.cos(ANGLE)])
LINE = np.stack([START, START + 400 * TANGENT])
OPENINGS = {"both": [TANGENT, NORMAL, np.array([0.3, -0.4])], "tangential": [TANGENT, -0.5 * TANGENT],
            "normal": [NORMAL]}


def weigh(cut: CutMesh) -> np.ndarray:
    return weigh_corners(cut.mesh, cut.find_cells_at_phantoms(), 3)


def _enrich(kind: str, opening: Opening) -> tuple[CutMesh, EnrichedRegion]:
    cut = cut_mesh(MESHES[kind], [LINE])
    return cut, enrich(cut, weigh(cut), [opening])


def _find_above(cut: CutMesh) -> np.ndarray:
    """Whether each node, phantom or not, belongs to the side of +n."""
    is_above = np.zeros(cut.mesh.n_nodes, dtype=bool)
    cells = cut.mesh.cells[(cut.mesh.centroids - START) @ NORMAL > 0]
    is_above[cells[cells >= 0]] = True
    return is_above


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("opening", OPENINGS)
def test_rigid_sides_apart_are_in_the_span_nodes_that_follow_included(kind: str, opening: Opening) -> None:
    cut, region = _enrich(kind, opening)
    # Some nodes follow their neighbours: unknowns that stand elsewhere move them.
    rows = region.matrix.tocoo()
    assert (region.node_of_unknown[rows.col] != cut.node_of[rows.row // 2]).any()
    above = _find_above(cut)
    for apart in OPENINGS[opening]:
        u = np.full((cut.mesh.n_nodes, 2), [0.2, -0.1])
        u[above] += apart
        whole = region.restrict(cut.mesh, np.arange(cut.mesh.n_nodes), np.arange(region.n_unknowns))
        fitted = whole.displacement(whole.fit(u.ravel()))
        # The normal equations of T are conditioned well below 1e4.
        np.testing.assert_allclose(fitted, u.ravel(), atol=1e-10)


@given(seed=st.integers(0, 10**6))
def test_nothing_opens_across_a_sliding_line(seed: int) -> None:
    cut, region = _enrich("Q4", "tangential")
    u = (region.matrix @ np.random.default_rng(seed).normal(size=region.n_unknowns)).reshape(-1, 2)
    apart = u - u[cut.node_of]
    assert np.abs(apart @ TANGENT).max() > 0.1
    np.testing.assert_allclose(apart @ NORMAL, 0.0, atol=1e-12)


@pytest.mark.parametrize("opening", OPENINGS)
def test_unknowns_stand_at_nodes_that_have_pixels(opening: Opening) -> None:
    cut, region = _enrich("T3", opening)
    assert region.matrix.shape == (cut.mesh.n_dofs, region.n_unknowns)
    assert region.n_unknowns > MESHES["T3"].n_dofs
    weights = np.bincount(cut.mesh.connectivity, minlength=cut.mesh.n_nodes, weights=weigh(cut))
    at_place = np.bincount(cut.node_of, weights)[cut.node_of]
    assert (weights[region.seen_at] >= LEAST_SHARE * at_place[region.seen_at]).all()
    np.testing.assert_array_equal(cut.node_of[region.seen_at], region.node_of_unknown)
    controlled = region.controlled(np.arange(cut.mesh.n_nodes) % 3 == 0)
    np.testing.assert_array_equal(controlled, region.node_of_unknown % 3 == 0)


def test_subdomain_away_from_the_line_is_nodal() -> None:
    cut, region = _enrich("Q4", "both")
    far = np.flatnonzero(np.abs((cut.mesh.centroids - START) @ NORMAL) > 40)
    part, nodes = cut.mesh.create_submesh(far)
    numbers = np.unique(region.unknowns_at(nodes)[0])
    assert type(region.restrict(part, nodes, numbers)).__name__ == "NodalKinematics"
