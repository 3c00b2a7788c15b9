"""New files take their names together or not at all; what killed processes left goes, what living ones hold stays."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ddic.io.replace_on_exit import (
    FOREIGN_AGE,
    make_temporary_name,
    remove_abandoned,
    remove_unfinished,
    replaced_on_exit,
    replaced_together,
)

HOLDS = """
import sys, time
from pathlib import Path
from ddic.io.replace_on_exit import replaced_on_exit
with replaced_on_exit(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    print("begun", flush=True)
    time.sleep(60)
"""


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_files_take_their_names_together(tmp_path: Path) -> None:
    old, gone, new = tmp_path / "old", tmp_path / "gone", tmp_path / "new"
    old.write_text("before")
    gone.write_text("before")
    with replaced_together() as files:
        files.begin(old).write_text("after")
        files.remove_old(gone)
        files.begin(new).write_text("after")
        assert old.read_text() == gone.read_text() == "before"
        assert not new.exists()
    assert _names(tmp_path) == ["new", "old"]
    assert old.read_text() == new.read_text() == "after"


def test_where_one_fails_all_stay_as_they_were(tmp_path: Path) -> None:
    old, gone, new = tmp_path / "old", tmp_path / "gone", tmp_path / "new"
    old.write_text("before")
    gone.write_text("before")

    def write() -> None:
        with replaced_together() as files:
            files.begin(old).write_text("after")
            files.remove_old(gone)
            files.begin(new)
            raise OSError(errno.ENOSPC, "full")

    with pytest.raises(OSError, match="full") as caught:
        write()
    assert _names(tmp_path) == ["gone", "old"]
    assert old.read_text() == gone.read_text() == "before"
    # The system names no file where a write fails.
    assert caught.value.filename == str(new)


def test_a_temporary_name_is_told_as_the_final_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="full") as caught, replaced_on_exit(tmp_path / "new") as temporary:
        raise OSError(errno.ENOSPC, "full", str(temporary))
    assert caught.value.filename == str(tmp_path / "new")


def test_a_failure_to_read_keeps_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught, replaced_on_exit(tmp_path / "new"):
        (tmp_path / "absent").read_text()
    assert caught.value.filename == str(tmp_path / "absent")


def test_what_is_begun_goes_before_the_process_is_killed(tmp_path: Path) -> None:
    def write() -> None:
        with replaced_on_exit(tmp_path / "new"):
            remove_unfinished()
            assert _names(tmp_path) == []

    with pytest.raises(FileNotFoundError):
        write()


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_holds_is_not(tmp_path: Path) -> None:
    holder = subprocess.Popen([sys.executable, "-c", HOLDS, str(tmp_path / "new")], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "begun\n"
        (held,) = _names(tmp_path)
        remove_abandoned(tmp_path)
        assert _names(tmp_path) == [held]
    finally:
        holder.kill()
        holder.wait()
    assert _names(tmp_path) == [held]
    remove_abandoned(tmp_path)
    assert _names(tmp_path) == []


def test_another_machines_file_is_removed_only_when_it_is_old(tmp_path: Path) -> None:
    ours = make_temporary_name(tmp_path / "new").name
    machine = ours.split(".")[2]
    theirs = tmp_path / ours.replace(machine, "0123abcd")
    theirs.write_text("half")
    remove_abandoned(tmp_path)
    assert theirs.exists()
    long_ago = time.time() - FOREIGN_AGE - 60
    os.utime(theirs, (long_ago, long_ago))
    remove_abandoned(tmp_path)
    assert not theirs.exists()


@pytest.mark.parametrize("name", [".new.tmp", ".new.12.tmp", "new.0123abcd.12.tmp", ".0123abcd.12.tmp"])
def test_files_of_others_stay(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    os.utime(tmp_path / name, (0, 0))
    remove_abandoned(tmp_path)
    assert _names(tmp_path) == [name]


def test_a_folder_that_is_not_there_holds_nothing_abandoned(tmp_path: Path) -> None:
    remove_abandoned(tmp_path / "none")
