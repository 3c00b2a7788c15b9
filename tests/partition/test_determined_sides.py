"""Whatever the partition was, every subdomain sees the sides of a line whose unknowns it takes part in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.functionals.corner_weights import weigh_corners
from ddic.kinematics.discontinuities import Opening
from ddic.kinematics.enriched import enrich
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.determined_sides import LEAST_SHARE, keep_sides_determined
from ddic.partition.split import split_by_metis

MESH = build_structured_mesh((20, 20, 180, 180), 16)


@pytest.mark.parametrize("opening", ["both", "tangential"])
@given(angle=st.floats(1, 179), n_subdomains=st.integers(2, 12))
def test_unknowns_have_pixels_in_all_of_their_subdomains(opening: Opening, angle: float, n_subdomains: int) -> None:
    direction = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    cut = cut_mesh(MESH, [np.stack([100.3 - 300 * direction, 100.3 + 300 * direction])])
    weights = weigh_corners(cut, 3)
    region = enrich(cut, weights, [opening])
    parts = split_by_metis(MESH, n_subdomains, np.ones(MESH.n_cells))
    kept = keep_sides_determined(cut, region, weights, parts)
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
    weights = weigh_corners(cut, 3)
    parts = (MESH.centroids[:, 1] > 100).astype(np.int64)
    np.testing.assert_array_equal(keep_sides_determined(cut, enrich(cut, weights, ["both"]), weights, parts), parts)
