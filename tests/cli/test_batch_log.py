"""A log in a file: lines as they come, and nothing but lines."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from support.cases import write_case, write_images
from support.commands import LIMIT, started, wait_for
from support.patient import ENDLESS, FOUR, patient

pytestmark = pytest.mark.program


@pytest.mark.parametrize("ranks", [0, 2])
def test_a_log_grows_line_by_line(tmp_path: Path, ranks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    write_images(folder)
    write_case(folder, FOUR + ENDLESS)
    log = tmp_path / "ddic.log"
    # A shell's settings for coloured terminals, which batch systems pass on.
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("CLICOLOR_FORCE", "1")
    command = ["env", "-u", "PYTHONUNBUFFERED", "sh", "-c", f'exec "$@" >{log}', "sh", *patient(folder, 1.0)]
    if ranks:
        command = ["sh", "-c", f'exec "$@" >{log}', "sh", "mpiexec", "-n", str(ranks), "env", "-u", "PYTHONUNBUFFERED",
                   *patient(folder, 1.0)]
    with started(command) as process:
        wait_for(tmp_path / "iterating*", max(ranks, 1))
        _wait_for_row(log, 2)
        # Twenty iterations and more of a second each: what is read here was written while the run goes on.
        assert process.poll() is None
    assert all(character == "\n" or character.isprintable() for character in log.read_text(encoding="utf-8"))


def _wait_for_row(log: Path, number: int) -> None:
    """Wait for the row of an iteration."""
    limit = time.monotonic() + LIMIT
    while not any(line.split()[:1] == [str(number)] for line in log.read_text(encoding="utf-8").splitlines()):
        assert time.monotonic() < limit, log.read_text(encoding="utf-8")
        time.sleep(0.1)


def test_a_pipe_gets_plain_lines(tmp_path: Path) -> None:
    write_images(tmp_path)
    write_case(tmp_path, FOUR)
    environment = {**os.environ, "TERM": "xterm-256color", "FORCE_COLOR": "1"}
    done = subprocess.run([sys.executable, "-m", "ddic", "run", str(tmp_path / "case.toml")], env=environment,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True, timeout=LIMIT)
    assert all(character == "\n" or character.isprintable() for character in done.stdout)
