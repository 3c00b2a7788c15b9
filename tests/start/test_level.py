"""A level of the pyramid in tiles."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest
from mpi4py import MPI

from ddic.case.schema import StartSection
from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.images.rigid import GridField, build_uniform_field
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.enriched import Discontinuities
from ddic.parallel.team import Team, require_held
from ddic.parallel.workers import Workers
from ddic.start import binned_pair, level, multilevel
from ddic.start.binned_pair import BinnedPair, choose_block_sizes, choose_further_block_sizes, choose_held_block
from ddic.start.coarse_displacement import CutField
from ddic.start.helpers import Helpers, hold_rows, split_rows
from ddic.start.level import TiledLevel, correlate_in_tiles, correlate_level
from ddic.start.multilevel import Pyramid, find_multilevel_start
from ddic.synth.fields import Sinusoidal
from ddic.synth.speckle import SpeckleTexture
from support.pictures import pair_of, rms_error, source, square_mesh

SIDE = 800
MESH = square_mesh(40.0, 760.0)
FIELD = Sinusoidal((0.35, -0.25), (0.6, 0.5), (640.0, 800.0), (800.0, 640.0), (0.3, -0.2), (-0.7, 0.5))
AT_REST = build_uniform_field((0.0, 0.0))
BLOCK = 2

T = TypeVar("T")


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    # 22 cells of 16 blocks of 2 px: 3 x 3 tiles.
    monkeypatch.setitem(level.TILE, 2, 8)


def _images(mask: np.ndarray | None = None) -> tuple[MaskedSource, MaskedSource]:
    pair = pair_of(FIELD, SIDE, 8)
    return source(pair.reference, mask), source(pair.deformed)


def _search(images: tuple[MaskedSource, MaskedSource], lead: Callable[[Helpers], T], team: Team | None = None) -> T:
    """What the last rank finds, with all ranks of a team; each holds its rows of the images' pixels."""
    team = Team.alone() if team is None else team
    held = [hold_rows(*images, 1, split_rows(SIDE, team.size)[team.rank])]
    workers = Workers(team, team.size - 1, held)
    _, found = workers.run(lambda: lead(Helpers(workers, 0)), lambda: None)
    return require_held(team.broadcast(found, root=workers.leader))


def _correlate(images: tuple[MaskedSource, MaskedSource], team: Team | None = None) -> TiledLevel:
    return _search(images, lambda helpers: correlate_in_tiles(helpers, BLOCK, MESH, [AT_REST], "none"), team)


def test_tiles_find_what_the_whole_level_does() -> None:
    tiled = _correlate(_images())
    assert (tiled.n_tiles, tiled.errors) == (9, [])
    pair = _search(_images(), lambda helpers: helpers.read_whole(BLOCK))
    whole = correlate_level(pair, MESH, [AT_REST], "none", Discontinuities())
    assert isinstance(whole, GridField)
    assert (tiled.field.origin, tiled.field.spacing) == (whole.origin, whole.spacing)
    error, difference = whole.at(MESH.nodes), tiled.field.values - whole.values
    # Cells of 32 px follow these waves to a hundredth of a pixel; where tiles meet there is less between them.
    assert rms_error(error, MESH.nodes, FIELD) <= 0.02
    assert rms_error(tiled.field.at(MESH.nodes), MESH.nodes, FIELD) <= 0.02
    assert 0 < np.sqrt((difference**2).mean()) <= 0.01


@pytest.mark.parallel([1, 2, 3, 4])
def test_tiles_are_the_same_on_any_number_of_ranks() -> None:
    by_all = _correlate(_images(), Team(MPI.COMM_WORLD))
    np.testing.assert_array_equal(by_all.field.values, _correlate(_images()).field.values)


@pytest.mark.parallel([1, 2, 3, 4])
def test_blocks_are_read_together() -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[300:420, 80:90] = False
    images = _images(mask)
    together = _search(images, lambda helpers: helpers.read_whole(4), Team(MPI.COMM_WORLD))
    alone = BinnedPair(*images, 1).bin_at_sizes([4])[4]
    for ours, theirs in ((together.reference, alone.reference), (together.deformed, alone.deformed)):
        np.testing.assert_array_equal(ours.read_whole(), theirs.read_whole())
    np.testing.assert_array_equal(together.reference.find_usable(together.reference.extent),
                                  alone.reference.find_usable(alone.reference.extent))


def test_a_tile_that_shows_nothing_stays_as_it_began_and_says_so() -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[:380, :380] = False
    tiled = _correlate(_images(mask))
    (error,) = tiled.errors
    assert "everything is masked" in str(error)
    assert (tiled.field.values[0, 0] == 0).all()
    assert rms_error(tiled.field.at(MESH.nodes[-40:]), MESH.nodes[-40:], FIELD) <= 0.05
    with pytest.raises(SingularSubdomainError, match="everything is masked"):
        _correlate(_images(np.zeros((SIDE, SIDE), bool)))


@pytest.mark.parallel([1, 2])
def test_a_tile_that_does_not_converge_says_so_on_any_rank() -> None:
    pair = pair_of(FIELD, SIDE, 8)
    deformed = pair.deformed.copy()
    y, x = np.mgrid[SIDE // 2:SIDE, SIDE // 2:SIDE].astype(float)
    deformed[SIDE // 2:, SIDE // 2:] = 255.0 * SpeckleTexture(77).grey(x, y)
    tiled = _correlate((source(pair.reference), source(deformed)), Team(MPI.COMM_WORLD))
    assert any(isinstance(error, ConvergenceError) for error in tiled.errors)
    # The others are what they are without it.
    assert rms_error(tiled.field.at(MESH.nodes[:40]), MESH.nodes[:40], FIELD) <= 0.05


def test_several_ranks_go_on_to_finer_levels_than_one_would(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(binned_pair.LARGEST_COARSE_IMAGE, 2, 1600)
    monkeypatch.setattr(binned_pair, "FINEST", 4)
    monkeypatch.setattr(multilevel, "LARGEST_WHOLE", 1600)
    mesh = square_mesh(8.0, 792.0)
    start = _search(_images(), lambda helpers: find_multilevel_start(
        Pyramid(helpers.get_pair(1), mesh, "none", helpers=helpers), StartSection()))
    assert start.levels == (32, 16, 8, 4)
    assert start.warnings == ()
    alone = find_multilevel_start(Pyramid(BinnedPair(*_images(), 1), mesh, "none"), StartSection())
    assert alone.levels == (32,)
    errors = [rms_error(found.field.at(mesh.nodes), mesh.nodes, FIELD) for found in (start, alone)]
    # Cells of 64 px follow these waves to 0.06 px, of 512 px not at all.
    assert (errors[0] <= 0.08, errors[1] >= 0.3) == (True, True)


@pytest.mark.parametrize("side", [600, 1000, 5000, 9000, 22000, 31700, 100_000])
def test_blocks_of_every_level_are_made_of_those_that_ranks_hold(side: int) -> None:
    sizes = choose_block_sizes((side, side), square_mesh(0.0, float(side), side / 2))
    sizes += choose_further_block_sizes(sizes)
    held = choose_held_block((side, side))
    assert [size % held for size in sizes] == [0] * len(sizes)
    # From 64 Mpx on one rank would stop at larger blocks.
    assert sizes[-1] == (8 if side > 5000 else 2 * held if held == 1 else held)


def test_levels_that_lines_cut_are_not_tiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binned_pair, "FINEST", 1)
    monkeypatch.setattr(multilevel, "LARGEST_WHOLE", 1600)
    line = Discontinuities((np.array([[0.0, 400.0], [800.0, 400.0]]),), ("free",))
    start = _search(_images(), lambda helpers: find_multilevel_start(
        Pyramid(helpers.get_pair(1), MESH, "none", line, helpers=helpers), StartSection()))
    assert isinstance(start.field, CutField)
    assert start.levels == (16, 8, 4, 2)
