"""What an earlier result says of nodes, also where it measured nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.io.result_reader import Result, displacement_at, evaluate_on_sides
from ddic.start.given_start import EarlierResult
from support.pictures import square_mesh

Array = NDArray[np.float64]

MESH = square_mesh(0.0, 96.0)
"""6 x 6 cells of 16 px."""

UNMEASURED = np.flatnonzero((MESH.nodes == 48.0).all(axis=1))
"""The node in the middle."""


def _move(points: Array) -> Array:
    """An affine map, which bilinear cells hold exactly."""
    return np.array([3.0, -2.0]) + points @ np.array([[0.01, 0.002], [-0.004, 0.02]])


def _result(unmeasured: NDArray[np.int64]) -> Result:
    displacement = _move(MESH.nodes)
    displacement[unmeasured] = np.nan
    cells = np.zeros(MESH.n_cells, dtype=np.int64)
    return Result(Path(), MESH, displacement, {}, {}, cells, {}, (), {}, flipped=False)


def test_what_is_known_lies_in_measured_cells() -> None:
    points = np.array([[48.0, 48.0], [50.0, 45.0], [48.0, 40.0], [48.0, 32.0], [56.0, 32.0], [70.0, 20.0], [99.0, 9.0]])
    values, known = EarlierResult(_result(UNMEASURED), "r").evaluate(points, points)
    # The node, two points of its cells, then points on their other nodes and edges, in another cell, and outside.
    assert known.tolist() == [False, False, False, True, True, True, False]
    # Sums of four products of numbers up to 5.
    np.testing.assert_allclose(values[known], _move(points[known]), rtol=0, atol=1e-13)
    assert (values[~known] == 0.0).all()


def test_a_slope_is_not_taken_from_a_cell_that_was_not_measured_whole() -> None:
    # On the edge between two measured nodes: one of its two cells is found, and tells the slope.
    on_own_side, node = np.array([[40.0, 32.0]]), np.array([[40.0, 36.0]])
    found = []
    for row in (16.0, 48.0):
        values, known = EarlierResult(_result(np.flatnonzero(MESH.nodes[:, 1] == row)), "r").evaluate(on_own_side, node)
        assert np.isfinite(values).all()
        np.testing.assert_allclose(values[known], _move(node[known]), rtol=0, atol=1e-13)
        found.append(bool(known[0]))
    assert sorted(found) == [False, True]


def test_without_unmeasured_nodes_every_digit_stays() -> None:
    result = _result(np.zeros(0, dtype=np.int64))
    random = np.random.default_rng(0)
    on_own_side = random.uniform(-10.0, 106.0, (200, 2))
    nodes = on_own_side + random.choice([0.0, 1.5], (200, 1))
    is_inside = ((on_own_side >= 0.0) & (on_own_side <= 96.0)).all(axis=1)
    values, known = EarlierResult(result, "r").evaluate(on_own_side, nodes)
    np.testing.assert_array_equal(known, is_inside)
    np.testing.assert_array_equal(values[known], evaluate_on_sides(result, on_own_side[known], nodes[known]))


def test_a_guess_is_a_number_everywhere() -> None:
    points = np.array([[48.0, 48.0], [50.0, 45.0], [120.0, 48.0]])
    guessed = displacement_at(_result(UNMEASURED), points)
    # Between measured nodes an affine map is interpolated exactly; outside their hull the nearest stands in.
    np.testing.assert_allclose(guessed[:2], _move(points[:2]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(guessed[2], _move(np.array([[96.0, 48.0]]))[0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("first", [0, 1])
def test_nothing_is_known_of_a_result_without_a_number(first: int) -> None:
    points = np.array([[48.0, 48.0], [200.0, 0.0]])
    values, known = EarlierResult(_result(np.arange(first, MESH.n_nodes)), "r").evaluate(points, points)
    assert not known.any()
    assert (values == 0.0).all()
