"""What is excluded: joined, compared, and left out of M and b."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.problem.held_cells import HeldCells
from ddic.synth.fields import Translation
from ddic.visibility.exclusions import (
    BLANK,
    HELD_OFF,
    KEPT,
    PIXELS_CHANGED,
    SPOILT,
    UNSEEN,
    Exclusions,
    exclude,
)
from support.fields import field_of
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh

MESH = square_mesh(24.0, 88.0)
PAIR = pair_of(Translation((0.3, -0.2)), 128, 8)
ALONE = Team.alone()


def exclusions(cells: dict[int, int] | None = None, pixels: list[tuple[int, int]] | None = None,
               pulled: dict[int, float] | None = None) -> Exclusions:
    """Of one subdomain of 4 x 4 cells with one view; pulled: cells, and by how much they are shown displaced."""
    states = np.zeros(16, dtype=np.uint8)
    for cell, state in (cells or {}).items():
        states[cell] = state
    shown = pulled or {}
    shown_at = np.broadcast_to(np.array(list(shown.values())).reshape(-1, 1, 1), (len(shown), 4, 2))
    return Exclusions(ByView([[states]]), ByView([[np.array(pixels or [], dtype=np.int64).reshape(-1, 2)]]),
                      ByView([[HeldCells(np.array(list(shown), dtype=np.int64), shown_at)]]))


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
    nothing = Exclusions.of_reference(model.views)
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


@pytest.mark.parallel([1, 3])
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
    raster = model.views[0][0].correlation.raster
    rows = raster.find_runs(np.arange(16))[1]
    cell_of = np.full((128, 128), -1)
    for cell in range(16):
        for run in range(raster.row_ptr[cell], raster.row_ptr[cell + 1]):
            cell_of[rows[run], raster.starts[run]:raster.stops[run]] = cell
    counts = cell_of >= 0
    counts &= cell_of != 5
    counts[40, 30] = counts[81, 80] = False
    view = used.views[0][0]
    window = view.correlation.reference.window
    place = np.s_[window.y0:window.y1, window.x0:window.x1]
    q = np.random.default_rng(0).normal(0.0, 0.1, MESH.n_dofs)
    residual = view.compute_residual_image(q)
    np.testing.assert_array_equal(np.isfinite(residual), counts[place])
    of_all = model.views[0][0].compute_residual_image(q)
    np.testing.assert_array_equal(residual[counts[place]], of_all[counts[place]])
    # M and b of the cell that is left out are nothing, and the others' those of their pixels.
    of_cells = view.correlation.compute_cell_hessians()
    assert not of_cells[5].any()
    assert view.n_pixels == counts.sum()
    assert view.count_pixels()[5] == 0
    whole_cells = model.views[0][0].correlation.compute_cell_hessians()
    touched = {5, int(cell_of[40, 30]), int(cell_of[81, 80])}
    kept = [cell for cell in range(16) if cell not in touched]
    np.testing.assert_array_equal(of_cells[kept], whole_cells[kept])
    assert len(touched) == 3
    for cell in touched:
        assert np.trace(of_cells[cell]) < np.trace(whole_cells[cell])
    # The model that was given is as it was.
    assert model.views[0][0].n_pixels == (cell_of >= 0).sum()
    # The sums of what is left out and of what is kept are those of all.
    complement = exclude(model, exclusions({cell: SPOILT for cell in range(16) if cell != 5}))
    b = [m.linearize(field_of(m, [q]))[0][0] for m in (model, exclude(model, exclusions({5: SPOILT})), complement)]
    np.testing.assert_allclose(b[0], b[1] + b[2], atol=1e-9 * np.abs(b[0]).max())


def test_nothing_excluded_is_the_same_view() -> None:
    model = model_of(source(PAIR.reference), source(PAIR.deformed), MESH)
    assert exclude(model, exclusions()).views[0][0] is model.views[0][0]


def test_cells_that_are_held_off_count() -> None:
    model = model_of(source(PAIR.reference), source(PAIR.deformed), MESH)
    held = exclusions({5: HELD_OFF}, None, {5: 2.0})
    assert exclude(model, held).views[0][0] is model.views[0][0]
    assert not held.is_any(ALONE)
    assert held.has_held_off(ALONE)
    assert held.count_pixels(model) == 0
    # Cells of 16 x 16 px.
    assert exclusions({5: HELD_OFF, 6: BLANK, 7: UNSEEN}, [(30, 40), (31, 40)]).count_pixels(model) == 2 * 256 + 2
    # A cell that is excluded leaves the reason to who says so last only where it is kept.
    joined = exclusions({5: HELD_OFF, 6: SPOILT}).join(exclusions({5: SPOILT, 6: HELD_OFF}))
    assert joined.cells[0][0][[5, 6]].tolist() == [SPOILT, SPOILT]


def test_pulling_other_cells_is_other() -> None:
    held = exclusions({5: HELD_OFF}, None, {5: 2.0})
    assert held.is_other_than(ALONE, exclusions())
    assert held.is_other_than(ALONE, exclusions({5: HELD_OFF}))
    assert held.is_other_than(ALONE, exclusions({5: HELD_OFF}, None, {6: 2.0}))
    # Those that grey levels bring there, and where exactly a cell is seen, change nothing.
    assert not exclusions({5: HELD_OFF}).is_other_than(ALONE, exclusions())
    assert not held.is_other_than(ALONE, exclusions({5: HELD_OFF}, None, {5: 2.1}))


def test_marks_follow_a_later_look_and_what_is_excluded_does_not() -> None:
    before = exclusions({1: HELD_OFF, 2: SPOILT, 3: BLANK})
    marked = before.with_marks(exclusions({2: HELD_OFF, 3: UNSEEN, 4: HELD_OFF, 5: SPOILT}))
    assert marked.cells[0][0].tolist() == [KEPT, KEPT, SPOILT, UNSEEN, HELD_OFF] + [KEPT] * 11


def test_cells_that_a_later_look_would_keep_are_let_go_and_pixels_stay() -> None:
    before = exclusions({1: SPOILT, 2: UNSEEN}, [(30, 40), (31, 40)])
    both = before.intersect(exclusions({2: SPOILT, 3: SPOILT}, [(31, 40)]))
    assert both.cells[0][0].tolist() == [KEPT, KEPT, UNSEEN] + [KEPT] * 13
    assert both.pixels[0][0].tolist() == [[30, 40], [31, 40]]


@pytest.mark.parallel([1, 3])
def test_all_ranks_know_of_cells_that_are_held_off() -> None:
    team = Team.world()
    mine = exclusions({0: HELD_OFF}, None, {0: 2.0}) if team.rank == team.size - 1 else exclusions()
    assert mine.has_held_off(team)
    assert mine.is_other_than(team, exclusions())
    assert not mine.is_any(team)
