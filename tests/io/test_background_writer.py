"""Files written in the background: whole under their names, and an error that is not lost."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from ddic.errors import InputError
from ddic.io import series_writer
from ddic.io.series_writer import BackgroundWriter, ReadAhead


def test_files_are_whole_and_none_is_lost(tmp_path: Path) -> None:
    contents = {tmp_path / f"{k}.bin": bytes([k]) * (1 << 20) for k in range(5)}
    with BackgroundWriter() as writer:
        for path, content in contents.items():
            writer.write(path, content)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == contents


def test_the_program_goes_on_while_a_file_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    may_go_on, names = threading.Event(), []

    def wait_and_write(path: Path, content: bytes) -> None:
        # Longer than this test waits below: it fails where nobody lets it go on.
        assert may_go_on.wait(timeout=30)
        names.append(path.name)

    monkeypatch.setattr(series_writer, "_write", wait_and_write)
    with BackgroundWriter() as writer:
        writer.write(tmp_path / "one", b"")
        assert names == []
        may_go_on.set()
        writer.write(tmp_path / "two", b"")
        assert names[0] == "one"
    assert names == ["one", "two"]


def test_what_cannot_be_written_is_told_at_the_next_file_or_at_the_end(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere" / "file"
    with BackgroundWriter() as writer:
        writer.write(nowhere, b"")
        with pytest.raises(InputError, match="nowhere"):
            writer.write(tmp_path / "next", b"")
    last = BackgroundWriter()
    last.write(nowhere, b"")
    with pytest.raises(InputError, match="nowhere"):
        last.__exit__(None, None, None)
    assert list(tmp_path.iterdir()) == []


def test_an_error_in_the_block_is_the_one_that_is_told(tmp_path: Path) -> None:
    def fail() -> None:
        with BackgroundWriter() as writer:
            writer.write(tmp_path / "nowhere" / "file", b"")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()


def test_reading_ahead_leaves_missing_files_to_whoever_needs_them(tmp_path: Path) -> None:
    (tmp_path / "large").write_bytes(bytes(9 << 20))
    with ReadAhead() as reader:
        reader.begin([tmp_path / "nowhere", tmp_path / "large", tmp_path])
