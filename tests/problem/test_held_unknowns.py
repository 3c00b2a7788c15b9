"""What neither pixels nor mechanics hold is refused, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from ddic.errors import SingularSubdomainError, is_collective
from ddic.parallel.team import Team
from support.cases import write_case, write_images
from support.measuring import field_on_one_rank, measure, whole_field

RANKS = [1, 2, 3, 4]
TIGHT = "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0.0\nmax_iterations = 2000\n"
UNKNOWN_EDGES = "[regularization]\ncut_off_wavelength = 64.0\n"
FREE_EDGES = "[regularization]\ncut_off_wavelength = 64.0\nnot_controlled = []\n"
BLOCKS = '[solver]\npartition = "blocks"\nblocks = [3, 3]\ntolerance = 1e-12\n'
MONOLITHIC = '[solver]\nmethod = "monolithic"\n'

Rectangle = tuple[int, int, int, int]
"""Columns and rows from and to, of the deformed image; cells of 16 px begin at column and row 24."""

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
@pytest.mark.parametrize(("hidden", "edges", "solver"), [
    # From element to element along an edge whose forces are unknown, errors of the field grow.
    (EDGE, UNKNOWN_EDGES, BLOCKS), (EDGE, UNKNOWN_EDGES, MONOLITHIC.replace("monolithic", "assembled")),
    (CORNER_TWO_DEEP, UNKNOWN_EDGES, BLOCKS),
    # Without mechanics every unknown needs its pixels.
    (CORNER, "", BLOCKS),
], ids=["edge", "edge, one operator", "corner two elements deep", "corner without mechanics"])
def test_what_nothing_holds_is_refused(shared_path: Path, hidden: Rectangle, edges: str, solver: str) -> None:
    team = Team.world()
    with pytest.raises(SingularSubdomainError, match=r"^the region around column 24, row \d+") as caught:
        measure(team, write(team, shared_path, solver + TIGHT + edges, hidden))
    assert is_collective(caught.value)
