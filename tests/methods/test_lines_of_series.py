"""Lines of a series: refined where a frame's residual says that they are off, kept from there on, also when resumed."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from bench.support.opened_pair import Crack, render_crack
from ddic.io.series_reader import read_series
from ddic.methods.run import run_file
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.summary import SeriesSummary
from support.interrupted import assert_equal_results, interrupt

SIDE = 192
TIP = np.array([103.3, 94.7])
FACTORS = (0.0, 0.2, 0.25, 0.3)
"""K_I / mu of the frames, px^(1/2): closed first, then it opens."""

ALONG = Crack(tip=TIP).along
ACROSS = np.array([-ALONG[1], ALONG[0]])


@cache
def render(factor: float) -> tuple[NDArray[Any], NDArray[Any]]:
    return render_crack(Crack(tip=TIP, opening_factor=factor), SIDE, noise=0.5)


def write_series(folder: Path) -> Path:
    """A crack that opens, its line 2.5 px beside it and its tip 4 px too short; collective."""
    if MPI.COMM_WORLD.rank == 0:
        folder.mkdir()
        for number, factor in enumerate(FACTORS):
            cv2.imwrite(str(folder / f"g_{number}.png"), render(factor)[1])
        cv2.imwrite(str(folder / "f.png"), render(0.0)[0])
        end = TIP - 4.0 * ALONG + 2.5 * ACROSS
        (folder / "case.toml").write_text(
            '[images]\nreference = "f.png"\ndeformed = "g_*.png"\n[mesh.structured]\nregion = [16, 16, 176, 176]\n'
            f"element_size = 16\n[[discontinuity]]\nvertices = {[(end - 400 * ALONG).tolist(), end.tolist()]}\n"
            'tip_functions = true\n[solver]\nmethod = "dual"\nsubdomains = 4\ntolerance = 1e-10\n', encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


def run(path: Path, *, resume: bool = False) -> SeriesSummary:
    summary = run_file(Team.world(), path, Silence(), resume=resume)
    assert isinstance(summary, SeriesSummary)
    MPI.COMM_WORLD.barrier()
    return summary


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SeriesSummary]:
    """The case file of a series that was measured without a break, and what it says of itself; collective."""
    root = MPI.COMM_WORLD.rank == 0
    path = write_series(MPI.COMM_WORLD.bcast(tmp_path_factory.mktemp("lines") / "whole" if root else None))
    return path, run(path)


def line_of(result: ddic.Result) -> NDArray[np.float64]:
    return np.array(json.loads(result.attributes["case"]["json"])["discontinuity"][0]["vertices"])


@pytest.mark.parallel([1, 2])
def test_the_first_frame_that_tells_refines_the_line_for_those_after_it(whole: tuple[Path, SeriesSummary]) -> None:
    path, summary = whole
    assert [bool(frame.lines) for frame in summary.frames] == [False, True, True, True]
    assert [frame.started_from for frame in summary.frames] == ["a search", "a search", "the last frame",
                                                                "the last two frames"]
    assert ["its line was off" in str(frame.notes) for frame in summary.frames] == [False, True, False, False]
    series = read_series(path.parent / "result.vtkhdf")
    for step in (1, 2, 3):
        start, end = line_of(series[step])
        tangent = (end - start) / np.linalg.norm(end - start)
        # Four standard deviations of what noise makes of the tip's place.
        assert abs((end - TIP) @ ALONG) < 0.8
        # Behind the tip the sides hardly part, and the line's place is not known so well.
        heights = [(TIP - behind * ALONG - end) @ np.array([-tangent[1], tangent[0]]) for behind in (30.0, 80.0)]
        assert np.abs(heights).max() < 0.5
        opening = ddic.measure_opening(series[step])
        judged = ((opening.points - TIP) @ ALONG < -32) & (opening.points[:, 0] > 32)
        crack = Crack(tip=TIP, opening_factor=FACTORS[step])
        sides = (crack.displacement(opening.points + side * 3.0 * ACROSS) for side in (-1, 1))
        # 3 px beside the crack, where its opening is 0.02 px less.
        assert np.abs(opening.normal - (next(sides) - next(sides)) @ -ACROSS)[judged].max() < 0.1


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("at", [2, 3])
def test_what_is_resumed_equals_what_was_not_interrupted(shared_path: Path, whole: tuple[Path, SeriesSummary],
                                                         at: int) -> None:
    path, expected = whole
    parts = write_series(shared_path / "parts")
    interrupt(parts, at)
    resumed = run(parts, resume=True)
    assert resumed.n_resumed == at - 1
    assert [frame.lines for frame in resumed.frames] == [frame.lines for frame in expected.frames]
    assert_equal_results(path.parent / "result.vtkhdf", parts.parent / "result.vtkhdf")
