"""Partitions in which every subdomain's slaves tell its masters."""

from __future__ import annotations

import numpy as np
import pytest
from ddic.partition.connectivity import build_subdomains
from ddic.partition.tied_parts import LEAST, with_told_masters
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.by_camera import kept_apart
from ddic.partition.split import split_by_metis
from ddic.partition.ties import Tying, tied_mesh

FAR = build_structured_mesh((20, 20, 116, 116), 8)


def smallest_values(mesh: Mesh, tying: Tying, parts: NDArray[np.int64]) -> list[float]:
    """Of each subdomain's map from its unknowns to its mesh nodes."""
    subdomains = build_subdomains(mesh, parts, np.ones(2 * tying.n_unknown_nodes, dtype=bool), tying.weights)
    return [1.0 if s.tie is None else _smallest(s.tie.matrix.toarray()) for s in subdomains]


def _smallest(matrix: NDArray[np.float64]) -> float:
    return 0.0 if matrix.shape[0] < matrix.shape[1] else float(np.linalg.svd(matrix, compute_uv=False)[-1])


@pytest.mark.parametrize("n", [2, 5, 9, 16])
@pytest.mark.parametrize("element", [2.9, 4.0, 5.3])
def test_no_subdomain_has_masters_it_cannot_tell(n: int, element: float) -> None:
    mesh, tying = tied_mesh(FAR, {1: build_structured_mesh((44, 36, 84, 76), element)})
    near = np.flatnonzero(tying.cameras == 1)
    given = np.zeros(mesh.n_cells, dtype=np.int64)
    given[near] = split_by_metis(mesh.submesh(near)[0], n)
    given = kept_apart(given, tying.cameras)
    parts = with_told_masters(mesh, tying, given)
    assert min(smallest_values(mesh, tying, parts)) >= LEAST
    assert all(len(set(tying.cameras[parts == s].tolist())) == 1 for s in range(parts.max() + 1))
    # Only cells at the common boundary move.
    moved = (parts[:, None] == parts[None]) != (given[:, None] == given[None])
    at_boundary = np.array([(mesh.connectivity[mesh.offsets[c]: mesh.offsets[c + 1]] >= tying.n_unknown_nodes).any()
                            for c in range(mesh.n_cells)])
    assert not moved[~at_boundary][:, ~at_boundary].any()


def test_single_cells_at_the_boundary_are_too_small() -> None:
    mesh, tying = tied_mesh(FAR, {1: build_structured_mesh((44, 36, 84, 76), 2.9)})
    given = np.arange(mesh.n_cells)
    assert min(smallest_values(mesh, tying, given)) < 1e-12
    assert min(smallest_values(mesh, tying, with_told_masters(mesh, tying, given))) >= LEAST


def test_a_partition_that_is_well_stays() -> None:
    centre = FAR.centroids
    inside = ((centre > (44, 36)) & (centre < (84, 76))).all(axis=1)
    mesh, tying = tied_mesh(FAR, {1: FAR.submesh(np.flatnonzero(inside))[0]})
    given = np.arange(mesh.n_cells)
    np.testing.assert_array_equal(with_told_masters(mesh, tying, given), given)


def test_near_meshes_coarser_than_the_far_one_are_refused() -> None:
    mesh, tying = tied_mesh(FAR, {1: build_structured_mesh((44, 36, 84, 76), 13.3)})
    with pytest.raises(InputError, match="near, entry 1: its mesh has too few nodes on the boundary"):
        with_told_masters(mesh, tying, tying.cameras)
