"""``ddic sweep``: what it refuses before anything is tried, and where a folder takes no files."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from ddic.cli.app import command_line
from support.cases import write_case, write_images


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_images(tmp_path)
    write_case(tmp_path)
    return tmp_path


def sweep(folder: Path, *words: str) -> Result:
    return CliRunner().invoke(command_line, ["sweep", str(folder / "case.toml"), *words])


@pytest.mark.parametrize(("words", "said"), [
    (("--lengths", "16,a"), "--lengths 16,a: give numbers with commas between them, 16,32,64 for instance"),
    (("--elements", ""), "--elements : give numbers with commas between them, 16,32,64 for instance"),
])
def test_words_that_are_no_numbers_are_refused_in_a_line(folder: Path, words: tuple[str, ...], said: str) -> None:
    done = sweep(folder, *words)
    assert done.exit_code == 2
    assert done.stderr.splitlines() == [said]


def test_a_case_that_is_not_there_is_refused_in_a_line(tmp_path: Path) -> None:
    done = sweep(tmp_path)
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1
    assert "cannot read this case file" in done.stderr


def test_a_table_that_is_no_earlier_one_stays(folder: Path) -> None:
    (folder / "case.sweep.csv").write_text("mine", encoding="utf-8")
    done = sweep(folder, "--lengths", "0", "--elements", "32")
    assert done.exit_code == 2
    assert "is there already, and no table of trials that ddic wrote" in done.stderr
    assert (folder / "case.sweep.csv").read_text(encoding="utf-8") == "mine"


def test_a_folder_that_takes_no_files_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", "case.sweep.csv")

    # Whoever runs this may write everywhere, root for instance.
    monkeypatch.setattr("ddic.results.sweep.write_sweep", refuse)
    done = sweep(folder, "--lengths", "0", "--elements", "32", "--output", str(folder / "tables"))
    assert done.exit_code == 2
    assert done.stderr.splitlines() == [
        f"{folder / 'tables'}: cannot be written to (Permission denied); choose another --output"]
    assert not (folder / "tables").exists()
