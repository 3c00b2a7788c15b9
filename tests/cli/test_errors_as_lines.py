"""What a command says where it fails."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from ddic.cli.failures import failures_as_lines
from ddic.errors import ConvergenceError, InputError


def test_a_problem_is_a_line_and_tells_the_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, failures_as_lines():
        raise InputError(["a.toml: mesh.size: 0; give a size", "a.toml: images: none; give two"])
    assert ended.value.code == 2
    said = capsys.readouterr()
    assert said.err.splitlines() == ["a.toml: mesh.size: 0; give a size", "a.toml: images: none; give two"]
    assert said.out == ""


def test_what_is_no_users_mistake_has_another_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, failures_as_lines():
        raise ConvergenceError("it does not converge")
    assert ended.value.code == 1
    assert capsys.readouterr().err == "it does not converge\n"


def test_a_target_that_cannot_be_written_to_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, failures_as_lines(Path("full")):
        raise OSError(errno.EISDIR, "Is a directory")
    assert ended.value.code == 2
    assert capsys.readouterr().err == "full: cannot be written to (Is a directory); choose another --output\n"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_a_full_or_broken_disk_is_nobodys_mistake(number: int, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, failures_as_lines(Path("full")):
        raise OSError(number, "why")
    assert ended.value.code == 1
    assert capsys.readouterr().err == "full: cannot be written to (why); choose another --output\n"


def test_other_failures_are_not_hidden() -> None:
    with pytest.raises(OSError, match="broken"), failures_as_lines():
        raise OSError("broken")
    with pytest.raises(ZeroDivisionError), failures_as_lines(Path("full")):
        _ = 1 / 0
