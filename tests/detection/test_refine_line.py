"""A line moved, turned and bent by the residuals of its sides."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.support.opened_pair import Opened, render
from ddic.detection.lines_of_case import LEAST_FALL
from ddic.detection.refine_line import UncertainLine, _Segment, find_move, refine_line
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.structured import build_structured_mesh
from ddic.start.coarse_displacement import CutField
from ddic.start.independent import Images
from support.pictures import source

SIDE = 256
MESH = build_structured_mesh((16.0, 16.0, 240.0, 240.0), 16.0)
STRAIGHT = np.array([[-40.0, 100.3], [300.0, 161.7]])
BENT = np.array([[-40.0, 90.3], [131.2, 150.4], [300.0, 97.7]])
JUMP = np.array([1.1, -0.8])
"""Of the left side, above in the image. The sides part: where they overlap, either may be seen."""


@cache
def _render(bent: bool, jumps: bool) -> Images:
    opened = Opened((BENT if bent else STRAIGHT,), (JUMP * jumps,))
    pair = render(opened, SIDE, noise=1.0, bits=8)
    return Images(source(pair[0]), source(pair[1]), np.ones((SIDE, SIDE), np.uint8), 3, "none")


def uncertain(line: NDArray[np.float64]) -> UncertainLine:
    return UncertainLine(Discontinuities((line,), ("both",)), 0, 3.0)


@pytest.mark.parametrize(("bent", "moves"), [(False, [2.0, 2.0]), (False, [-4.0, 5.0]), (True, [2.0, 2.0, 2.0]),
                                             (True, [-3.0, 1.5, 3.0])])
def test_ends_and_bends_are_found(bent: bool, moves: list[float]) -> None:
    line = BENT if bent else STRAIGHT
    given = line + np.array(moves)[:, None] * np.array([0.0, 1.0])
    start = CutField(MESH, np.zeros(MESH.nodes.shape))
    found = refine_line(_render(bent, True), MESH, start, uncertain(given), 0.25).line
    # Inside the mesh. One pixel of 250 along the line decides at a time; a bend is known from what is about it.
    columns = np.linspace(16.0, 240.0, 100)
    away = np.interp(columns, *found.T) - np.interp(columns, *line.T)
    assert np.sqrt((away**2).mean()) < 0.2
    assert np.abs(away).max() < 0.5


def test_a_line_that_does_not_open_is_not_moved() -> None:
    cut = cut_mesh(MESH, [STRAIGHT])
    move = find_move(_render(False, False), cut, np.zeros(cut.mesh.nodes.shape), uncertain(STRAIGHT))
    assert move.distance == 0.0
    # Sides that part by what noise leaves in coarse elements tell nothing either.
    noise = np.random.default_rng(0).normal(0.0, 0.02, cut.mesh.nodes.shape)
    assert find_move(_render(False, False), cut, noise, uncertain(STRAIGHT)).fall < LEAST_FALL


def test_a_line_along_nodes_is_moved_like_any_other() -> None:
    """The mesh is cut a little beside the nodes, in parts thinner than that."""
    real, along_nodes = (np.array([[-40.0, height], [300.0, height]]) for height in (130.0, 128.0))
    opened = Opened((real,), (JUMP,))
    pair = render(opened, SIDE, noise=1.0, bits=8)
    images = Images(source(pair[0]), source(pair[1]), np.ones((SIDE, SIDE), np.uint8), 3, "none")
    cut = cut_mesh(MESH, [along_nodes])
    sides = Opened((cut.lines[0],), (JUMP,))
    move = find_move(images, cut, sides.displacement(find_points_on_own_side(cut.mesh)), uncertain(along_nodes))
    # Pixels are a pixel apart across it.
    np.testing.assert_allclose(move.line[:, 1], 130.0, atol=0.5)


@pytest.mark.parametrize(("height", "counts"), [(-4.5, [0.0, 0.0]), (-1.5, [0.0, 0.0]), (0.5, [0.0, 1.0]),
                                                (2.99, [1.0, 1.0]), (3.5, [1.0, 1.0]), (9.0, [1.0, 1.0])])
def test_a_pixel_counts_above_lines_that_are_lower(height: float, counts: list[float]) -> None:
    """Also beyond both ends of what is searched, here 3 px."""
    one, middle = np.ones(1), np.full(1, 0.5)
    segment = _Segment.tabulate(one, one, middle, np.array([height]), (3.0, False, False))
    costs = segment.costs.sum(axis=0)
    # From -3 px on, in steps of 0.05 px, to an edge of its bin: at -0.5 px, and at -0.525 for what is above it.
    np.testing.assert_allclose([costs[60 + 30], costs[60 - 12]], counts, atol=0.01)


def test_a_line_in_its_place_stays() -> None:
    cut = cut_mesh(MESH, [BENT])
    assert cut.mesh.parts is not None
    sides = Opened((BENT,), (JUMP,))
    own = find_points_on_own_side(cut.mesh)
    move = find_move(_render(True, True), cut, sides.displacement(own), uncertain(BENT))
    assert move.distance < 0.25
