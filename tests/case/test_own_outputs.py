"""What an output may replace."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from ddic.case.loader import load_case
from ddic.case.own_outputs import MAPPING, OPENINGS, PICTURE, check_output, require_own_output
from ddic.cli.app import command_line
from ddic.errors import InputError
from support.cases import write_case, write_images

TABLE = "line,distance_px,x_px,y_px,tangential_px,normal_px\n"


def test_what_is_not_there_or_empty_or_its_own_is_written(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    require_own_output(path, OPENINGS)
    path.touch()
    require_own_output(path, OPENINGS)
    path.write_text(TABLE)
    require_own_output(path, OPENINGS)


@pytest.mark.parametrize("content", [b"x,y,u,v\n1,2,3,4\n", b"II*\0some pixels", b"0\n1\n1\n", b"MATLAB"])
@pytest.mark.parametrize("kind", [OPENINGS, PICTURE, MAPPING])
def test_files_of_others_stay(tmp_path: Path, content: bytes, kind: object) -> None:
    path = tmp_path / "mine"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is there already"):
        require_own_output(path, kind)


LINKS: dict[str, Callable[[Path, Path], None]] = {
    "symbolic": lambda at, to: at.symlink_to(to), "hard": lambda at, to: at.hardlink_to(to)}


@pytest.mark.parametrize("link", LINKS)
def test_links_to_an_input_are_seen(tmp_path: Path, link: str) -> None:
    (tmp_path / "input.csv").write_text(TABLE)
    LINKS[link](tmp_path / "table.csv", tmp_path / "input.csv")
    require_own_output(tmp_path / "table.csv", OPENINGS)
    with pytest.raises(InputError, match=r"would overwrite the input .*input\.csv"):
        require_own_output(tmp_path / "table.csv", OPENINGS, [None, tmp_path / "absent", tmp_path / "input.csv"])


def test_the_folder_that_stands_for_the_file_of_a_case_in_memory_is_no_input(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_images(tmp_path)
    loaded = load_case(write_case(tmp_path))
    below = tmp_path / "below"
    below.mkdir()
    monkeypatch.chdir(tmp_path)
    check_output(replace(loaded, path=Path()).with_output(below / "result.vtkhdf"))


@pytest.mark.parametrize("device", ["/dev/null", "/dev/full", "pipe"])
def test_a_device_is_no_output(tmp_path: Path, device: str) -> None:
    path = tmp_path / device
    if device == "pipe":
        os.mkfifo(path)
    with pytest.raises(InputError, match="is a device or a pipe"):
        require_own_output(path, OPENINGS)


@pytest.mark.parametrize(("text", "is_input"), [
    ('start = "table.csv"', True), ('[[near]]\nmapping_file = "./table.csv"', True),
    ('frames = ["a", "ta*.csv"]', True),
    ('[output]\nfile = "table.csv"', False), ('start = "other.csv"', False), ("no toml", False),
    ('start = "a\\u0000b"', False),
])
@pytest.mark.parametrize("above", [False, True])
def test_inputs_of_a_case_nearby_stay(tmp_path: Path, text: str, is_input: bool, above: bool) -> None:
    folder = tmp_path / "tables" if above else tmp_path
    folder.mkdir(exist_ok=True)
    (folder / "table.csv").write_text(TABLE)
    if above:
        text = text.replace("table.csv", "tables/table.csv").replace("ta*.csv", "t*/ta*.csv").replace("./t", "t")
    (tmp_path / "case.toml").write_text(text)
    if not is_input:
        require_own_output(folder / "table.csv", OPENINGS)
        return
    with pytest.raises(InputError, match=r"an input of .*case\.toml"):
        require_own_output(folder / "table.csv", OPENINGS)


def _call(*words: object) -> Result:
    return CliRunner().invoke(command_line, [str(word) for word in words])


@pytest.mark.parametrize("link", [None, *LINKS])
@pytest.mark.parametrize("input_", ["f.tif", "g.tif", "case.toml", "truth.json"])
@pytest.mark.parametrize("command", ["check", "mesh", "calibrate", "opening", "report", "probe", "export",
                                     "uncertainty", "sweep"])
def test_no_command_replaces_an_input(tmp_path: Path, command: str, input_: str, link: str | None) -> None:
    write_images(tmp_path, side=96)
    case = write_case(tmp_path, region="region = [16, 16, 80, 80]")
    (tmp_path / "truth.json").write_text("{}")
    (tmp_path / "result.vtkhdf").write_text("a result")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    place = tmp_path / "out"
    place.mkdir()
    target, words = _write_words(command, tmp_path / input_ if link is None else place / "linked.png", tmp_path)
    if link is not None or command in ("export", "uncertainty", "sweep"):
        LINKS[link or "hard"](target, tmp_path / input_)
    done = _call(command, *words)
    assert done.exit_code == 2, done.output
    assert len(done.stderr.strip().splitlines()) == 1
    assert str(target) in done.stderr or "--plot" in done.stderr
    assert {path: path.read_bytes() for path in before} == before
    assert case.exists()


def _write_words(command: str, target: Path, folder: Path) -> tuple[Path, list[object]]:
    """Where a command writes, and its arguments; those that name their files by themselves write to ``out``."""
    result, case, place = folder / "result.vtkhdf", folder / "case.toml", folder / "out"
    if command == "export":
        return place / "table.nodes.csv", [result, "--csv", place / "table.csv"]
    if command in ("uncertainty", "sweep"):
        return place / f"case.{command}.csv", [case, "--output", place]
    words: dict[str, list[object]] = {
        "check": [case, "--plot", target], "mesh": [case, "--output", target], "opening": [result, "--output", target],
        "calibrate": [folder / "f.tif", folder / "g.tif", "--ratio", 4, "--output", target],
        "report": [result, "--output", target], "probe": [result, "--point", "40,40", "--csv", target],
    }
    return target, words[command]
