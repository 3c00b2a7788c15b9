"""Mapping files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.images.camera import CameraMapping
from ddic.io.mapping_file import MappingFile, read_mapping_file, write_mapping

SIMPLE = """
homography = [[4, 0.0, -358.5], [0.0, 4.0, -838.5], [0.0, 0.0, 1.0]]
[images]
far_size = [448, 540]
near_size = [900, 640]
"""


def test_a_mapping_by_hand_needs_no_more_than_homography_and_sizes(tmp_path: Path) -> None:
    path = tmp_path / "mapping.toml"
    path.write_text(SIMPLE)
    read = read_mapping_file(path)
    np.testing.assert_array_equal(read.mapping.to_image(np.array([[90.0, 210.0]])), [[1.5, 1.5]])
    assert (read.far_size, read.near_size, read.coefficient) == ((448, 540), (900, 640), None)
    assert not read.homography_std.any()


@given(numbers=st.lists(st.floats(-1e6, 1e6), min_size=8, max_size=8), radial=st.tuples(*[st.floats(-0.1, 0.1)] * 2))
def test_what_is_written_is_read_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, numbers: list[float],
                                                 radial: tuple[float, float]) -> None:
    homography = np.array([*numbers, 1.0]).reshape(3, 3)
    if np.linalg.det(homography) == 0.0:
        return
    path = tmp_path_factory.mktemp("mapping") / "mapping.toml"
    written = MappingFile(CameraMapping(homography, np.array([449.5, 1 / 3]), 552.2, np.array(radial)), (448, 540),
                          (900, 640), np.abs(homography) / 7, np.array([1e-5, 0.0]), 0.1 + 0.2, 0.987)
    write_mapping(path, written)
    read = read_mapping_file(path)
    for name in ("homography", "centre", "radius", "radial"):
        np.testing.assert_array_equal(getattr(read.mapping, name), getattr(written.mapping, name))
    np.testing.assert_array_equal(read.homography_std, written.homography_std)
    np.testing.assert_array_equal(read.radial_std, written.radial_std)
    assert (read.position_std, read.coefficient) == (written.position_std, written.coefficient)
    assert (read.far_size, read.near_size) == (written.far_size, written.near_size)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("homography = [[4, 0.0, -358.5]", "homography = [[4, 0.0]", "homography = [[4, 0.0], [0.0"),
    ("homography", "homografy", "homografy: unknown key; valid here: homography"),
    ("homography", "homografy", "homography: this key is missing"),
    ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 2.0]", "entry [2, 2] is 2; divide all entries by it"),
    ("[0.0, 0.0, 1.0]", "[0.0, 0.0, nan]", "expected three rows of three finite numbers"),
    ("far_size = [448, 540]", "far_size = [448.0, 540]", "images.far_size = [448.0, 540]: expected width and height"),
    ("near_size = [900, 640]", "", "images.near_size: this key is missing"),
    ("[images]", "[distortion]\nradius = 'wide'\n[images]", "distortion.radius = 'wide': expected a finite number"),
    ("[images]", "[distortion]\nradius = 0\n[images]", "radius: expected a positive number of px, got 0"),
    ("[images]", "quality = 3\n[images]", "quality = 3: expected a section"),
    ("[images]", "[images", "not valid TOML"),
])
def test_errors_name_file_key_value_and_remedy(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "mapping.toml"
    assert old in SIMPLE
    path.write_text(SIMPLE.replace(old, new))
    with pytest.raises(InputError) as error:
        read_mapping_file(path)
    assert all(line.startswith(f"{path}: ") for line in error.value.problems)
    assert words in str(error.value)


@pytest.mark.parametrize("text", ["", 'images = {reference = "a"}\n[mesh]\nfile = "b"\n'])
def test_a_file_of_something_else_is_told_once(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mapping.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_mapping_file(path)
    assert error.value.problems == (
        f"{path}: this is no mapping file, for it holds no homography; make one with ddic calibrate",)


def test_a_file_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="make it with ddic calibrate"):
        read_mapping_file(tmp_path / "none.toml")


def test_a_folder_that_is_missing(tmp_path: Path) -> None:
    content = MappingFile(CameraMapping(np.eye(3)), (10, 10), (10, 10))
    with pytest.raises(InputError, match="does not exist"):
        write_mapping(tmp_path / "none" / "mapping.toml", content)
