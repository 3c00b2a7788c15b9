"""Which subdomains share which unknowns, and the numbering of the interface rows."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.kinematics.nodal import NodalRegion, component_numbers
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Interface, Subdomain
from support.interfaces import check_numbering, stack_jumps
from support.random_meshes import PARTITIONS, SEEDS, delaunay_meshes, grid_mesh, grid_meshes, random_partition

MESHES = st.one_of(grid_meshes(most=4), delaunay_meshes())


def cut(mesh: Mesh, kind: str, n: int, seed: int) -> tuple[list[Subdomain], NDArray[np.int64], NDArray[np.bool_]]:
    parts = random_partition(mesh, kind, n, seed)
    controlled = np.random.default_rng(seed).random(mesh.n_dofs) < 0.6
    return build_subdomains(NodalRegion(mesh), parts, controlled), parts, controlled


def sharers(mesh: Mesh, parts: NDArray[np.int64]) -> dict[int, list[int]]:
    """Subdomains at each node, by going through the cells."""
    found: dict[int, set[int]] = defaultdict(set)
    for e in range(mesh.n_cells):
        for node in mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]:
            found[int(node)].add(int(parts[e]))
    return {node: sorted(of) for node, of in found.items()}


@settings(max_examples=60)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 6), seed=SEEDS)
def test_subdomains_hold_their_cells_and_what_belongs_to_them(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    subdomains, parts, controlled = cut(mesh, kind, n, seed)
    shared = sharers(mesh, parts)
    on_boundary = set(find_boundary_nodes(mesh).tolist())
    assert [s.index for s in subdomains] == list(range(int(parts.max()) + 1))
    for s in subdomains:
        assert s.cell_ids.tolist() == np.flatnonzero(parts == s.index).tolist()
        np.testing.assert_array_equal(s.mesh.nodes, mesh.nodes[s.node_ids])
        np.testing.assert_array_equal(s.node_ids[s.mesh.connectivity], np.concatenate(
            [mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]] for e in s.cell_ids]))
        assert s.node_multiplicity.tolist() == [len(shared[int(node)]) for node in s.node_ids]
        assert s.interior.tolist() == [int(node) not in on_boundary for node in s.node_ids]
        np.testing.assert_array_equal(s.numbers, component_numbers(s.node_ids, 2))
        np.testing.assert_array_equal(s.controlled, controlled[s.numbers])
        np.testing.assert_array_equal(s.multiplicity, np.repeat(s.node_multiplicity, 2))


@settings(max_examples=60)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 6), seed=SEEDS)
def test_an_unknown_of_m_subdomains_has_m_minus_one_rows(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    subdomains, parts, controlled = cut(mesh, kind, n, seed)
    shared = sharers(mesh, parts)
    check_numbering(subdomains, {2 * node + i: of for node, of in shared.items() for i in (0, 1)}, controlled)


@settings(max_examples=60)
@given(mesh=grid_meshes(most=4), kind=PARTITIONS, n=st.integers(1, 6), seed=SEEDS)
def test_kernel_of_the_jumps_are_the_continuous_fields(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    subdomains, _, _ = cut(mesh, kind, n, seed)
    c = stack_jumps(subdomains)
    u = np.random.default_rng(seed).normal(size=mesh.n_dofs)
    assert (c @ np.concatenate([u[s.numbers] for s in subdomains]) == 0).all()
    used = np.abs(c).sum(axis=1) > 0
    n_rows = int(used.sum())
    # Entries are 0 and +-1 and chains are short: singular values lie above 2 sin(pi / 12) = 0.5.
    rank = np.linalg.matrix_rank(c, tol=0.1) if n_rows else 0
    assert rank == n_rows
    # With full rank, C u = 0 leaves as many fields as the mesh has dofs: the continuous ones.
    assert c.shape[1] - rank == mesh.n_dofs


def test_rows_are_differences_along_the_chain() -> None:
    mesh = grid_mesh(2, 2, (4.0, 4.0))
    subdomains = build_subdomains(NodalRegion(mesh), np.array([2, 0, 3, 1]), np.ones(18, dtype=bool))
    values = [np.full(s.mesh.n_dofs, 10.0 ** s.index) for s in subdomains]
    jumps = stack_jumps(subdomains) @ np.concatenate(values)
    centre: Interface = subdomains[0].jumps
    at_centre = np.flatnonzero(centre.multiplicity == 4)[0]
    first = centre.first_row[at_centre]
    assert jumps[first: first + 3].tolist() == [1 - 10, 10 - 100, 100 - 1000]


def test_no_reaction_rows_where_nothing_is_controlled() -> None:
    mesh = grid_mesh(4, 4, (4.0, 4.0))
    for s in build_subdomains(NodalRegion(mesh), np.arange(16) % 4, np.zeros(mesh.n_dofs, dtype=bool)):
        assert len(s.reactions.unknowns) == 0
        assert len(s.jumps.unknowns) > 0


def test_one_subdomain_has_no_interface() -> None:
    mesh = grid_mesh(3, 3, (4.0, 4.0))
    (only,) = build_subdomains(NodalRegion(mesh), np.zeros(9, dtype=np.int64), np.ones(mesh.n_dofs, dtype=bool))
    assert (only.n_owned_rows, only.n_owned_copies, len(only.jumps.unknowns)) == (0, 0, 0)
