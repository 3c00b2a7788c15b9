"""Partitions by unknown: nodes with fewer unknowns than others, and modes that all subdomains share."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse

from ddic.kinematics.linear import LinearRegion
from ddic.mesh.mesh import Mesh
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Subdomain
from support.interfaces import check_numbering, stack_jumps
from support.random_meshes import PARTITIONS, SEEDS, delaunay_meshes, grid_mesh, grid_meshes, random_partition

MESHES = st.one_of(grid_meshes(most=4), delaunay_meshes())
N_MODES = 3


def fix_every_third_along_y(mesh: Mesh, n_modes: int = 0) -> LinearRegion:
    """Two unknowns at most nodes, one at every third; then modes of the whole region, which all subdomains share."""
    moves = np.ones(mesh.nodes.shape, dtype=bool)
    moves[::3, 1] = False
    nodal = sparse.identity(mesh.n_dofs, format="csr")[:, np.flatnonzero(moves)]
    # No mode vanishes at any node.
    modes = np.random.default_rng(0).uniform(0.5, 1.0, (mesh.n_dofs, n_modes))
    return LinearRegion(mesh, sparse.hstack([nodal, sparse.csr_matrix(modes)]).tocsr())


def find_sharers(region: LinearRegion, parts: NDArray[np.int64]) -> list[list[int]]:
    """Subdomains that share each unknown, by going through cells, nodes and columns."""
    mesh, depends = region.mesh, region.matrix.toarray() != 0
    found: list[set[int]] = [set() for _ in range(region.n_unknowns)]
    for e in range(mesh.n_cells):
        for node in mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]:
            for unknown in np.flatnonzero(depends[2 * node: 2 * node + 2].any(axis=0)):
                found[unknown].add(int(parts[e]))
    return [sorted(subdomains) for subdomains in found]


def cut(region: LinearRegion, parts: NDArray[np.int64], seed: int) -> tuple[list[Subdomain], NDArray[np.bool_]]:
    controlled = np.random.default_rng(seed).random(region.n_unknowns) < 0.6
    return build_subdomains(region, parts, controlled), controlled


@settings(max_examples=40)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 6), n_modes=st.sampled_from([0, N_MODES]), seed=SEEDS)
def test_subdomains_have_the_unknowns_that_move_their_nodes(mesh: Mesh, kind: str, n: int, n_modes: int,
                                                            seed: int) -> None:
    region = fix_every_third_along_y(mesh, n_modes)
    parts = random_partition(mesh, kind, n, seed)
    subdomains, controlled = cut(region, parts, seed)
    sharers = find_sharers(region, parts)
    # Modes are every subdomain's.
    assert all(len(of_unknown) == len(subdomains) for of_unknown in sharers[region.n_unknowns - n_modes:])
    dense = region.matrix.toarray()
    for s in subdomains:
        expected = [k for k, of_unknown in enumerate(sharers) if s.index in of_unknown]
        assert s.numbers.tolist() == expected
        assert (s.n_field, s.n_unknowns, s.n_motion) == (len(expected), len(expected), 0)
        assert s.multiplicity.tolist() == s.all_multiplicity.tolist() == [len(sharers[k]) for k in expected]
        assert s.owned.tolist() == [sharers[k][0] == s.index for k in expected]
        assert s.controlled.tolist() == controlled[expected].tolist()
        rows = (2 * s.node_ids[:, None] + np.arange(2)).ravel()
        np.testing.assert_array_equal(s.kinematics.tangent.toarray(), dense[np.ix_(rows, expected)])
    # Every unknown that moves a node of some cell has one owner.
    owned = np.concatenate([s.numbers[s.owned] for s in subdomains])
    assert sorted(owned.tolist()) == [k for k, of_unknown in enumerate(sharers) if of_unknown]


@settings(max_examples=40)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 6), n_modes=st.sampled_from([0, N_MODES]), seed=SEEDS)
def test_an_unknown_of_m_subdomains_has_m_minus_one_rows(mesh: Mesh, kind: str, n: int, n_modes: int,
                                                         seed: int) -> None:
    region = fix_every_third_along_y(mesh, n_modes)
    parts = random_partition(mesh, kind, n, seed)
    subdomains, controlled = cut(region, parts, seed)
    check_numbering(subdomains, dict(enumerate(find_sharers(region, parts))), controlled)


@settings(max_examples=40)
@given(mesh=grid_meshes(most=4), kind=PARTITIONS, n=st.integers(1, 6), n_modes=st.sampled_from([0, N_MODES]),
       seed=SEEDS)
def test_kernel_of_the_jumps_are_the_unknowns_of_the_whole(mesh: Mesh, kind: str, n: int, n_modes: int,
                                                           seed: int) -> None:
    region = fix_every_third_along_y(mesh, n_modes)
    subdomains, _ = cut(region, random_partition(mesh, kind, n, seed), seed)
    c = stack_jumps(subdomains)
    c = c[np.abs(c).sum(axis=1) > 0]  # without rows of reactions
    q = np.random.default_rng(seed).normal(size=region.n_unknowns)
    assert (c @ np.concatenate([q[s.numbers] for s in subdomains]) == 0).all()
    # Entries are 0 and +-1 and chains are short: singular values lie above 2 sin(pi / 12) = 0.5.
    rank = np.linalg.matrix_rank(c, tol=0.1) if len(c) else 0
    assert rank == len(c)
    # With full rank, C q = 0 leaves as many as the whole problem has.
    assert c.shape[1] - rank == region.n_unknowns


def test_a_node_that_is_fixed_along_y_has_jumps_along_x_only() -> None:
    mesh = grid_mesh(2, 1, (4.0, 4.0))
    # Nodes 0, 3 are fixed along y; 1 and 4 are shared: two unknowns each.
    left, right = build_subdomains(fix_every_third_along_y(mesh), np.array([0, 1]), np.zeros(10, dtype=bool))
    assert left.numbers.tolist() == [0, 1, 2, 5, 6, 7]
    assert right.numbers.tolist() == [1, 2, 3, 4, 6, 7, 8, 9]
    assert left.numbers[left.jumps.unknowns].tolist() == [1, 2, 6, 7]
    assert left.n_owned_rows == 4
    # Three columns of nodes, every third of which is node 0, 3: with four columns, shared node 6 is one.
    wide = grid_mesh(3, 2, (4.0, 4.0))
    subdomains = build_subdomains(fix_every_third_along_y(wide), np.array([0, 0, 1, 2, 2, 2]), np.ones(20, dtype=bool))
    shared_at_6 = [s.kinematics.tangent[2 * int(np.searchsorted(s.node_ids, 6)) + 1].nnz for s in subdomains]
    assert shared_at_6 == [0, 0, 0]
    assert subdomains[0].node_multiplicity[np.searchsorted(subdomains[0].node_ids, 6)] == 3
