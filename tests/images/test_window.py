"""Windows that are read together."""

from __future__ import annotations

import numpy as np

from ddic.images.window import Window, merge_windows

HALO = 4


def test_neighbours_share_the_window_that_holds_them() -> None:
    row = [Window(10 * k, 0, 10 * k + 10, 10) for k in range(3)]
    # 38 x 18 pixels with the halo, against three times 18 x 18.
    assert merge_windows(row, HALO) == [(Window(0, 0, 30, 10), [0, 1, 2])]


def test_windows_apart_are_read_apart_and_in_order() -> None:
    far = [Window(0, 0, 10, 10), Window(10, 0, 20, 10), Window(500, 500, 510, 510), Window(510, 500, 520, 510)]
    assert merge_windows(far, HALO) == [(Window(0, 0, 20, 10), [0, 1]), (Window(500, 500, 520, 510), [2, 3])]


def test_the_halo_decides() -> None:
    # 29 x 10 pixels against twice 10 x 10 without a halo, 39 x 20 against twice 20 x 20 with 5 px of it.
    pair = [Window(0, 0, 10, 10), Window(19, 0, 29, 10)]
    assert [members for _, members in merge_windows(pair, 0)] == [[0], [1]]
    assert [members for _, members in merge_windows(pair, 5)] == [[0, 1]]
    assert merge_windows([], HALO) == []


def test_a_part_is_found_in_an_array_of_the_whole() -> None:
    whole, part = Window(10, 20, 40, 60), Window(12, 25, 30, 41)
    rows, columns = np.mgrid[20:60, 10:40]
    place = whole.locate(part)
    np.testing.assert_array_equal(columns[place], np.mgrid[25:41, 12:30][1])
    np.testing.assert_array_equal(rows[place], np.mgrid[25:41, 12:30][0])
