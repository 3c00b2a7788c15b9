"""Two runs never write one result at a time, and a run that was killed stops none."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ddic.errors import InputError
from ddic.io.replace_on_exit import held_output, make_temporary_name

HOLDS = """
import sys, time
from pathlib import Path
from ddic.io.replace_on_exit import held_output
with held_output(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_run_is_refused_and_told_of_the_first(tmp_path: Path) -> None:
    path = tmp_path / "result.vtkhdf"
    with held_output(path):
        with pytest.raises(InputError, match=rf"is being written by another run \(process {os.getpid()} on"):
            held_output(path).__enter__()
        with held_output(tmp_path / "other.vtkhdf"):
            pass
    with held_output(path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_killed_run_stops_no_other_and_its_files_go(tmp_path: Path) -> None:
    path = tmp_path / "result.vtkhdf"
    holder = subprocess.Popen([sys.executable, "-c", HOLDS, str(path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"process {holder.pid} on"):
            held_output(path).__enter__()
    finally:
        holder.kill()
        holder.wait()
    assert [found.name for found in tmp_path.iterdir()] == [".result.vtkhdf.lock"]
    make_temporary_name(path).write_text("half")
    with held_output(path):
        assert [found.name for found in tmp_path.iterdir()] == [".result.vtkhdf.lock"]
    assert list(tmp_path.iterdir()) == []
