"""Clean pairs of the acceptance tables: their own texture, their motions, and what is judged of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from accept.source_rules import count_code_lines
from accept.support.clean_fields import TAIL, draw_speckles, find_moments, find_origins
from accept.support.clean_pairs import FIELDS, SMALL, SPECKLES, Compared, list_cases


@pytest.mark.parametrize("size", SPECKLES)
def test_speckles_of_neighbouring_bins_sum_to_all_speckles(size):
    speckles = draw_speckles(np.zeros(2), np.array([60.0, 40.0]), size, 3)
    points = np.random.default_rng(0).random((300, 2)) * [60.0, 40.0]
    squared = ((points[:, None, :] - speckles.drawn[None, :, :2])**2).sum(axis=2)
    everything = (speckles.drawn[:, 2] * np.exp(-squared * speckles.drawn[:, 3])).sum(axis=1)
    largest_tail = 1e-7
    assert math.exp(-TAIL) < largest_tail
    assert np.abs(speckles.sum_at(points) - everything).max() < largest_tail


@pytest.mark.parametrize("size", SPECKLES)
def test_moments_are_those_of_the_drawn_texture(size):
    speckles = draw_speckles(np.zeros(2), np.array([600.0, 600.0]), size, 5)
    points = np.random.default_rng(1).random((20000, 2)) * 600.0
    sums, (mean, deviation) = speckles.sum_at(points), find_moments(size)
    assert sums.mean() == pytest.approx(mean, rel=0.02)
    assert sums.std() == pytest.approx(deviation, rel=0.04)


@pytest.mark.parametrize("field", FIELDS)
def test_origins_move_to_the_points_they_were_sought_for(field):
    for case in (case for case in list_cases() if case.field == field):
        motion = case.make_motion()
        width, height = case.size
        points = np.random.default_rng(2).random((500, 2)) * [width - 1, height - 1]
        origins = find_origins(motion, points)
        assert np.abs(origins + motion(origins) - points).max() < 1e-9


def test_motions_leave_the_mesh_in_both_images():
    for height in (SMALL, 576):
        for case in list_cases(height):
            nodes = case.make_mesh().nodes
            moved = nodes + case.make_motion()(nodes)
            assert nodes.min() > 4
            assert moved.min() > 4
            assert (np.maximum(nodes, moved) < np.array(case.size) - 5).all()


def test_sixty_pairs_show_every_speckle_with_every_field_cut_off_and_noise():
    cases = list_cases()
    assert len({case.name for case in cases}) == 60
    for name in ("field", "cut_off", "noise"):
        values = {getattr(case, name) for case in cases}
        assert len({(getattr(case, name), case.speckle) for case in cases}) == len(values) * len(SPECKLES)


HELD_OFF = Compared("a pair", n_pixels=10**6, iterations=9, iterations_keep=4, rms=0.102, rms_keep=0.1, largest=1.3,
                    largest_keep=1.2, largest_change=0.1)
FOLLOWED = replace(HELD_OFF, rms=0.1, largest=0.9, largest_keep=0.9, largest_change=1e-4)


@pytest.mark.parametrize(("change", "missed"), [
    ({}, ()), ({"n_excluded": 1}, ("cells",)), ({"n_pixels_lost": 10}, ()), ({"n_pixels_lost": 11}, ("pixels",)),
    ({"iterations": 10}, ("iterations",)), ({"refusal": "stagnates"}, ("stagnates",))])
def test_bounds_of_every_pair(change, missed):
    assert replace(HELD_OFF, **change).misses == missed
    assert replace(FOLLOWED, **change).misses == missed


def test_a_field_that_is_held_off_may_change_but_not_for_the_worse():
    assert replace(HELD_OFF, rms=0.1021).misses == ("error",)
    assert replace(HELD_OFF, rms=math.nan).misses == ("error",)
    assert replace(HELD_OFF, largest_change=5.0).misses == ()


def test_a_field_that_is_followed_stays():
    assert replace(FOLLOWED, largest_change=1.1e-3).misses == ("field",)
    assert replace(FOLLOWED, largest_change=math.nan).misses == ("field",)


def test_code_lines_are_neither_blank_nor_comments_nor_documentation():
    text = ('"""Module\n\nof two."""\n\nA = 1  # one\n"""What A is."""\n\n\ndef f(x):\n    """One."""\n    # why\n'
            '    return (x +\n            A)\n')
    assert count_code_lines(text) == 4
