"""What is excluded: joined, compared, and left out of M and b."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.parallel.team import Team
from ddic.problem.exclusions import (
    BLANK,
    HELD_BACK,
    KEPT,
    PIXELS_CHANGED,
    SPOILT,
    UNSEEN,
    Exclusions,
    exclude,
)
from ddic.synth.fields import Translation
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh

MESH = square_mesh(24.0, 88.0)
PAIR = pair_of(Translation((0.3, -0.2)), 128, 8)
ALONE = Team.alone()


def exclusions(cells: dict[int, int] | None = None, pixels: list[tuple[int, int]] | None = None) -> Exclusions:
    """Of one subdomain of 4 x 4 cells with one view."""
    states = np.zeros(16, dtype=np.uint8)
    for cell, state in (cells or {}).items():
        states[cell] = state
    return Exclusions([(states,)], [(np.array(pixels or [], dtype=np.int64).reshape(-1, 2),)])


def test_joining_keeps_the_first_reason_and_each_pixel_once() -> None:
    one = exclusions({0: BLANK, 1: SPOILT}, [(30, 40), (31, 40)])
    two = exclusions({1: UNSEEN, 2: UNSEEN}, [(31, 40), (5, 60)])
    joined = one.join(two)
    assert joined.cells[0][0].tolist() == [BLANK, SPOILT, UNSEEN] + [KEPT] * 13
    assert joined.cells[0][0].dtype == np.uint8
    assert joined.pixels[0][0].tolist() == [[5, 60], [30, 40], [31, 40]]
    # What was joined is as it was.
    assert one.cells[0][0][2] == KEPT


def test_nothing_is_nothing_and_anything_is_something() -> None:
    model = model_of(source(PAIR.reference), source(PAIR.deformed), MESH)
    nothing = Exclusions.nothing(model.views)
    assert not nothing.is_any(ALONE)
    assert exclusions({3: BLANK}).is_any(ALONE)
    assert exclusions(None, [(30, 30)]).is_any(ALONE)
    assert not nothing.is_other_than(ALONE, exclusions())


def test_other_cells_are_other_and_other_reasons_are_not() -> None:
    assert exclusions({0: SPOILT}).is_other_than(ALONE, exclusions())
    assert exclusions().is_other_than(ALONE, exclusions({0: SPOILT}))
    assert exclusions({0: SPOILT}).is_other_than(ALONE, exclusions({1: SPOILT}))
    assert not exclusions({0: SPOILT}).is_other_than(ALONE, exclusions({0: UNSEEN}))


def test_pixels_are_other_from_a_share_of_them_on() -> None:
    many = [(x, y) for x in range(30, 40) for y in range(30, 40)]
    bearable = round(PIXELS_CHANGED * len(many))
    assert not exclusions(None, many).is_other_than(ALONE, exclusions(None, many[bearable:]))
    assert exclusions(None, many).is_other_than(ALONE, exclusions(None, many[bearable + 1:]))
    assert exclusions().is_other_than(ALONE, exclusions(None, many[:1]))


def test_as_many_pixels_elsewhere_are_other() -> None:
    here = [(x, 30) for x in range(30, 60)]
    there = [(x, 70) for x in range(30, 60)]
    assert exclusions(None, here).is_other_than(ALONE, exclusions(None, there))


@pytest.mark.parallel([1, 2, 3])
def test_all_ranks_say_the_same() -> None:
    team = Team.world()
    mine = exclusions({0: SPOILT}) if team.rank == team.size - 1 else exclusions()
    assert mine.is_any(team)
    assert mine.is_other_than(team, exclusions())
    assert not mine.is_other_than(team, mine)


def test_m_and_b_are_those_of_the_pixels_that_are_left() -> None:
    model = model_of(source(PAIR.reference), source(PAIR.deformed), MESH)
    excluded = exclusions({5: SPOILT}, [(30, 40), (80, 81)])
    used = exclude(model, excluded)
    # A mask of the reference image that hides the same, whose taps are left as they are.
    raster = model.views[0].views[0].view.correlation.raster
    cell_of = np.full((128, 128), -1)
    for cell in range(16):
        for run in range(raster.row_ptr[cell], raster.row_ptr[cell + 1]):
            cell_of[raster.rows[run], raster.starts[run]:raster.stops[run]] = cell
    counts = cell_of >= 0
    counts &= cell_of != 5
    counts[40, 30] = counts[81, 80] = False
    view = used.views[0].views[0]
    window = view.view.correlation.reference.window
    place = np.s_[window.y0:window.y1, window.x0:window.x1]
    q = np.random.default_rng(0).normal(0.0, 0.1, MESH.n_dofs)
    residual = view.compute_residual_image(q)
    np.testing.assert_array_equal(np.isfinite(residual), counts[place])
    of_all = model.views[0].views[0].compute_residual_image(q)
    np.testing.assert_array_equal(residual[counts[place]], of_all[counts[place]])
    # M and b of the cell that is left out are nothing, and the others' those of their pixels.
    of_cells = view.view.correlation.compute_cell_hessians()
    assert not of_cells[5].any()
    assert view.view.n_pixels == counts.sum()
    assert view.view.count_pixels()[5] == 0
    whole_cells = model.views[0].views[0].view.correlation.compute_cell_hessians()
    touched = {5, int(cell_of[40, 30]), int(cell_of[81, 80])}
    kept = [cell for cell in range(16) if cell not in touched]
    np.testing.assert_array_equal(of_cells[kept], whole_cells[kept])
    assert len(touched) == 3
    for cell in touched:
        assert np.trace(of_cells[cell]) < np.trace(whole_cells[cell])
    # The model that was given is as it was.
    assert model.views[0].views[0].view.n_pixels == (cell_of >= 0).sum()
    # The sums of what is left out and of what is kept are those of all.
    complement = exclude(model, exclusions({cell: SPOILT for cell in range(16) if cell != 5}))
    b = [m.linearize([q])[0][0] for m in (model, exclude(model, exclusions({5: SPOILT})), complement)]
    np.testing.assert_allclose(b[0], b[1] + b[2], atol=1e-9 * np.abs(b[0]).max())


def test_nothing_excluded_is_the_same_view() -> None:
    model = model_of(source(PAIR.reference), source(PAIR.deformed), MESH)
    assert exclude(model, exclusions()).views[0].views[0] is model.views[0].views[0]


def test_only_cells_that_are_seen_are_held_back() -> None:
    flags = [(np.arange(16) < 4,)]
    held = exclusions({0: SPOILT, 1: BLANK, 2: UNSEEN, 5: SPOILT}).hold_back(flags)
    assert held.cells[0][0].tolist() == [HELD_BACK, BLANK, UNSEEN, HELD_BACK, KEPT, SPOILT] + [KEPT] * 10
    assert held.cells[0][0].dtype == np.uint8
    np.testing.assert_array_equal(np.flatnonzero(held.held_back[0][0]), [0, 3])


def test_cells_that_are_held_back_count_but_are_other_than_kept_ones() -> None:
    model = model_of(source(PAIR.reference), source(PAIR.deformed), MESH)
    held = exclusions({5: HELD_BACK})
    assert exclude(model, held).views[0].views[0] is model.views[0].views[0]
    assert held.is_other_than(ALONE, exclusions())
    assert held.is_other_than(ALONE, exclusions({5: SPOILT}))
    assert not held.is_other_than(ALONE, exclusions({5: HELD_BACK}))
