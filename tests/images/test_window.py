"""Windows that are read together."""

from __future__ import annotations

import numpy as np

from ddic.images.window import Window, merge_windows

HALO = 4


def test_neighbours_share_the_window_that_holds_them() -> None:
    row = [Window((10 * k, 0), (10 * k + 10, 10)) for k in range(3)]
    # 38 x 18 pixels with the halo, against three times 18 x 18.
    assert merge_windows(row, HALO) == [(Window.of_size(30, 10), [0, 1, 2])]


def test_windows_apart_are_read_apart_and_in_order() -> None:
    far = [Window.of_size(10, 10), Window((10, 0), (20, 10)),
           Window((500, 500), (510, 510)), Window((510, 500), (520, 510))]
    assert merge_windows(far, HALO) == [(Window.of_size(20, 10), [0, 1]), (Window((500, 500), (520, 510)), [2, 3])]


def test_the_halo_decides() -> None:
    # 29 x 10 pixels against twice 10 x 10 without a halo, 39 x 20 against twice 20 x 20 with 5 px of it.
    pair = [Window.of_size(10, 10), Window((19, 0), (29, 10))]
    assert [members for _, members in merge_windows(pair, 0)] == [[0], [1]]
    assert [members for _, members in merge_windows(pair, 5)] == [[0, 1]]
    assert merge_windows([], HALO) == []


def test_a_part_is_found_in_an_array_of_the_whole() -> None:
    whole, part = Window((10, 20), (40, 60)), Window((12, 25), (30, 41))
    rows, columns = np.mgrid[20:60, 10:40]
    place = whole.locate(part)
    np.testing.assert_array_equal(columns[place], np.mgrid[25:41, 12:30][1])
    np.testing.assert_array_equal(rows[place], np.mgrid[25:41, 12:30][0])


def test_a_box_has_as_many_axes_as_its_corners() -> None:
    whole, other = Window.of_size(40, 30, 20), Window.between(np.array([-5.0, 3.0, 9.0]), [50, 20, 30])
    common = whole.intersection(other)
    assert common == Window((0, 3, 9), (40, 20, 20))
    assert (common.sizes, common.shape, common.n_pixels) == ((40, 17, 11), (11, 17, 40), 40 * 17 * 11)
    assert whole.union(other) == Window((-5, 0, 0), (50, 30, 30))
    assert whole.contains(common)
    assert not whole.contains(other)
    assert common.grow(2) == Window((-2, 1, 7), (42, 22, 22))
    voxels = np.zeros(whole.shape)
    assert voxels[whole.locate(common)].shape == common.shape
    assert not whole.intersection(Window((50, 0, 0), (60, 30, 20))).n_pixels


def test_bands_of_rows_cover_a_window() -> None:
    window = Window((3, 5), (9, 16))
    bands = list(window.split_rows(4))
    assert bands == [Window((3, 5), (9, 9)), Window((3, 9), (9, 13)), Window((3, 13), (9, 16))]
    assert list(window.split_rows(2, step=6)) == [Window((3, 5), (9, 7)), Window((3, 11), (9, 13))]
    slabs = list(Window.of_size(4, 4, 10).split_rows(6))
    assert slabs == [Window.of_size(4, 4, 6), Window((0, 0, 6), (4, 4, 10))]
