"""The mortar integral: what it keeps, and what it is where that is known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.mesh.mortar import Mortar, Overlaps, Sides, find_overlaps, integrate_mortar
from support.random_meshes import SEEDS

Array = NDArray[np.float64]

# A corner more, an angle less: lines with several sides, open or closed.
OPEN = np.array([[10.0, 12.0], [60.0, 20.0], [64.0, 71.0], [20.0, 80.0]])
CLOSED = np.array([[10.0, 12.0], [60.0, 20.0], [64.0, 71.0], [20.0, 80.0], [10.0, 12.0]])
CORNERS = st.sampled_from([OPEN[:2], OPEN, CLOSED])


def line(corners: Array, counts: list[int], seed: int) -> tuple[Array, NDArray[np.int64]]:
    """Nodes at random along a line with nodes at its corners, and edges, in any order and either way."""
    rng = np.random.default_rng(seed)
    points = [corners[:1]]
    for k, n in enumerate(counts[:len(corners) - 1]):
        # Apart by a hundredth of the side: no cell of a mesh is thinner.
        share = np.cumsum(rng.uniform(0.05, 1.0, n + 1))
        points.append(corners[k] + (share / share[-1])[:, None] * (corners[k + 1] - corners[k]))
        points[-1][-1] = corners[k + 1]
    nodes = np.concatenate(points)
    edges = np.stack([np.arange(len(nodes) - 1), np.arange(1, len(nodes))], axis=1)
    if np.array_equal(corners[0], corners[-1]):
        nodes, edges = nodes[:-1], edges % (len(nodes) - 1)
    place = rng.permutation(len(nodes))
    edges = place[edges][rng.permutation(len(edges))]
    turned = rng.random(len(edges)) < 0.5
    edges[turned] = edges[turned][:, ::-1]
    return nodes[np.argsort(place)], edges.astype(np.int64)


def tied(far: tuple[Array, NDArray[np.int64]], near: tuple[Array, NDArray[np.int64]]) -> tuple[Mortar, Overlaps]:
    sides = Sides(*far, *near, 1e-6)
    pieces = find_overlaps(sides)
    return integrate_mortar(sides, pieces), pieces


@settings(max_examples=100)
@given(corners=CORNERS, far_counts=st.lists(st.integers(0, 6), min_size=4, max_size=4),
       near_counts=st.lists(st.integers(0, 12), min_size=4, max_size=4), seed=SEEDS)
def test_constants_and_linear_fields_are_kept(corners: Array, far_counts: list[int], near_counts: list[int],
                                              seed: int) -> None:
    far, near = line(corners, far_counts, seed), line(corners, near_counts, seed + 1)
    found, pieces = tied(far, near)
    assert found.slaves.tolist() == list(range(len(near[0])))
    np.testing.assert_allclose(pieces.measure_far_cover(len(far[1])), 1.0, atol=1e-12)
    np.testing.assert_allclose(pieces.measure_near_cover(len(near[1])), 1.0, atol=1e-12)
    # Rounding of a few sums of numbers up to 1, and of positions up to 80.
    assert np.abs(found.weights.sum(axis=1) - 1.0).max() <= 1e-13
    assert np.abs(found.weights @ far[0] - near[0]).max() <= 1e-13 * 80


@settings(max_examples=50)
@given(corners=CORNERS, far_counts=st.lists(st.integers(0, 6), min_size=4, max_size=4),
       near_counts=st.lists(st.integers(0, 12), min_size=4, max_size=4), seed=SEEDS)
def test_the_jump_is_orthogonal_to_multipliers(corners: Array, far_counts: list[int], near_counts: list[int],
                                               seed: int) -> None:
    """Integrals of the jump of any field, by a rule of points far finer than the pieces."""
    far, near = line(corners, far_counts, seed), line(corners, near_counts, seed + 1)
    found, _ = tied(far, near)
    v = np.random.default_rng(seed).normal(size=len(far[0]))
    u = np.asarray(found.weights @ v)
    ends = (np.linalg.norm(near[0][:, None] - corners[None], axis=2) < 1e-9).any(axis=1)
    point, weight = np.polynomial.legendre.leggauss(2)
    moments = np.zeros(len(u))
    for a, b in near[1]:
        span = near[0][b] - near[0][a]
        along = [((far[0][k] - near[0][a]) @ span / (span @ span)) for k in range(len(far[0]))]
        cuts = np.unique(np.clip([0.0, 1.0, *along], 0, 1))
        for low, high in pairwise(cuts):
            for p, w in zip(point, weight, strict=True):
                t = low + (high - low) * (p + 1) / 2
                jump = (1 - t) * u[a] + t * u[b] - value_at(far, v, near[0][a] + t * span)
                psi = {a: 2 - 3 * t, b: 3 * t - 1} if not (ends[a] or ends[b]) else {a: 1.0, b: 1.0}
                for node, value in psi.items():
                    moments[node] += w * (high - low) / 2 * np.linalg.norm(span) * value * jump
    assert np.abs(moments[~ends]).max(initial=0.0) <= 1e-10


def value_at(far: tuple[Array, NDArray[np.int64]], v: Array, x: Array) -> float:
    """Of a far field at a point of the line: on the nearest edge."""
    best = (np.inf, 0.0)
    for a, b in far[1]:
        span = far[0][b] - far[0][a]
        t = float(np.clip((x - far[0][a]) @ span / (span @ span), 0, 1))
        best = min(best, (float(np.linalg.norm(far[0][a] + t * span - x)), float((1 - t) * v[a] + t * v[b])))
    return best[1]


@pytest.mark.parametrize("corners", [OPEN, CLOSED])
def test_nodes_that_coincide_are_tied_one_to_one(corners: Array) -> None:
    far = line(corners, [4, 3, 5, 2], 3)
    order = np.random.default_rng(1).permutation(len(far[0]))
    found, _ = tied(far, (far[0][order], np.argsort(order)[far[1]]))
    np.testing.assert_array_equal(found.weights.indices, order)
    np.testing.assert_allclose(found.weights.data, 1.0, rtol=0, atol=4e-16)


@pytest.mark.parametrize("corners", [OPEN, CLOSED])
def test_a_refined_line_interpolates(corners: Array) -> None:
    far = line(corners, [4, 3, 5, 2], 3)
    thirds = [far[0][far[1][:, 0]] + s * (far[0][far[1][:, 1]] - far[0][far[1][:, 0]]) for s in (1 / 3, 2 / 3)]
    n, m = len(far[0]), len(far[1])
    inner = n + np.arange(2 * m).reshape(2, m)
    chain = [far[1][:, 0], inner[0], inner[1], far[1][:, 1]]
    edges = np.concatenate([np.stack(pair, axis=1) for pair in pairwise(chain)])
    found, _ = tied(far, (np.concatenate([far[0], *thirds]), edges))
    expected = np.zeros((n + 2 * m, n))
    expected[np.arange(n), np.arange(n)] = 1.0
    for k, share in enumerate((1 / 3, 2 / 3)):
        expected[inner[k], far[1][:, 0]] = 1 - share
        expected[inner[k], far[1][:, 1]] = share
    np.testing.assert_allclose(found.weights.toarray(), expected, atol=1e-14)


def test_edges_that_cross_or_run_beside_do_not_overlap() -> None:
    near = np.array([[0.0, 0.0], [10.0, 0.0]])
    far = np.array([[5.0, -3.0], [5.0, 3.0], [0.0, 1e-3], [10.0, 1e-3], [10.0, 0.0], [20.0, 0.0], [2.0, 0.0],
                    [2.0, 9.0]])
    edges = np.arange(8).reshape(4, 2)
    found = find_overlaps(Sides(far, edges, near, np.array([[0, 1]]), 1e-4))
    assert len(found.near) == 0
