"""A line that opens nowhere beyond noise is told, with what to do."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import ddic
from ddic.cli.run import run

SIDE = 160
MESH = ddic.structured_mesh((16, 16, 144, 144), 16)
ROW = 83.3
"""Of a line along x, in the middle of a row of elements."""

TOLD = re.compile(r"its line does not open beyond noise: the sides part by ([\d.e-]+) px at most, where noise makes a "
                  r"standard deviation of ([\d.e-]+) px")

Options = dict[str, object]


@cache
def pair(slip: float, seed: int = 1) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """What lies below the line slides to the right, all of it moves by a part of a pixel."""
    return ddic.make_synthetic_pair(
        lambda points: np.where(points[:, 1] > ROW, slip, 0.0)[:, None] * np.array([1.0, 0.0]) + 0.3, (SIDE, SIDE),
        noise=2.0, seed=seed)


def with_lines(*rows: float, **others: object) -> Options:
    return {"discontinuity": [{"vertices": [[0, row], [SIDE, row]]} for row in rows], **others}


def measure_notes(slip: float, options: Options, mesh: ddic.Mesh = MESH, seed: int = 1) -> str:
    return str(ddic.measure(pair(slip, seed), mesh, **options).attributes["case"]["notes"])


@pytest.mark.parametrize("cut_off", [None, 64.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_line_that_does_not_open_is_told(cut_off: float | None, seed: int) -> None:
    held = {} if cut_off is None else {"regularization": {"cut_off_wavelength": cut_off}}
    notes = measure_notes(0.0, with_lines(ROW, **held), seed=seed)
    ((largest, deviation),) = (map(float, figures) for figures in TOLD.findall(notes))
    # The largest of eight openings of two components.
    assert 0.5 * deviation < largest < 4 * deviation
    # Noise of 2 grey levels leaves 0.03 px, with l_c two thirds of it; told by one digit.
    assert 0.01 <= deviation <= 0.05
    assert "leave the section out" in notes


def test_images_that_are_alike_are_no_reason_to_change_elements() -> None:
    image = pair(0.0)[0]
    notes = str(ddic.measure((image, image), MESH, **with_lines(ROW)).attributes["case"]["notes"])
    assert "its line does not open" in notes


@pytest.mark.parametrize("cut_off", [None, 64.0])
@pytest.mark.parametrize("slip", [0.3, 2.0])
def test_a_line_that_opens_is_not(slip: float, cut_off: float | None) -> None:
    held = {} if cut_off is None else {"regularization": {"cut_off_wavelength": cut_off}}
    assert "discontinuity" not in measure_notes(slip, with_lines(ROW, **held))


def test_of_two_lines_the_one_that_stays_closed_is_told() -> None:
    notes = measure_notes(0.6, with_lines(ROW, 35.3))
    assert "discontinuity, entry 2: its line does not open" in notes
    assert "entry 1" not in notes


def test_a_line_beside_which_elements_have_no_pixels_is_told_otherwise() -> None:
    """Nothing opens in the middle of 8-px elements: pixels within 2 px of the line do not count."""
    mesh = ddic.structured_mesh((16, 16, 144, 144), 8)
    notes = measure_notes(0.6, with_lines(84.0), mesh)
    assert "discontinuity, entry 1: its line cannot open: the elements that it cuts have too few pixels" in notes
    assert "does not open" not in notes


@pytest.mark.parallel([1, 2, 3, 4])
@pytest.mark.parametrize("method", ["dual", "conjugate_gradient"])
def test_the_note_is_the_same_on_any_number_of_ranks(method: str) -> None:
    notes = measure_notes(0.0, with_lines(ROW, 35.3, solver={"method": method, "subdomains": 4}))
    told = [tuple(map(float, figures)) for figures in TOLD.findall(notes)]
    # What one rank says; linear steps that are iterated leave some per cent of a standard deviation.
    assert told == [(pytest.approx(0.047, rel=0.05), 0.03), (pytest.approx(0.060, rel=0.05), 0.03)]


def test_log_summary_and_result_say_it(tmp_path: Path) -> None:
    for name, image in zip(("f.png", "g.png"), pair(0.0), strict=True):
        cv2.imwrite(str(tmp_path / name), image)
    (tmp_path / "case.toml").write_text(
        '[images]\nreference = "f.png"\ndeformed = "g.png"\n[mesh.structured]\nregion = [16, 16, 144, 144]\n'
        f"element_size = 8\n[[discontinuity]]\nvertices = [[0, {ROW}], [{SIDE}, {ROW}]]\n"
        '[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    told = CliRunner().invoke(run, [str(tmp_path / "case.toml")])
    assert told.exit_code == 0, told.output
    # Half of all elements, on either side, have no unknown of the jump.
    assert "of these elements have too few pixels beside the line to part" in told.output
    (note,) = (line for line in told.output.splitlines() if "its line cannot open" in line)
    assert note in json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["notes"]
    assert note in str(ddic.open(tmp_path / "result.vtkhdf").attributes["case"]["notes"])
