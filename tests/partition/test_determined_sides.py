"""Whatever the partition was, every subdomain sees the sides of a line whose unknowns it takes part in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.functionals.line_band import weigh_corners
from ddic.kinematics.enriched import Opening, enrich
from ddic.mesh.cut_mesh import CutMesh, cut_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.determined import LEAST_SHARE, CutSides, keep_cameras_determined, keep_sides_determined
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import split_by_metis

MESH = build_structured_mesh((20, 20, 180, 180), 16)
ONE_CAMERA = np.zeros(MESH.n_cells, dtype=np.int64)


def weigh(cut: CutMesh) -> NDArray[np.float64]:
    return weigh_corners(cut.mesh, cut.find_cells_at_phantoms(), 3)


@pytest.mark.parametrize("opening", ["both", "tangential"])
# As many of each opening as make a hundred.
@settings(max_examples=50)
@given(angle=st.floats(1, 179), n_subdomains=st.integers(2, 12))
def test_unknowns_have_pixels_in_all_of_their_subdomains(opening: Opening, angle: float, n_subdomains: int) -> None:
    direction = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    cut = cut_mesh(MESH, [np.stack([100.3 - 300 * direction, 100.3 + 300 * direction])])
    weights = weigh(cut)
    region = enrich(cut, weights, [opening])
    parts = split_by_metis(MESH, n_subdomains, np.ones(MESH.n_cells))
    kept = keep_sides_determined(CutSides(cut, region, weights), ONE_CAMERA, parts)
    assert sorted(set(kept.tolist())) == list(range(kept.max() + 1))
    of_node = np.bincount(cut.mesh.connectivity, minlength=cut.mesh.n_nodes, weights=weights)
    of_cell = np.split(weights, cut.mesh.offsets[1:-1])
    has_phantom = np.bincount(cut.node_of)[cut.node_of] > 1
    for subdomain in build_subdomains(region, kept[cut.cell_of], np.zeros(region.n_unknowns, dtype=bool)):
        mesh = subdomain.mesh
        seen = np.zeros(cut.mesh.n_nodes)
        seen[subdomain.node_ids] = np.bincount(mesh.connectivity, minlength=mesh.n_nodes,
                                               weights=np.concatenate([of_cell[k] for k in subdomain.cell_ids]))
        nodes = region.seen_at[subdomain.kinematics.numbers]
        nodes = nodes[has_phantom[nodes]]
        assert (seen[nodes] >= LEAST_SHARE * of_node[nodes]).all()


def test_partition_that_sees_enough_stays_as_it_is() -> None:
    cut = cut_mesh(MESH, [np.array([[100.3, 0.0], [101.2, 300.0]])])
    weights = weigh(cut)
    parts = (MESH.centroids[:, 1] > 100).astype(np.int64)
    kept = keep_sides_determined(CutSides(cut, enrich(cut, weights, ["both"]), weights), ONE_CAMERA, parts)
    np.testing.assert_array_equal(kept, parts)


@given(angle=st.floats(1, 179), x0=st.integers(0, 6), y0=st.integers(0, 6), seed=st.integers(0, 99))
def test_pixels_of_one_camera_determine_the_sides_in_its_cells(angle: float, x0: int, y0: int, seed: int) -> None:
    direction = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    middle = 100.3 + np.random.default_rng(seed).uniform(-20, 20, 2)
    cut = cut_mesh(MESH, [np.stack([middle - 300 * direction, middle + 300 * direction])])
    weights = weigh(cut)
    region = enrich(cut, weights, ["both"])
    column, row = ((MESH.centroids - 20) // 16).T
    cameras = ((column >= x0) & (column < x0 + 4) & (row >= y0) & (row < y0 + 4)).astype(np.int64)
    while not np.array_equal(kept := keep_cameras_determined(CutSides(cut, region, weights), cameras), cameras):
        assert (kept <= cameras).all()
        cameras = kept
    of_node = np.bincount(cut.mesh.connectivity, minlength=cut.mesh.n_nodes, weights=weights)
    of_corner = cameras[cut.cell_of][np.repeat(np.arange(cut.mesh.n_cells), np.diff(cut.mesh.offsets))]
    has_phantom = np.bincount(cut.node_of)[cut.node_of] > 1
    # As subdomains, one a camera.
    nothing = np.zeros(region.n_unknowns, dtype=bool)
    for camera, subdomain in enumerate(build_subdomains(region, cameras[cut.cell_of], nothing)):
        own = of_corner == camera
        seen = np.bincount(cut.mesh.connectivity[own], minlength=cut.mesh.n_nodes, weights=weights[own])
        nodes = region.seen_at[subdomain.kinematics.numbers]
        nodes = nodes[has_phantom[nodes]]
        assert (seen[nodes] >= LEAST_SHARE * of_node[nodes]).all()
