"""What neither pixels nor mechanics hold follows its neighbours, and nothing else does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from ddic.parallel.team import Team
from support.cases import WAVES, write_case, write_images
from support.measuring import field_on_one_rank, measure, whole_field

RANKS = [1, 3]
TIGHT = "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0.0\nmax_iterations = 2000\n"
UNKNOWN_EDGES = "[regularization]\ncut_off_wavelength = 64.0\n"
FREE_EDGES = "[regularization]\ncut_off_wavelength = 64.0\nnot_controlled = []\n"
BLOCKS = '[solver]\npartition = "blocks"\nblocks = [3, 3]\ntolerance = 1e-12\n'
MONOLITHIC = '[solver]\nmethod = "monolithic"\n'

Rectangle = tuple[int, int, int, int]
"""Columns and rows from and to, of the deformed image; cells of 16 px begin at column and row 24."""

NODES = np.stack(np.meshgrid(*2 * (np.arange(24.0, 169.0, 16.0),)), axis=-1).reshape(-1, 2)
CORNER: Rectangle = (0, 41, 0, 41)
INSIDE: Rectangle = (100, 140, 80, 120)
EDGE: Rectangle = (0, 43, 60, 192)
CORNER_TWO_DEEP: Rectangle = (0, 58, 0, 58)
TWO_AT_AN_EDGE: Rectangle = (0, 41, 71, 105)


def write(team: Team, folder: Path, more: str, hidden: Rectangle) -> Path:
    if team.is_root:
        if not (folder / "f.tif").exists():
            write_images(folder)
        mask = np.ones((192, 192), dtype=np.uint8)
        x0, x1, y0, y1 = hidden
        mask[y0:y1, x0:x1] = 0
        tifffile.imwrite(folder / "mask.tif", mask)
        write_case(folder, more, images='deformed_mask = "mask.tif"')
    team.wait_for_all()
    return folder / "case.toml"


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("hidden", "edges"), [
    # The equilibrium of the corner cell's one inner node gives the displacement of the corner.
    (CORNER, UNKNOWN_EDGES), (TWO_AT_AN_EDGE, UNKNOWN_EDGES), (INSIDE, UNKNOWN_EDGES), (EDGE, FREE_EDGES)],
    ids=["corner of unknown edges", "two cells at an unknown edge", "inside", "free edge"])
def test_mechanics_fill_what_is_hidden(shared_path: Path, hidden: Rectangle, edges: str) -> None:
    team = Team.world()
    one_domain = field_on_one_rank(write(team, shared_path, MONOLITHIC + TIGHT + edges, hidden))
    team.wait_for_all()
    measured = measure(team, write(team, shared_path, BLOCKS + TIGHT + edges, hidden))
    # Gauss-Newton to 1e-10; what M still holds of hidden pixels slows it down, by a tenth an iteration at worst.
    assert np.abs(whole_field(measured) - one_domain).max() <= 1e-7
    assert len(measured.records) <= 200
    # Nothing runs away: the waves move points by 0.3 + 0.5 px along x and less along y.
    assert np.abs(one_domain).max() <= 1.5


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("hidden", "edges"), [
    # From element to element along an edge whose forces are unknown, errors of the field grow.
    (EDGE, UNKNOWN_EDGES), (CORNER_TWO_DEEP, UNKNOWN_EDGES),
    # Without mechanics every unknown needs its pixels.
    (CORNER, ""), (INSIDE, ""),
], ids=["edge", "corner two elements deep", "corner without mechanics", "inside without mechanics"])
def test_what_nothing_holds_follows_its_neighbours(shared_path: Path, hidden: Rectangle, edges: str) -> None:
    team = Team.world()
    fields = []
    for solver in (BLOCKS, BLOCKS + 'method = "assembled"\n', MONOLITHIC):
        path = write(team, shared_path, solver + TIGHT + edges, hidden)
        if solver != MONOLITHIC:
            measured = measure(team, path)
            assert any("follow their neighbours" in note for note in measured.notes)
            fields.append(whole_field(measured))
        else:
            fields.append(field_on_one_rank(path))
        team.wait_for_all()
    nodes = NODES
    moved = nodes + WAVES.displacement(nodes)
    x0, x1, y0, y1 = hidden
    # Beyond the 2 px of the spline's taps.
    is_seen = (moved[:, 0] < x0 - 2) | (moved[:, 0] > x1 + 2) | (moved[:, 1] < y0 - 2) | (moved[:, 1] > y1 + 2)
    is_far = ((moved[:, 0] < x0 - 20) | (moved[:, 0] > x1 + 20) | (moved[:, 1] < y0 - 20) | (moved[:, 1] > y1 + 20))
    for field in fields:
        # Of the others, without mechanics, nothing is said; with them, as they follow their neighbours.
        assert np.isfinite(field[is_seen]).all()
        assert np.isnan(field).any() == (edges == "")
        # Nothing runs away: waves move points by 0.8 px. Along an edge of 8 hidden cells 1.3 px of error were found.
        assert np.nanmax(np.abs(field - WAVES.displacement(nodes))) <= 1.6
        # What is seen is where it is: 0.1 px beside what is hidden, whose cells see few pixels.
        assert np.nanmax(np.abs(field - WAVES.displacement(nodes))[is_far]) <= 0.1
        np.testing.assert_array_equal(np.isnan(field), np.isnan(fields[0]))
    for field in fields[1:]:
        assert np.nanmax(np.abs(field - fields[0])) <= 1e-7
