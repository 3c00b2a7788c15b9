"""Which camera measures which cell, and partitions that keep cameras apart."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import (
    add_motions,
    assign_cameras,
    find_cameras_at_nodes,
    keep_cameras_apart,
    split_by_camera,
)
from ddic.partition.ties import tie_meshes
from support.random_meshes import PARTITIONS, SEEDS, delaunay_meshes, grid_mesh, grid_meshes, random_partition

MESHES = st.one_of(grid_meshes(), delaunay_meshes())


def nodes_of(mesh: Mesh, cell: int) -> list[int]:
    return [int(n) for n in mesh.connectivity[mesh.offsets[cell]: mesh.offsets[cell + 1]]]


def random_labels(mesh: Mesh, n_cameras: int, seed: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(0, n_cameras, mesh.n_cells)


def evenly(cells: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """A split into runs of cells."""
    return np.arange(len(cells)) * n // len(cells)


@settings(max_examples=60)
@given(mesh=MESHES, n_near=st.integers(0, 3), share=st.floats(0.3, 1.0), seed=SEEDS)
def test_a_cell_is_of_the_first_near_camera_that_sees_all_its_nodes(mesh: Mesh, n_near: int, share: float,
                                                                    seed: int) -> None:
    seen = np.random.default_rng(seed).random((n_near, mesh.n_nodes)) < share
    labels = assign_cameras(mesh, list(seen))
    for cell in range(mesh.n_cells):
        whole = [k + 1 for k in range(n_near) if all(seen[k, n] for n in nodes_of(mesh, cell))]
        assert labels[cell] == (whole[0] if whole else 0)


@settings(max_examples=40)
@given(mesh=MESHES, n_cameras=st.integers(1, 4), seed=SEEDS)
def test_cameras_at_a_node_are_those_of_its_cells(mesh: Mesh, n_cameras: int, seed: int) -> None:
    labels = random_labels(mesh, n_cameras, seed)
    present = find_cameras_at_nodes(mesh, labels, n_cameras)
    expected: list[set[int]] = [set() for _ in range(mesh.n_nodes)]
    for cell in range(mesh.n_cells):
        for n in nodes_of(mesh, cell):
            expected[n].add(int(labels[cell]))
    assert [set(np.flatnonzero(row).tolist()) for row in present] == expected


@settings(max_examples=60)
@given(mesh=MESHES, n_cameras=st.integers(1, 4), n=st.integers(1, 9), seed=SEEDS)
def test_a_split_keeps_cameras_apart(mesh: Mesh, n_cameras: int, n: int, seed: int) -> None:
    labels = random_labels(mesh, n_cameras, seed)
    present = np.unique(labels)
    n = min(max(n, len(present)), mesh.n_cells)
    costs = np.random.default_rng(seed + 1).uniform(0.5, 20.0, mesh.n_cells)
    parts = split_by_camera(labels, costs, n, evenly)
    assert sorted(set(parts.tolist())) == list(range(n))
    camera_of_part = [set(labels[parts == s].tolist()) for s in range(n)]
    assert all(len(cameras) == 1 for cameras in camera_of_part)
    numbers = [cameras.pop() for cameras in camera_of_part]
    assert numbers == sorted(numbers)


@settings(max_examples=60)
@given(work=st.lists(st.integers(1, 40), min_size=1, max_size=4), more=st.integers(0, 5))
def test_counts_leave_the_least_largest_work(work: list[int], more: int) -> None:
    # Ten cells a camera, all alike: the split of cells does not limit the counts.
    labels = np.repeat(np.arange(len(work)), 10)
    n = len(work) + more
    parts = split_by_camera(labels, np.repeat(np.array(work) / 10, 10), n, evenly)
    found = [len(set(parts[labels == c].tolist())) for c in range(len(work))]
    best = min(max(w / k for w, k in zip(work, counts, strict=True))
               for counts in itertools.product(range(1, more + 2), repeat=len(work)) if sum(counts) == n)
    assert sum(found) == n
    assert max(w / k for w, k in zip(work, found, strict=True)) == pytest.approx(best, rel=1e-12)


def test_a_camera_gets_no_more_subdomains_than_it_has_cells() -> None:
    labels = np.array([0] * 12 + [1])
    parts = split_by_camera(labels, np.array([1.0] * 12 + [1000.0]), 6, evenly)
    assert [len(set(parts[labels == c].tolist())) for c in (0, 1)] == [5, 1]


def test_more_cameras_than_subdomains_are_refused() -> None:
    with pytest.raises(InputError, match=r"solver.subdomains = 2: 3 cameras.*at least 3"):
        split_by_camera(np.array([0, 1, 2, 0]), np.ones(4), 2, evenly)


@settings(max_examples=60)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 6), n_cameras=st.integers(1, 3), seed=SEEDS)
def test_a_given_partition_is_cut_where_the_camera_changes(mesh: Mesh, kind: str, n: int, n_cameras: int,
                                                           seed: int) -> None:
    labels, given_ = random_labels(mesh, n_cameras, seed), random_partition(mesh, kind, n, seed)
    parts = keep_cameras_apart(given_, labels)
    pairs = sorted({(int(c), int(p)) for c, p in zip(labels, given_, strict=True)})
    # One subdomain a pair, numbered by camera and then as given.
    assert [pairs[s] for s in parts] == [(int(c), int(p)) for c, p in zip(labels, given_, strict=True)]


@settings(max_examples=40)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 6),
       sizes=st.lists(st.sampled_from([0, 2, 3]), min_size=1, max_size=3), seed=SEEDS)
def test_subdomains_number_the_motions(mesh: Mesh, kind: str, n: int, sizes: list[int], seed: int) -> None:
    n_motion_unknowns = [0, *sizes]
    labels = random_labels(mesh, len(n_motion_unknowns), seed)
    parts = keep_cameras_apart(random_partition(mesh, kind, n, seed), labels)
    plain = [replace(s, camera=int(labels[s.cell_ids[0]]))
             for s in build_subdomains(NodalRegion(mesh), parts, np.ones(mesh.n_dofs, dtype=bool))]
    n_chains = sum(s.n_owned_rows for s in plain)
    found = add_motions(plain, [s.camera for s in plain], n_motion_unknowns, mesh.n_dofs, n_chains)
    # Whoever has them: the last ones get the same alone.
    alone = add_motions(plain[-1:], [s.camera for s in plain], n_motion_unknowns, mesh.n_dofs, n_chains)
    assert (alone[0].n_owned_rows, alone[0].numbers.tolist()) == (found[-1].n_owned_rows, found[-1].numbers.tolist())
    # All rows have an owner, those of the motions the last subdomain; numbers follow the field's, rows the chains.
    assert [s.n_owned_rows for s in found[:-1]] == [s.n_owned_rows for s in plain[:-1]]
    assert sum(s.n_owned_rows for s in found) == n_chains + sum(n_motion_unknowns)
    owners: dict[int, list[int]] = {}
    for part in found:
        assert {int(c) for c in labels[part.cell_ids]} == {part.camera}
        before, own = sum(n_motion_unknowns[:part.camera]), n_motion_unknowns[part.camera]
        assert (part.n_field, part.n_motion, part.n_unknowns) == (part.mesh.n_dofs, own, part.mesh.n_dofs + own)
        if own == 0:
            assert part.motion is None
            np.testing.assert_array_equal(part.numbers, part.kinematics.numbers)
            continue
        assert part.motion is not None
        assert part.motion.numbers.tolist() == [mesh.n_dofs + before + k for k in range(own)]
        assert part.motion.rows.tolist() == [n_chains + before + k for k in range(own)]
        assert part.motion.n_subdomains == sum(s.camera == part.camera for s in found)
        np.testing.assert_array_equal(part.numbers[-own:], part.motion.numbers)
        np.testing.assert_array_equal(part.all_multiplicity[-own:], part.motion.n_subdomains)
        owners.setdefault(part.camera, []).extend([part.index] if part.motion.owned else [])
    # One owner a camera, its lowest subdomain.
    assert owners == {c: [min(s.index for s in found if s.camera == c)] for c in owners}
    every = np.concatenate([s.numbers[s.owned] for s in found])
    assert len(every) == len(set(every.tolist()))
    assert set(every.tolist()) == set(np.concatenate([s.numbers for s in found]).tolist())


@settings(max_examples=20)
@given(mesh=MESHES, kind=PARTITIONS, n=st.integers(1, 6), seed=SEEDS)
def test_subdomains_know_which_nodes_are_said_to_be_inside(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    parts = random_partition(mesh, kind, n, seed)
    interior = np.random.default_rng(seed).random(mesh.n_nodes) < 0.5
    for part in build_subdomains(NodalRegion(mesh), parts, np.ones(mesh.n_dofs, dtype=bool), interior):
        np.testing.assert_array_equal(part.interior, interior[part.node_ids])


def test_only_nodes_among_far_cells_weigh_texture_against_mechanics() -> None:
    mesh = grid_mesh(4, 4, (10.0, 10.0))
    labels = np.zeros(16, dtype=np.int64)
    labels[5] = 1
    inside = ~find_cameras_at_nodes(mesh, labels, 2)[:, 1:].any(axis=1)
    far, near = build_subdomains(NodalRegion(mesh), labels, np.zeros(mesh.n_dofs, dtype=bool), inside)
    assert not near.interior.any()
    # The far cells have all nodes, four of them those of the near cell.
    assert far.interior.sum() == mesh.n_nodes - 4


def test_an_unknown_node_has_the_cameras_of_the_nodes_tied_to_it() -> None:
    far = build_structured_mesh((20, 20, 116, 116), 8)
    mesh, tying = tie_meshes(far, {1: build_structured_mesh((44, 36, 84, 76), 3.1)})
    at_nodes = find_cameras_at_nodes(mesh, tying.cameras, 2)
    at_unknown_nodes = find_cameras_at_nodes(mesh, tying.cameras, 2, tying.weights)
    weights = tying.weights.toarray()
    assert at_unknown_nodes.shape == (tying.n_unknown_nodes, 2)
    for node in range(tying.n_unknown_nodes):
        np.testing.assert_array_equal(at_unknown_nodes[node], at_nodes[weights[:, node] != 0].any(axis=0))
    # Masters on the common boundary have both cameras.
    masters = np.unique(tying.weights[tying.n_unknown_nodes:].indices)
    assert at_unknown_nodes[masters].all()
