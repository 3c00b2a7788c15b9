"""A line that is found by itself, from Python and from the command line."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import ddic
from ddic.cli.check import check
from ddic.cli.run import run
from ddic.errors import InputError

ANGLE = np.deg2rad(64.0)
TANGENT, NORMAL = np.array([np.cos(ANGLE), np.sin(ANGLE)]), np.array([-np.sin(ANGLE), np.cos(ANGLE)])
FOOT = np.array([118.4, 130.2])
SIDE = 256
MESH = ddic.structured_mesh((16, 16, 240, 240), 16)


@cache
def pair(slip: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return ddic.make_synthetic_pair(
        lambda points: np.where((points - FOOT) @ NORMAL > 0, slip / 2, -slip / 2)[:, None] * TANGENT, (SIDE, SIDE),
        noise=1.0, seed=2)


def lines_of(result: ddic.Result) -> list[np.ndarray]:
    sections = json.loads(result.attributes["case"]["json"])["discontinuity"]
    return [np.array(section["vertices"]) for section in sections]


def assert_is_the_line(line: np.ndarray) -> None:
    # One pixel decides at a time of some 250 along the line, of which each is told apart by 0.8 px of slip.
    assert np.abs((line - FOOT) @ NORMAL).max() < 0.3


@pytest.mark.parallel([1, 3])
def test_line_is_found_and_measured_with() -> None:
    result = ddic.measure(pair(0.8), MESH, discontinuity="detect")
    (line,) = lines_of(result)
    assert_is_the_line(line)
    on_line = FOOT + np.linspace(-90, 90, 60)[:, None] * TANGENT
    apart = result.at(on_line + 3 * NORMAL) - result.at(on_line - 3 * NORMAL)
    assert np.sqrt(((apart - 0.8 * TANGENT) ** 2).mean()) < 0.03


def test_no_line_is_found_where_nothing_slips() -> None:
    result = ddic.measure(pair(0.0), MESH, discontinuity="detect")
    assert lines_of(result) == []
    assert "not looked for: curved lines" in result.attributes["case"]["notes"]
    # Noise alone.
    assert result.detection["radon_scores"].max() < 8.0


@pytest.mark.parallel([1, 2])
def test_what_was_seen_is_kept_and_drawn(tmp_path: Path) -> None:
    result = ddic.measure(pair(0.8), MESH, discontinuity="detect")
    seen = result.detection
    assert seen["tresca_strain"].shape == (MESH.n_cells,)
    k, j = np.unravel_index(seen["radon_scores"].argmax(), seen["radon_scores"].shape)
    # Bands lie half an element apart, and half of what a turn by an element at the end makes in angle.
    assert abs(seen["radon_angles"][k] - ANGLE) < 0.05
    assert abs(seen["radon_distances"][j] - (FOOT - 128.0) @ NORMAL) < 16.0
    beside = np.abs((seen["centres"] - FOOT) @ NORMAL)
    # A jump of 0.8 px over 16 px is a shear of 0.05, half of which is the Tresca strain.
    assert 0.015 < np.median(seen["tresca_strain"][beside < 4.0]) < 0.05
    assert np.median(seen["tresca_strain"][beside > 48.0]) < 0.005
    assert len(result.plot("detection").axes) >= 3
    assert ddic.measure(pair(0.8), MESH).detection == {}


def test_damaged_maps_of_what_was_seen_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.vtkhdf"
    ddic.measure(pair(0.8), MESH, discontinuity="detect", output={"file": path})
    with h5py.File(path, "r+") as file:
        values = file["detection/radon_scores"][:]
        del file["detection/radon_scores"]
        file["detection/radon_scores"] = values[:-1]
    with pytest.raises(InputError, match="detection/radon_scores"):
        ddic.open(path)
    with h5py.File(path, "r+") as file:
        del file["detection/radon_scores"]
    with pytest.raises(InputError, match="radon_scores"):
        ddic.open(path)


def test_session_finds_the_line_in_its_first_image_and_keeps_it() -> None:
    reference, deformed = pair(0.8)
    with ddic.prepare(reference, MESH, discontinuity=[{"opening": "tangential"}]) as session:
        assert session.n_assembled == 0
        first, second = session.measure(deformed), session.measure(pair(0.3)[1])
    np.testing.assert_array_equal(lines_of(first), lines_of(second))
    apart = second.at(FOOT[None] + 3 * NORMAL) - second.at(FOOT[None] - 3 * NORMAL)
    np.testing.assert_allclose(apart[0] @ TANGENT, 0.3, atol=0.03)


def test_session_looks_again_until_something_jumps() -> None:
    reference, deformed = pair(0.8)
    with ddic.prepare(reference, MESH, discontinuity="detect") as session:
        assert lines_of(session.measure(pair(0.0)[1])) == []
        assert_is_the_line(lines_of(session.measure(deformed))[0])


@pytest.mark.parametrize("correction", ["global", "element"])
def test_line_is_found_where_brightness_changes(correction: str) -> None:
    reference, deformed = pair(0.8)
    dimmer = np.rint(0.8 * deformed + 12).astype(np.uint8)
    result = ddic.measure((reference, dimmer), MESH, discontinuity="detect",
                          correlation={"grey_correction": correction})
    assert_is_the_line(lines_of(result)[0])


@pytest.mark.parametrize("seed", range(4))
def test_strain_at_the_edge_of_the_region_is_no_line(seed: int) -> None:
    """A line beyond the mesh, to which a band at its edge may point, ends in no line and not in an error."""
    images = ddic.make_synthetic_pair(
        lambda points: np.column_stack([0.05 * np.maximum(points[:, 1] - 226, 0.0), np.zeros(len(points))]),
        (SIDE, SIDE), noise=1.0, seed=seed)
    assert len(lines_of(ddic.measure(images, MESH, discontinuity="detect"))) <= 1


def test_kinematics_of_ones_own_are_refused_before_anything_is_measured() -> None:
    with pytest.raises(InputError, match="discontinuities have kinematics of their own"):
        ddic.measure(pair(0.8), MESH, kinematics=ddic.NodalRegion, discontinuity="detect")


def test_one_line_at_a_time() -> None:
    sections = [{"opening": "both"}, {"vertices": [[0, 0], [200, 200]]}]
    with pytest.raises(InputError, match="has to be the only one"):
        ddic.measure(pair(0.0), MESH, discontinuity=sections)


def test_command_line_says_what_it_found(tmp_path: Path) -> None:
    for name, image in zip(("f", "g"), pair(0.8), strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.tif"), image)
    (tmp_path / "case.toml").write_text(
        'discontinuity = "detect"\n[images]\nreference = "f.tif"\ndeformed = "g.tif"\n[mesh.structured]\n'
        'region = [16, 16, 240, 240]\nelement_size = 16\n[solver]\nmethod = "monolithic"\n')
    checked = CliRunner().invoke(check, [str(tmp_path / "case.toml")])
    assert checked.exit_code == 0, checked.output
    assert "to be found" in checked.output
    ran = CliRunner().invoke(run, [str(tmp_path / "case.toml")])
    assert ran.exit_code == 0, ran.output
    assert ran.output.count("detection: line from (") == 1
    assert_is_the_line(lines_of(ddic.open(tmp_path / "result.vtkhdf"))[0])


@pytest.mark.parametrize("slip", [6.0, 9.0])
def test_a_line_is_found_where_continuous_elements_are_excluded_along_it(slip: float) -> None:
    reference, deformed = pair(slip)
    continuous = ddic.measure((reference, deformed), MESH)
    # Guards the test: pixels that slipped by half an element are explained by no continuous field.
    assert np.isnan(continuous.displacement).any()
    (line,) = lines_of(ddic.measure((reference, deformed), MESH, discontinuity="detect"))
    assert_is_the_line(line)


def test_a_line_is_found_beside_what_was_not_measured() -> None:
    reference, deformed = pair(0.8)
    hidden = deformed.copy()
    hidden[190:256, 0:56] = 0
    result = ddic.measure((reference, hidden), MESH, discontinuity="detect")
    assert np.isnan(result.displacement).any()
    (line,) = lines_of(result)
    assert_is_the_line(line)
