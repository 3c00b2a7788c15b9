"""Lines joined where they end at each other, and found one after the other."""

from __future__ import annotations

import json
from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ddic
from bench.support.opened_pair import Opened, render
from ddic.arrays import Array
from ddic.detection.find_lines import BEYOND, OpenLine, _Search, join_lines
from ddic.detection.refine_line import LineEvidence
from ddic.detection.strain_band import StrainBand

EDGE = -1
CORNER, OTHER_CORNER = np.array([5.0, 0.0]), np.array([5.0, 8.0])


def line(start: Array, end: Array, ends: tuple[tuple[int, int], tuple[int, int]]) -> OpenLine:
    return OpenLine(np.array([start, end], float), ends)


@pytest.mark.parametrize("is_reversed", [False, True])
def test_two_lines_that_end_at_each_other_are_one_that_bends(is_reversed: bool) -> None:
    first = line(np.zeros(2), CORNER, ((0, EDGE), (0, 1)))
    second = line(CORNER, np.array([9.0, 9.0]), ((1, 0), (1, EDGE)))
    (bent,) = join_lines([first, second.reverse if is_reversed else second])
    vertices = bent.list_vertices()
    np.testing.assert_array_equal(vertices if vertices[0, 0] == 0.0 else vertices[::-1], [[0, 0], CORNER, [9, 9]])


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_three_lines_make_one_of_three_pieces_in_whatever_order(order: tuple[int, ...]) -> None:
    lines = [line(np.zeros(2), CORNER, ((0, EDGE), (0, 1))), line(CORNER, OTHER_CORNER, ((1, 0), (1, 2))),
             line(OTHER_CORNER, np.array([20.0, 8.0]), ((2, 1), (2, EDGE)))]
    (bent,) = join_lines([lines[k] for k in order])
    vertices = bent.list_vertices()
    expected = np.array([[0, 0], CORNER, OTHER_CORNER, [20, 8]])
    np.testing.assert_array_equal(vertices if vertices[0, 0] == 0.0 else vertices[::-1], expected)


def test_a_line_that_ends_at_one_that_goes_on_reaches_a_little_beyond_it() -> None:
    through = line(np.array([5.0, -10.0]), np.array([5.0, 10.0]), ((0, EDGE), (0, EDGE)))
    ends_there = line(np.zeros(2), CORNER, ((1, EDGE), (1, 0)))
    joined = join_lines([through, ends_there])
    assert len(joined) == 2
    np.testing.assert_allclose(joined[1].list_vertices(), [[0, 0], CORNER + np.array([BEYOND, 0.0])])


def test_lines_around_a_triangle_stay_three() -> None:
    """Each ends at both others: nothing is joined to itself."""
    a, b, c = np.array([[0.0, 0.0], [9.0, 0.0], [4.0, 7.0]])
    joined = join_lines([line(a, b, ((0, 2), (0, 1))), line(b, c, ((1, 0), (1, 2))), line(c, a, ((2, 1), (2, 0)))])
    assert sum(len(one.vertices) - 1 for one in joined) == 3


@pytest.mark.parametrize(("again", "is_taken", "told"), [([1, 1], True, "leaves 1 found before"),
                                                         ([1, 0], False, "no line explains more than chance")])
def test_a_line_that_leaves_one_before_it_nothing_takes_its_place(monkeypatch: pytest.MonkeyPatch, again: list[int],
                                                                  is_taken: bool, told: str) -> None:
    """Measured again without that one, all that stay must explain more than chance: else nothing changes."""
    def straight(n_open: int) -> Any:
        at_rest = LineEvidence(1.0, 1.0, 100, 1.0)
        return SimpleNamespace(line=np.zeros((2, 2)), score=9.0, evidence=[at_rest], open_pieces=np.arange(n_open))

    rounds = iter([[1, 0, 1], again])
    monkeypatch.setattr(_Search, "_refine", lambda search, bands: [straight(n) for n in next(rounds)])
    before = [straight(1), straight(1)]
    # Nothing of the images is asked for.
    found, note = object.__new__(_Search)._try_line(before, StrainBand(np.zeros((2, 2)), 9.0))
    assert len(found) == 2
    assert (found is not before) == is_taken
    assert told in note


SIDE, MIDDLE = 400, np.array([200.0, 200.0])
MESH = ddic.structured_mesh((16, 16, 384, 384), 16)
JUMP = 0.9


def across(angle: float, height: float) -> Array:
    """A line across the image, some pixels from its middle."""
    along, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    return np.stack([MIDDLE + height * normal - 700 * along, MIDDLE + height * normal + 700 * along])


def find(opened: Opened) -> list[Array]:
    pair = render(opened, SIDE, noise=1.0, speckle=1.0)
    result = ddic.measure(pair, MESH, discontinuity="detect", solver={"method": "monolithic"})
    return [np.array(section["vertices"]) for section in json.loads(result.attributes["case"]["json"])["discontinuity"]]


def measure_distance(found: Array, known: Array) -> float:
    """Largest distance of a straight piece's ends, as far as the mesh reaches, from another one's line."""
    along = (known[-1] - known[0]) / np.linalg.norm(known[-1] - known[0])
    points = found[0] + np.linspace(0, 1, 200)[:, None] * (found[1] - found[0])
    inside = points[((points >= 16) & (points <= 384)).all(axis=1)]
    return float(np.abs((inside - known[0]) @ np.array([-along[1], along[0]])).max())


def test_two_lines_that_cross_are_found() -> None:
    angles, heights = (0.4, 1.9), (10.0, -15.0)
    lines = tuple(across(angle, height) for angle, height in zip(angles, heights, strict=True))
    jumps = tuple(JUMP * np.array([np.cos(angle), np.sin(angle)]) for angle in angles)
    found = find(Opened(lines, jumps))
    assert len(found) == 2
    for known in lines:
        # Half a pixel at the ends of lines of 23 elements: some 350 pixels tell each place.
        assert min(measure_distance(one, known) for one in found) < 0.5


def test_a_bend_is_found() -> None:
    bend = MIDDLE + np.array([8.0, -5.0])
    line = np.stack([bend - np.array([600.0, 150.0]), bend, bend + np.array([350.0, 420.0])])
    (found,) = find(Opened((line,), (np.array([0.7, -0.6]),)))
    assert len(found) == 3
    order = 1 if found[0, 0] < found[-1, 0] else -1
    for piece, known in zip((found[::order][:2], found[::order][1:]), (line[:2], line[1:]), strict=True):
        assert measure_distance(piece, known) < 0.5


def test_a_line_that_ends_at_another_one_is_found() -> None:
    through, ends_there = across(0.3, 0.0), across(1.7, 12.0)
    tangents = [(one[1] - one[0]) / np.linalg.norm(one[1] - one[0]) for one in (through, ends_there)]

    class EndsThere(Opened):
        def displacement(self, points: Array, sides: Array | None = None) -> Array:
            first, second = (self.find_sides(points) if sides is None else sides).T
            return np.asarray(first[:, None] * self.jumps[0] + (first * second)[:, None] * self.jumps[1])

    # The part moves away from the other side of the line that goes on: nothing overlaps.
    found = find(EndsThere((through, ends_there), (JUMP * tangents[0], -JUMP * tangents[1])))
    assert len(found) == 2
    assert all(len(one) == 2 for one in found)
    # Beside the part the line that goes on has a gap of 0.9 px, in which neither side's place is told.
    (whole,), (part,) = ([one for one in found if measure_distance(one, known) < 0.7] for known in
                         (through, ends_there))
    at = [float(abs((end - through[0]) @ np.array([-tangents[0][1], tangents[0][0]]))) for end in part]
    assert min(at) < 1.0
    assert max(at) > 50.0
    assert np.linalg.norm(whole[1] - whole[0]) > 220.0
