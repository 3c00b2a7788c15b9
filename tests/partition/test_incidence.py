"""Plain and scaled incidence of copies in rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Interface, Subdomain, copies_of, rows_of, scaled_incidence, signed_incidence
from support.random_meshes import PARTITIONS, SEEDS, grid_mesh, grid_meshes, random_partition

KINDS: tuple[Callable[[Subdomain], Interface], ...] = (lambda s: s.jumps, lambda s: s.reactions)


def cut(mesh: Mesh, kind: str, n: int, seed: int) -> list[Subdomain]:
    parts = random_partition(mesh, kind, n, seed)
    return build_subdomains(NodalRegion(mesh), parts, np.random.default_rng(seed).random(mesh.n_dofs) < 0.6)


def both(subdomains: list[Subdomain], d: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """B, E (n_rows, n_copies) with columns by copy number; d: weights by copy."""
    n_rows, n_copies = sum(s.n_owned_rows for s in subdomains), sum(s.n_owned_copies for s in subdomains)
    plain, scaled = np.zeros((n_rows, n_copies)), np.zeros((n_rows, n_copies))
    for s in subdomains:
        for interface in (kind(s) for kind in KINDS):
            copy = interface.first_copy + interface.position
            assert (plain[:, copy] == 0).all()
            plain[:, copy] = signed_incidence(interface, np.arange(n_rows)).toarray()
            scaled[:, copy] = scaled_incidence(interface, d, np.arange(n_copies), np.arange(n_rows)).toarray()
    return plain, scaled


def weights(subdomains: list[Subdomain], seed: int) -> NDArray[np.float64]:
    n_copies = sum(s.n_owned_copies for s in subdomains)
    # Neighbours differ by orders of magnitude, as near and far fields do.
    return 10.0 ** np.random.default_rng(seed).uniform(-4, 4, n_copies)


@settings(max_examples=50)
@given(mesh=grid_meshes(most=4), kind=PARTITIONS, n=st.integers(2, 6), seed=SEEDS)
def test_scaled_incidence_is_a_right_inverse_for_all_weights(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    subdomains = cut(mesh, kind, n, seed)
    plain, scaled = both(subdomains, weights(subdomains, seed))
    # Differences of shares between 0 and 1.
    np.testing.assert_allclose(plain @ scaled.T, np.eye(len(plain)), atol=1e-14)


@settings(max_examples=50)
@given(mesh=grid_meshes(most=4), kind=PARTITIONS, n=st.integers(2, 6), seed=SEEDS)
def test_scaled_incidence_gives_the_least_weighted_norm(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    subdomains = cut(mesh, kind, n, seed)
    d = weights(subdomains, seed)
    plain, scaled = both(subdomains, d)
    w = scaled.T @ np.random.default_rng(seed).normal(size=len(plain))
    # B w = v with least w^T D w if and only if D w lies in the range of B^T: it sums to zero on every chain,
    # and the chains' indicators are the orthogonal complement of that range.
    for s in subdomains:
        for interface in (kind(s) for kind in KINDS):
            for first, m in zip(interface.first_copy, interface.multiplicity, strict=True):
                balance = (d * w)[first: first + m]
                # Shares are rounded to 1e-16, times the largest weight.
                assert abs(balance.sum()) <= 1e-13 * d[first: first + m].max() * (np.abs(w).max() + 1)


@settings(max_examples=30)
@given(mesh=grid_meshes(most=3), kind=PARTITIONS, n=st.integers(2, 6), seed=SEEDS)
def test_scaled_incidence_equals_the_dense_formula(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    subdomains = cut(mesh, kind, n, seed)
    d = np.random.default_rng(seed).uniform(0.5, 2.0, sum(s.n_owned_copies for s in subdomains))
    plain, scaled = both(subdomains, d)
    if len(plain) == 0:
        return
    expected = np.linalg.solve(plain / d @ plain.T, plain / d)
    # Condition number of a chain of at most six copies: below a hundred.
    np.testing.assert_allclose(scaled, expected, atol=1e-13)


@settings(max_examples=30)
@given(mesh=grid_meshes(most=4), kind=PARTITIONS, n=st.integers(2, 6), seed=SEEDS)
def test_a_subdomains_own_rows_and_copies_suffice(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    subdomains = cut(mesh, kind, n, seed)
    d = weights(subdomains, seed)
    n_rows = sum(s.n_owned_rows for s in subdomains)
    for s in subdomains:
        for interface in (kind(s) for kind in KINDS):
            rows, copies = np.sort(rows_of(interface)), np.sort(copies_of(interface))
            plain = signed_incidence(interface, rows).toarray()
            scaled = scaled_incidence(interface, d[copies], copies, rows).toarray()
            whole = signed_incidence(interface, np.arange(n_rows)).toarray()
            np.testing.assert_array_equal(plain, whole[rows])
            assert np.abs(whole).sum() == np.abs(plain).sum()
            all_weights = scaled_incidence(interface, d, np.arange(len(d)), np.arange(n_rows)).toarray()
            np.testing.assert_array_equal(scaled, all_weights[rows])


def test_rows_and_copies_of_a_cross_point() -> None:
    mesh = grid_mesh(2, 2, (4.0, 4.0))
    subdomains = build_subdomains(NodalRegion(mesh), np.arange(4), np.zeros(18, dtype=bool))
    # Per direction: four sides with one row and two copies, the centre with three rows and four copies.
    assert sum(s.n_owned_rows for s in subdomains) == 2 * (4 + 3)
    assert sum(s.n_owned_copies for s in subdomains) == 2 * (4 * 2 + 4)
    for s in subdomains:
        assert len(set(rows_of(s.jumps).tolist())) == 2 * (2 + 3)
        assert len(set(copies_of(s.jumps).tolist())) == 2 * (2 * 2 + 4)


def test_equal_weights_share_a_jump_of_two_by_halves() -> None:
    mesh = grid_mesh(2, 1, (4.0, 4.0))
    left, right = build_subdomains(NodalRegion(mesh), np.array([0, 1]), np.zeros(12, dtype=bool))
    for s, share in ((left, 0.5), (right, -0.5)):
        found = scaled_incidence(s.jumps, np.ones(8), np.arange(8), np.arange(4)).toarray()
        np.testing.assert_array_equal(found, share * np.eye(4))


def test_no_interface_gives_empty_matrices() -> None:
    mesh = grid_mesh(2, 2, (4.0, 4.0))
    (only,) = build_subdomains(NodalRegion(mesh), np.zeros(4, dtype=np.int64), np.ones(18, dtype=bool))
    nothing = np.zeros(0, dtype=np.int64)
    assert signed_incidence(only.jumps, nothing).shape == (0, 0)
    assert scaled_incidence(only.jumps, np.zeros(0), nothing, nothing).shape == (0, 0)
    assert rows_of(only.jumps).tolist() == copies_of(only.jumps).tolist() == []


def test_a_subdomains_matrices_hold_nothing_for_rows_of_others() -> None:
    # The rows here are those of all subdomains of a rank: an array of their number for each would be their square.
    s = build_subdomains(NodalRegion(grid_mesh(2, 2, (4.0, 4.0))), np.arange(4), np.zeros(18, dtype=bool))[0]
    every_row, n_copies = np.arange(100_000), 2 * (4 * 2 + 4)
    for matrix in (signed_incidence(s.jumps, every_row),
                   scaled_incidence(s.jumps, np.ones(n_copies), np.arange(n_copies), every_row)):
        assert max(len(array) for array in (matrix.data, matrix.indices, matrix.indptr)) < 1000
