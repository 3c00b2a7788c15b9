"""A measurement that starts from a frame of a series."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ddic.case.loader import load_case
from ddic.check.case import load_checked_case
from ddic.cli.check import check
from ddic.errors import InputError
from ddic.methods.run import run_pair
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.start.given_start import EarlierResult, load_given_start
from support.cases import write_case, write_images
from support.series_files import MESH, FrameFile, displace, write_series_file

FRAMES = [FrameFile(0.5), FrameFile(1.0), FrameFile(2.0, 0)]
FROM = '[start]\nfrom_result = "s.vtkhdf"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_images(tmp_path)
    write_series_file(tmp_path / "s.vtkhdf", FRAMES)
    return tmp_path


@pytest.mark.parametrize(("more", "time", "name"), [
    ("", 1.0, "s.vtkhdf, frame 2, the last one that was measured"), ("frame = 1\n", 0.5, "s.vtkhdf, frame 1")])
def test_the_frame_asked_for_or_the_last_is_taken(folder: Path, more: str, time: float, name: str) -> None:
    given = load_given_start(load_case(write_case(folder, FROM + more)).case.start, 2)
    assert isinstance(given, EarlierResult)
    assert given.name == f"{folder}/{name}"
    np.testing.assert_array_equal(given.result.displacement, displace(MESH.nodes, time))


def test_the_log_says_which_frame(folder: Path) -> None:
    summary = run_pair(Team.world(), load_checked_case(write_case(folder, FROM), 1), Silence())
    assert any("s.vtkhdf, frame 2, the last one that was measured" in note for note in summary.notes)


@pytest.mark.parametrize(("more", "line"), [
    ("frame = 3\n", "start.frame = 3: {}: frame 3 was not measured (the images do not match); choose one of 1 to 2"),
    ("frame = 7\n", "start.frame = 7: {}: frame 7 is none of this series; choose one of 1 to 2"),
])
def test_check_refuses_frames_that_are_not_there(folder: Path, more: str, line: str) -> None:
    outcome = CliRunner().invoke(check, [str(write_case(folder, FROM + more))])
    assert outcome.exit_code == 2
    assert outcome.stderr.splitlines() == [line.format(folder / "s.vtkhdf")]


@pytest.mark.parametrize(("text", "line"), [
    ("[start]\nframe = 1\n", "start.frame goes with start.from_result, the result of a series"),
    (FROM + "frame = 0\n", "start.frame = 0: expected at least 1"),
])
def test_a_frame_that_means_nothing_is_refused(folder: Path, text: str, line: str) -> None:
    with pytest.raises(InputError) as caught:
        load_case(write_case(folder, text))
    assert line in str(caught.value)
