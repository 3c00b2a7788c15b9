"""Standard output that cannot be written, numbers that are none, and what PETSc refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import ddic
from ddic.cli import entry
from ddic.cli.app import command_line
from ddic.cli.failures import describe_petsc_error
from ddic.io import image_file
from support.cases import write_case, write_images

FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.is_char_device(), reason="needs a device that is always full")
def test_a_full_standard_output_is_said_in_a_line() -> None:
    with FULL.open("w") as full:
        done = subprocess.run([sys.executable, "-m", "ddic", "--help"], stdout=full, stderr=subprocess.PIPE, text=True,
                              check=False, timeout=60)
    assert done.returncode == 1
    assert done.stderr.splitlines() == ["standard output cannot be written (No space left on device); make room, or "
                                        "print elsewhere"]


CLOSED = ("sh", "-c", 'exec "$@" >&- 2>&- <&-', "sh")
"""Runs a command whose standard streams are closed."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("case")
    write_images(made)
    write_case(made)
    return made


@pytest.mark.program
@pytest.mark.parametrize("command", ["check", "run"])
def test_a_pipe_that_nobody_reads_ends_a_command_without_a_trace(folder: Path, command: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([sys.executable, "-m", "ddic", command, str(folder / "case.toml")], stdout=writing,
                          stderr=subprocess.PIPE, text=True, check=False, timeout=60)
    os.close(writing)
    # PETSc's own end is code 59 and ten lines; Rich's was taken for an interruption, 130.
    assert done.returncode == 1
    said = "standard output, or a file, could not be read or written: Broken pipe"
    assert done.stderr.splitlines() == ([said] if command == "run" else [])


@pytest.mark.program
@pytest.mark.parametrize("command", ["check", "run"])
def test_closed_streams_change_nothing_but_what_is_seen(folder: Path, command: str) -> None:
    done = subprocess.run([*CLOSED, sys.executable, "-m", "ddic", command, str(folder / "case.toml")], check=False,
                          timeout=60)
    assert done.returncode == 0
    if command == "run":
        # Nothing that is printed is written into a file that has taken the number of a closed stream.
        assert ddic.open(folder / "result.vtkhdf").converged


def test_a_working_directory_that_was_deleted_is_said_in_a_line(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    script = 'cd "$1" && rmdir "$1" && shift && exec "$@"'
    done = subprocess.run(["sh", "-c", script, "sh", str(gone), sys.executable, "-m", "ddic", "check", "case.toml"],
                          capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["the working directory cannot be found (No such file or directory): it was "
                                        "deleted or closed; change to another one"]


def test_a_clock_that_python_cannot_read_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def read() -> float:
        raise OverflowError("timestamp too large to convert to C _PyTime_t")

    monkeypatch.setattr(entry.time, "time", read)
    done = CliRunner().invoke(command_line, ["info", "r.vtkhdf"])
    assert done.exit_code == 1
    assert done.stderr.splitlines() == ["the system's clock stands before 1678 or after 2261, of which Python cannot "
                                        "tell the time: set it right (date)"]


@pytest.mark.parametrize("size", ["10x99999999999999999999", "1000001x10", "10x" + "9" * 5000])
def test_a_size_that_no_image_has_is_refused(size: str, tmp_path: Path) -> None:
    words = ["synth", "translation", "--size", size, "--output", str(tmp_path / "made")]
    done = CliRunner().invoke(command_line, words)
    assert done.exit_code == 2
    assert "images have 1000000 columns and rows at most" in done.stderr
    assert not (tmp_path / "made").exists()


def test_a_name_that_is_no_text_can_be_printed(tmp_path: Path) -> None:
    name = os.fsdecode(os.fsencode(tmp_path) + b"/\xff.tif")
    done = subprocess.run([sys.executable, "-m", "ddic", "info", name], capture_output=True, text=True, check=False,
                          timeout=60)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "no such file" in done.stderr


@pytest.mark.parametrize("words", [
    ("plot", "r.vtkhdf", "--amplification", "nan"), ("plot", "r.vtkhdf", "--limits", "nan", "1"),
    ("crack", "r.vtkhdf", "--tip", "1", "inf")])
def test_nan_and_infinity_are_no_numbers(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(command_line, words)
    assert done.exit_code == 2
    assert "is not a finite number" in done.stderr


class _Refusal(Exception):
    """Like PETSc's, whose text is its stack with the reason last."""

    ierr = 86

    def __str__(self) -> str:
        return "error code 86\n[0] KSPSetFromOptions() at /x.c:1\n[0] Unable to find requested KSP type nosuch"


def test_what_petsc_refuses_is_a_wrong_input_where_it_was_asked_for() -> None:
    line, code = describe_petsc_error(_Refusal(), ("-dual_ksp_type", "nosuch"))
    assert (line, code) == ("PETSc refuses its options -dual_ksp_type nosuch: Unable to find requested KSP type nosuch "
                            "(error 86)", 2)
    assert describe_petsc_error(_Refusal(), ())[1] == 1


def test_info_decodes_an_image_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Three bands of rows, which were decoded one by one, and once more for the header.
    grey = np.random.default_rng(1).integers(0, 255, (1600, 1600)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), grey)
    decoded, imread = [], cv2.imread

    def count(*words: object) -> object:
        decoded.append(words)
        return imread(*words)

    monkeypatch.setattr(image_file.cv2, "imread", count)
    assert CliRunner().invoke(command_line, ["info", str(tmp_path / "a.png")]).exit_code == 0
    assert len(decoded) == 1
