"""Deformed images of a series: lists and patterns, their order and times, and what does not go together."""

from __future__ import annotations

from pathlib import Path

import pytest

from ddic.case.loader import LoadedCase, load_case
from ddic.case.named_files import choose_frame, is_series, list_deformed, list_times
from ddic.errors import InputError

MESH = "[mesh.structured]\nregion = [0, 0, 32, 32]\nelement_size = 16\n"


def load(folder: Path, images: str, more: str = "") -> LoadedCase:
    path = folder / "case.toml"
    path.write_text(f'[images]\nreference = "f.tif"\n{images}\n{more}\n{MESH}', encoding="utf-8")
    return load_case(path)


def refuse(folder: Path, images: str, more: str = "") -> list[str]:
    with pytest.raises(InputError) as caught:
        load(folder, images, more)
    return list(caught.value.problems)


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()


def test_a_pattern_takes_files_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    touch(tmp_path, "g_10.tif", "g_2.tif", "g_1.tif", "other.tif", "run2/g_3.tif")
    case = load(tmp_path, 'deformed = "g_*.tif"').case
    assert list_deformed(case.images) == tuple(tmp_path / f"g_{k}.tif" for k in (1, 2, 10))
    assert is_series(case)
    assert list_times(case) == (1.0, 2.0, 3.0)
    listed = load(tmp_path, 'deformed = ["other.tif", "g_?.tif"]').case
    assert [path.name for path in list_deformed(listed.images)] == ["other.tif", "g_1.tif", "g_2.tif"]


def test_one_image_is_no_series_and_a_list_of_one_is(tmp_path: Path) -> None:
    case = load(tmp_path, 'deformed = "g.tif"').case
    assert not is_series(case)
    assert list_deformed(case.images) == (tmp_path / "g.tif",)
    assert list_times(case) == (1.0,)
    assert choose_frame(case, 0) is case
    assert is_series(load(tmp_path, 'deformed = ["g.tif"]').case)


def test_a_file_may_be_called_like_a_pattern(tmp_path: Path) -> None:
    touch(tmp_path, "g[1].tif")
    assert not is_series(load(tmp_path, 'deformed = "g[1].tif"').case)


def test_times_are_given_one_by_one_or_by_their_interval(tmp_path: Path) -> None:
    three = 'deformed = ["a.tif", "b.tif", "c.tif"]\n'
    assert list_times(load(tmp_path, three + "deformed_time = [0.5, 2, 7]").case) == (0.5, 2.0, 7.0)
    assert list_times(load(tmp_path, three + "reference_time = 10\nframe_interval = 0.25").case) == (10.25, 10.5, 10.75)


def test_a_frame_is_a_case_of_a_pair(tmp_path: Path) -> None:
    loaded = load(tmp_path, 'deformed = ["a.tif", "b.tif"]\nframe_interval = 0.5')
    of_second = choose_frame(loaded.case, 1)
    assert of_second.images.deformed == tmp_path / "b.tif"
    assert of_second.images.deformed_time == 1.0
    assert not is_series(of_second)
    assert not of_second.output.residual_image
    asked = load(tmp_path, 'deformed = ["a.tif", "b.tif"]', "[output]\nresidual_image = true")
    assert choose_frame(asked.case, 0).output.residual_image
    # What is told as the case is what the frame was measured with.
    assert "b.tif" in of_second.model_dump_json()
    assert "a.tif" not in of_second.model_dump_json()


@pytest.mark.parametrize(("images", "more", "words"), [
    ('deformed = "h_*.tif"', "", ["images", "h_*.tif", "no file matches"]),
    ("deformed = []", "", ["images.deformed"]),
    ('deformed = ["a.tif", "b.tif"]\ndeformed_time = [1, 2, 3]', "", ["images.deformed_time", "3 times for 2"]),
    ('deformed = ["a.tif", "b.tif"]\ndeformed_time = [2, 1]', "", ["images.deformed_time", "grow"]),
    ('deformed = ["a.tif", "b.tif"]\ndeformed_time = 4', "", ["images.deformed_time", "one time for 2"]),
    ('deformed = ["a.tif", "b.tif"]\ndeformed_time = [1, 2]\nframe_interval = 1', "",
     ["frame_interval", "one of them"]),
    ('deformed = "a.tif"\ndeformed_time = [1, 2]', "", ["images.deformed_time", "one number"]),
    ('deformed = "a.tif"\nframe_interval = 1', "", ["images.frame_interval"]),
    ('deformed = "a.tif"', '[series]\nstart = "last"', ["[series]", "several"]),
    ('deformed = ["a.tif", "b.tif"]', "[pgd]", ["[pgd]", "one pair"]),
    ('deformed = ["a.tif", "b.tif"]', "[[discontinuity]]", ["discontinuity.vertices"]),
    ('deformed = ["a.tif", "b.tif"]', '[[near]]\nreference = "n.tif"\ndeformed = "m.tif"\nratio = 4\noffset = [0, 0]',
     ["near, entry 1", "1 images", "2"]),
    ('deformed = "a.tif"', '[[near]]\nreference = "n.tif"\ndeformed = ["m.tif", "k.tif"]\nratio = 4\noffset = [0, 0]',
     ["near, entry 1", "several images"]),
])
def test_what_does_not_go_together_is_one_line(tmp_path: Path, images: str, more: str, words: list[str]) -> None:
    (line,) = refuse(tmp_path, images, more)
    assert "case.toml" in line
    for word in words:
        assert word in line
