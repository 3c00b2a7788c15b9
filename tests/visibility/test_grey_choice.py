"""The simplest correction of grey levels that leaves no more than noise."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.grey_statistics import GreyCorrection
from ddic.parallel.team import Team
from ddic.visibility.match_reference import CELL_SHARE, GLOBAL_SHARE, GROSS_SHARE, choose_correction
from ddic.visibility.seen_cells import SeenCells, find_typical_cell
from support.seen import make_seen

NOISE = 8.0


def _choose(cells: dict[int, SeenCells], **limits: GreyCorrection) -> GreyCorrection:
    typical = {camera: find_typical_cell(Team.alone(), of_camera) for camera, of_camera in cells.items()}
    return choose_correction(Team.alone(), cells, typical, **limits)


def test_the_same_brightness_needs_nothing() -> None:
    # Means of 256 px are known to sqrt(8 / 256) = 0.18 grey levels, whose square is a 250th of the noise.
    random = np.random.default_rng(0)
    cells = make_seen(mean_g=128.0 + 0.18 * random.standard_normal(100))
    assert _choose({0: cells}) == "none"


def test_no_cells_need_nothing() -> None:
    assert _choose({0: make_seen(0)}) == "none"


@pytest.mark.parametrize(("factor", "expected"), [(0.8, "none"), (1.2, "global")])
@pytest.mark.parametrize("what", ["mean_g", "spread_g"])
def test_a_change_of_the_whole_image_counts_from_a_share_of_the_noise(what: str, factor: float, expected: str) -> None:
    change = np.sqrt(factor * GLOBAL_SHARE * NOISE)
    # An offset is one of means alone; with a gain, the offset of means is nothing where these are corrected too.
    given = {"mean_g": 128.0 + change} if what == "mean_g" else {"spread_g": 40.0 + change}
    assert _choose({0: make_seen(**given)}) == expected


@pytest.mark.parametrize(("factor", "expected"), [(0.8, "none"), (1.2, "element")])
def test_what_differs_from_cell_to_cell_counts_from_a_larger_share(factor: float, expected: str) -> None:
    change = np.sqrt(factor * CELL_SHARE * NOISE)
    up_and_down = 128.0 + change * np.tile([-1.0, 1.0, 0.0], 33) * np.sqrt(1.5)
    assert _choose({0: make_seen(99, mean_g=up_and_down)}) == expected


def test_a_gain_and_offset_of_all_cells_is_global_whatever_their_means() -> None:
    means = np.linspace(60.0, 190.0, 100)
    cells = make_seen(mean_f=means, mean_g=0.8 * means + 10.0, spread_g=0.8 * 40.0)
    assert _choose({0: cells}) == "global"


def test_inverted_contrast_is_global() -> None:
    # 255 - f: neither means nor spreads need differ, and their offsets from a positive gain would look like light.
    means = np.linspace(60.0, 195.0, 100)
    cells = make_seen(mean_f=means, mean_g=255.0 - means, spread_g=-40.0)
    assert _choose({0: cells}) == "global"
    typical = find_typical_cell(Team.alone(), cells)
    assert (typical.gain, typical.offset) == pytest.approx((-1.0, 255.0))


@pytest.mark.parametrize(("share", "expected"), [(0.5, "none"), (2.0, "element")])
def test_a_reflection_on_few_cells_counts_from_a_share_of_the_pixels(share: float, expected: str) -> None:
    n = 10_000
    is_bright = np.arange(n) < share * GROSS_SHARE * n
    # Gross, but in few cells: their mean square over all is 0.0025 x 5 x noise.
    cells = make_seen(n, mean_g=128.0 + np.where(is_bright, np.sqrt(5 * NOISE), 0.0))
    assert _choose({0: cells}) == expected


def test_what_is_hidden_asks_for_no_correction() -> None:
    is_hidden = np.arange(100) < 30
    cells = make_seen(mean_g=np.where(is_hidden, 0.0, 128.0), spread_g=np.where(is_hidden, 2.0, 40.0),
                      variance=np.where(is_hidden, 1600.0, NOISE))
    assert _choose({0: cells}) == "none"


def test_small_cells_have_no_brightness_of_their_own() -> None:
    up_and_down = 128.0 + 10.0 * np.tile([-1.0, 1.0], 50)
    assert _choose({0: make_seen(mean_g=up_and_down, n_pixels=63)}) in ("none", "global")
    assert _choose({0: make_seen(mean_g=up_and_down, n_pixels=64)}) == "element"


def test_one_correction_for_all_cameras_never_less_than_before_nor_more_than_may_be() -> None:
    plain, bright = make_seen(), make_seen(mean_g=138.0)
    assert _choose({0: plain, 1: bright}) == "global"
    assert _choose({0: plain}, least="element") == "element"
    varied = make_seen(mean_g=128.0 + 10.0 * np.tile([-1.0, 1.0], 50))
    assert _choose({0: varied}, most="global") == "global"
