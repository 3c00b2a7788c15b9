"""A line or a tip that is given beside its place is refined by the residual, or told."""

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
from bench.support.opened_pair import Crack, render_crack
from ddic.cli.run import run
from ddic.errors import SingularSubdomainError

ANGLE = np.deg2rad(17.0)
TANGENT, NORMAL = np.array([np.cos(ANGLE), np.sin(ANGLE)]), np.array([-np.sin(ANGLE), np.cos(ANGLE)])
FOOT = np.array([130.3, 127.6])
SIDE = 256
MESH = ddic.structured_mesh((16, 16, 240, 240), 16)
CRACK = Crack(tip=np.array([140.3, 120.7]), opening_factor=0.25)


@cache
def pair(jump: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Sides that slide by a jump."""
    return ddic.make_synthetic_pair(
        lambda points: np.where((points - FOOT) @ NORMAL > 0, jump, 0.0)[:, None] * TANGENT, (SIDE, SIDE), noise=1.0,
        seed=4)


def options(off: float, turn: float = 0.0, **keys: object) -> dict[str, object]:
    """The line off by some pixels, and turned by some degrees about the middle."""
    angle = ANGLE + np.deg2rad(turn)
    along = np.array([np.cos(angle), np.sin(angle)])
    middle = FOOT + off * NORMAL
    return {"discontinuity": [{"vertices": [(middle - 400 * along).tolist(), (middle + 400 * along).tolist()], **keys}]}


def line_of(result: ddic.Result) -> NDArray[np.float64]:
    return np.array(json.loads(result.attributes["case"]["json"])["discontinuity"][0]["vertices"])


def find_errors(result: ddic.Result, jump: float) -> NDArray[np.float64]:
    opening = ddic.measure_opening(result)
    # The left side is that of -y, which stands still.
    return np.hypot(opening.tangential + jump, opening.normal)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("off", "turn"), [(2.0, 0.0), (-5.0, 0.0), (0.0, 2.0)])
def test_a_line_that_is_off_is_refined(off: float, turn: float) -> None:
    result = ddic.measure(pair(4.0), MESH, **options(off, turn))
    inside = FOOT + np.array([[-110.0], [110.0]]) * TANGENT
    start, end = line_of(result)
    normal = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
    assert np.abs((inside - start) @ normal).max() < 0.5
    # Nodes at the ends of thin parts have some hundredths of a pixel of noise.
    assert find_errors(result, 4.0).max() < 0.1
    assert "discontinuity, entry 1: its line was off" in str(result.attributes["case"]["notes"])


def test_a_line_in_its_place_stays_and_is_measured_with_once() -> None:
    asked = options(0.3)
    with ddic.prepare(pair(4.0)[0], MESH, **asked) as session:
        result = session.measure(pair(4.0)[1])
        assert session.n_factorized == 1
    np.testing.assert_array_equal(line_of(result), asked["discontinuity"][0]["vertices"])  # type: ignore[index]
    assert "discontinuity" not in str(result.attributes["case"]["notes"])


@pytest.mark.parametrize("uncertainty", [0.0, 1e-300])
def test_without_uncertainty_the_line_is_taken_as_it_is(uncertainty: float) -> None:
    asked = options(2.0, uncertainty=uncertainty)
    result = ddic.measure(pair(4.0), MESH, **asked)
    np.testing.assert_array_equal(line_of(result), asked["discontinuity"][0]["vertices"])  # type: ignore[index]


def test_what_a_line_takes_from_nodes_is_the_reason_of_a_singular_operator() -> None:
    with pytest.raises(SingularSubdomainError, match="stand beside a discontinuity: its line may be off") as caught:
        ddic.measure(pair(6.0), MESH, **options(6.0, uncertainty=0.0), solver={"method": "monolithic"})
    assert "too little texture" not in str(caught.value)


def test_the_log_says_how_far_the_line_was_moved(tmp_path: Path) -> None:
    for name, image in zip(("f.png", "g.png"), pair(4.0), strict=True):
        cv2.imwrite(str(tmp_path / name), image)
    (tmp_path / "case.toml").write_text(
        '[images]\nreference = "f.png"\ndeformed = "g.png"\n[mesh.structured]\nregion = [16, 16, 240, 240]\n'
        "element_size = 16\n[[discontinuity]]\n"
        f"vertices = {options(2.0)['discontinuity'][0]['vertices']}\n"  # type: ignore[index]
        '[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    told = CliRunner().invoke(run, [str(tmp_path / "case.toml")])
    assert told.exit_code == 0, told.output
    moved = re.search(r"moved by up to ([\d.]+) px", told.output)
    assert moved is not None
    np.testing.assert_allclose(float(moved[1]), 2.0, atol=0.5)
    assert np.abs((line_of(ddic.open(tmp_path / "result.vtkhdf")) - FOOT) @ NORMAL).max() < 0.5


@cache
def cracked_pair() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    return render_crack(CRACK, SIDE, noise=1.0)


def up_to(ahead: float, beside: float = 0.0, **keys: object) -> dict[str, object]:
    """The crack's line up to its tip, which is off along it and across it."""
    end = CRACK.tip + ahead * CRACK.along + beside * np.array([-CRACK.along[1], CRACK.along[0]])
    vertices = [(end - 400 * CRACK.along).tolist(), end.tolist()]
    return {"discontinuity": [{"vertices": vertices, "tip_functions": True, **keys}]}


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("ahead", "beside", "cut_off"), [(-5.0, 0.0, 80.0), (4.0, 0.0, None), (-4.0, 2.5, None)])
def test_a_tip_that_is_off_is_refined_with_its_line(ahead: float, beside: float, cut_off: float | None) -> None:
    held = {} if cut_off is None else {"regularization": {"cut_off_wavelength": cut_off}}
    with ddic.prepare(cracked_pair()[0], MESH, **up_to(ahead, beside), **held) as session:
        result = session.measure(cracked_pair()[1])
        again = session.measure(cracked_pair()[1])
    end = line_of(result)[1]
    # Four standard deviations of what noise makes of the tip's place; a line is refined to half a pixel.
    assert abs((end - CRACK.tip) @ CRACK.along) < 0.6
    assert abs((end - CRACK.tip) @ np.array([-CRACK.along[1], CRACK.along[0]])) < 0.5
    notes = str(result.attributes["case"]["notes"])
    assert notes.count("its tip was off") == 1
    assert notes.count("its line was off") == (beside > 0)
    np.testing.assert_array_equal(line_of(again), line_of(result))


def test_a_tip_in_its_place_stays_and_is_measured_with_once() -> None:
    asked = up_to(0.3)
    with ddic.prepare(cracked_pair()[0], MESH, **asked) as session:
        result = session.measure(cracked_pair()[1])
        assert session.n_factorized == 1
    np.testing.assert_array_equal(line_of(result), asked["discontinuity"][0]["vertices"])  # type: ignore[index]


def test_without_tip_functions_a_line_may_go_on_beyond_the_tip() -> None:
    asked = up_to(30.0, tip_functions=False)
    result = ddic.measure(cracked_pair(), MESH, **asked)
    np.testing.assert_array_equal(line_of(result), asked["discontinuity"][0]["vertices"])  # type: ignore[index]


def test_a_tip_that_is_farther_off_than_it_may_be_stays_and_is_told() -> None:
    asked = up_to(-8.0, uncertainty=2.0)
    result = ddic.measure(cracked_pair(), MESH, **asked)
    np.testing.assert_array_equal(line_of(result), asked["discontinuity"][0]["vertices"])  # type: ignore[index]
    assert "would move its tip by +" in str(result.attributes["case"]["notes"])


def test_a_tip_without_room_about_it_is_told() -> None:
    result = ddic.measure(cracked_pair(), ddic.structured_mesh((16, 16, 240, 240), 4), **up_to(-5.0),
                          regularization={"cut_off_wavelength": 40.0})
    assert ("its tip was not looked at: 4 elements leaves Williams' series 16 px, and it needs 24"
            in str(result.attributes["case"]["notes"]))
