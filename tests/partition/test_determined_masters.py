"""Partitions in which every subdomain's slaves determine its masters."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.kinematics.linear import TiedRegion
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.determined import LEAST, keep_masters_determined
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import keep_cameras_apart, split_by_metis
from ddic.partition.ties import Tying, tie_meshes

FAR = build_structured_mesh((20, 20, 116, 116), 8)


def smallest_values(mesh: Mesh, tying: Tying, parts: NDArray[np.int64]) -> list[float]:
    """Of each subdomain's map from its unknowns to its mesh nodes."""
    region = TiedRegion(mesh, tying.weights)
    subdomains = build_subdomains(region, parts, np.ones(region.n_unknowns, dtype=bool))
    return [_smallest(s.kinematics.tangent.toarray()) for s in subdomains]


def _smallest(matrix: NDArray[np.float64]) -> float:
    return 0.0 if matrix.shape[0] < matrix.shape[1] else float(np.linalg.svd(matrix, compute_uv=False)[-1])


@pytest.mark.parametrize("n", [2, 5, 9, 16])
@pytest.mark.parametrize("element", [2.9, 4.0, 5.3])
def test_no_subdomain_has_masters_that_it_does_not_determine(n: int, element: float) -> None:
    mesh, tying = tie_meshes(FAR, {1: build_structured_mesh((44, 36, 84, 76), element)})
    near = np.flatnonzero(tying.cameras == 1)
    given = np.zeros(mesh.n_cells, dtype=np.int64)
    given[near] = split_by_metis(mesh.create_submesh(near)[0], n)
    given = keep_cameras_apart(given, tying.cameras)
    parts = keep_masters_determined(mesh, tying, given)
    assert min(smallest_values(mesh, tying, parts)) >= LEAST
    assert all(len(set(tying.cameras[parts == s].tolist())) == 1 for s in range(parts.max() + 1))
    # Only cells at the common boundary move.
    moved = (parts[:, None] == parts[None]) != (given[:, None] == given[None])
    at_boundary = np.array([(mesh.connectivity[mesh.offsets[c]: mesh.offsets[c + 1]] >= tying.n_unknown_nodes).any()
                            for c in range(mesh.n_cells)])
    assert not moved[~at_boundary][:, ~at_boundary].any()


def test_single_cells_at_the_boundary_are_too_small() -> None:
    mesh, tying = tie_meshes(FAR, {1: build_structured_mesh((44, 36, 84, 76), 2.9)})
    given = np.arange(mesh.n_cells)
    assert min(smallest_values(mesh, tying, given)) < 1e-12
    assert min(smallest_values(mesh, tying, keep_masters_determined(mesh, tying, given))) >= LEAST


def test_a_partition_that_is_well_stays() -> None:
    centre = FAR.centroids
    inside = ((centre > (44, 36)) & (centre < (84, 76))).all(axis=1)
    mesh, tying = tie_meshes(FAR, {1: FAR.create_submesh(np.flatnonzero(inside))[0]})
    given = np.arange(mesh.n_cells)
    np.testing.assert_array_equal(keep_masters_determined(mesh, tying, given), given)


def test_near_meshes_coarser_than_the_far_one_are_refused() -> None:
    mesh, tying = tie_meshes(FAR, {1: build_structured_mesh((44, 36, 84, 76), 13.3)})
    with pytest.raises(InputError, match="near, entry 1: its mesh has too few nodes on the boundary"):
        keep_masters_determined(mesh, tying, tying.cameras)
