"""``make test`` itself, on small suites: what it takes for a test that hangs, and what for one that is lost."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.program

ROOT = Path(__file__).parents[1]
LIMIT = 6
"""Seconds for one test; to start pytest on two ranks takes two or three on an idle machine, and counts for no test."""
N_SLOW = 4
SECONDS = 1.6
"""Of each slow test: all of them take longer than LIMIT, one far less."""
HANG_S = 300
"""Far beyond the limit of the test itself, which would end the suite from outside."""

SERIAL = "def test_serial():\n    pass\n"
PARALLEL = ("import time\nimport pytest\nfrom mpi4py import MPI\n"
            "@pytest.mark.parallel([1, 2])\ndef test_parallel():\n    assert MPI.COMM_WORLD.allreduce(1) >= 1\n")
SLOW = (f"@pytest.mark.parallel(2)\n@pytest.mark.parametrize('number', range({N_SLOW}))\n"
        f"def test_slow(number):\n    time.sleep({SECONDS})\n")
HANGS = ("@pytest.mark.parallel(2)\ndef test_hangs():\n"
         "    if MPI.COMM_WORLD.rank == 1:\n        MPI.COMM_WORLD.barrier()\n"
         f"    else:\n        time.sleep({HANG_S})\n")


def _run_suite(folder: Path, tests: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    (folder / "tests").mkdir()
    (folder / "tests" / "test_small.py").write_text(tests, encoding="utf-8")
    shutil.copy(ROOT / "tests" / "conftest.py", folder / "tests")
    shutil.copytree(ROOT / "tests" / "support", folder / "tests" / "support")
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    shutil.copy(ROOT / "pyproject.toml", folder)
    own = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "OMPI_COMM", "PMIX_"))}
    environment = {**own, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{own['PATH']}",
                   "DDIC_TEST_TIMEOUT": str(LIMIT), "DDIC_TEST_RANKS": "2", "PYTEST_XDIST_AUTO_NUM_WORKERS": "1"}
    return subprocess.run(["bash", "scripts/run_tests.sh", *arguments], cwd=folder, env=environment, text=True,
                          capture_output=True, timeout=HANG_S, check=False)


def _verdict(done: subprocess.CompletedProcess[str], name: str) -> str:
    """What the summary says of a part of the suite, without its seconds."""
    line = next(line for line in done.stdout.split("== summary")[1].splitlines() if line.startswith(name))
    return line.partition(" s  ")[2]


def test_many_tests_may_take_longer_than_one(tmp_path: Path) -> None:
    done = _run_suite(tmp_path, PARALLEL + SLOW + SERIAL)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [_verdict(done, name) for name in ("1 rank", "2 ranks")] == ["passed"] * 2


def test_a_test_that_hangs_inside_mpi_ends_the_run_and_is_named(tmp_path: Path) -> None:
    done = _run_suite(tmp_path, PARALLEL + HANGS + SERIAL)
    assert done.returncode == 1
    assert _verdict(done, "2 ranks").startswith("FAILED")
    assert _verdict(done, "1 rank") == "passed"
    assert "in test_hangs" in done.stdout + done.stderr


def test_losing_all_parallel_marks_fails(tmp_path: Path) -> None:
    done = _run_suite(tmp_path, SERIAL)
    assert done.returncode == 1
    assert _verdict(done, "1 rank") == "passed"
    assert _verdict(done, "2 ranks") == "FAILED: no test is marked"


def test_who_names_serial_tests_needs_no_parallel_ones(tmp_path: Path) -> None:
    done = _run_suite(tmp_path, SERIAL, "tests/test_small.py")
    assert done.returncode == 0
    assert _verdict(done, "2 ranks") == "no test is marked"
