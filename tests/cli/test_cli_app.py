"""The command line as a whole: help, version, and how fast it answers."""

from __future__ import annotations

import sys

import pytest
from click.testing import CliRunner

from ddic import __version__
from ddic.cli.app import COMMANDS, command_line
from support.commands import ddic, finished

HEAVY = ("numpy", "scipy", "cv2", "numba", "meshio", "matplotlib", "mpi4py.MPI", "petsc4py.PETSc", "h5py",
         "rich", "pydantic")


def test_help_lists_the_commands_and_imports_nothing_heavy() -> None:
    code = ("import sys\nfrom click.testing import CliRunner\nfrom ddic.cli.app import command_line\n"
            "result = CliRunner().invoke(command_line, ['--help'])\nassert result.exit_code == 0\n"
            "print(result.output)\n"
            f"print('heavy:', [name for name in {HEAVY!r} if name in sys.modules])\n")
    job = finished([sys.executable, "-c", code])
    assert job.code == 0, job.err
    for name, text in COMMANDS.items():
        assert name in job.out
        assert text.split(".")[0] in " ".join(job.out.split())
    assert "heavy: []" in job.out


def test_the_beginning_imports_nothing_that_may_be_missing() -> None:
    # What fails before there is a command is told in a line by what begins here.
    job = finished([sys.executable, "-c", "import sys, ddic.cli.entry; print('click' in sys.modules)"])
    assert job.out == "False\n", job.err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str) -> None:
    result = CliRunner().invoke(command_line, [name, "--help"])
    assert result.exit_code == 0
    assert "Usage:" in result.output


def test_version() -> None:
    result = CliRunner().invoke(command_line, ["--version"])
    assert result.exit_code == 0
    assert __version__ in result.output


@pytest.mark.parametrize(("words", "line"), [
    ("measure", "ddic: No such command 'measure'; see ddic --help"),
    ("--fast", "ddic: No such option '--fast'; see ddic --help"),
    ("run", "ddic run: Missing argument 'CASE.toml'; see ddic run --help"),
    ("synth translation", "ddic synth translation: Missing option '--output'; see ddic synth translation --help"),
    ("run --fast", "--fast stands where the case file belongs: ddic run CASE.toml [PETSc options]"),
    ("info none.vtkhdf two.vtkhdf", "ddic info: Got unexpected extra argument (two.vtkhdf); see ddic info --help"),
])
def test_words_that_a_command_does_not_take_are_told_in_a_line(words: str, line: str) -> None:
    result = CliRunner().invoke(command_line, words.split(), prog_name="ddic")
    assert result.exit_code == 2
    assert result.output.splitlines() == [line]


def test_module_and_script_are_the_same_program() -> None:
    assert ddic("--version").out == CliRunner().invoke(command_line, ["--version"]).output
