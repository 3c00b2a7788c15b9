"""A rank that cannot start ends all of them, with one line; a limit on memory is named before it bites."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest
from numba.core import caching

from ddic.cli import failures
from ddic.cli.failures import failures_as_lines
from support.cases import write_case, write_images
from support.commands import DDIC, Finished, driven, finished, started, wait_for

pytestmark = pytest.mark.program

SECONDS_TO_END = 20.0
"""A start takes two or three seconds, on a busy machine five; a job that hangs takes LIMIT."""

BROKEN = """
import os, sys
from pathlib import Path
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            raise {error}
if os.environ["OMPI_COMM_WORLD_RANK"] in {ranks}:
    sys.meta_path.insert(0, Finder())
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inner = tmp_path / "run"
    inner.mkdir()
    write_images(inner)
    write_case(inner)
    return inner


def _own_lines(job: Finished) -> list[str]:
    assert job.seconds < SECONDS_TO_END
    return job.errors


# MPI runs by then: PETSc has begun it. Without mpi4py nothing can be aborted through it.
@pytest.mark.parametrize(("name", "error", "said"), [
    ("mpi4py", "ImportError('no such library')", "ddic could not start (ImportError: no such library)"),
    ("ddic.methods.run", "MemoryError()", "out of memory: see free -m, and ulimit -v"),
])
def test_a_rank_that_cannot_start_ends_all(folder: Path, name: str, error: str, said: str) -> None:
    job = finished(driven(BROKEN.format(name=name, error=error, ranks=["1"]), folder), 2)
    assert job.code == 1
    assert _own_lines(job) == [f"rank 1: {said}"]


def test_what_keeps_all_ranks_from_starting_is_said_once(folder: Path) -> None:
    broken = BROKEN.format(name="cv2", error="ImportError('no such library')", ranks=["0", "1", "2"])
    job = finished(driven(broken, folder), 3)
    assert job.code == 1
    assert _own_lines(job) == ["ddic could not start (ImportError: no such library)"]


def test_a_signal_to_one_rank_that_starts_ends_all(folder: Path) -> None:
    # Rank 1 waits where PETSc, and MPI with it, has begun; rank 0 goes on to the first sum of all.
    slow = f"""
import os, sys, time
from pathlib import Path
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "ddic.methods.run" and os.environ["OMPI_COMM_WORLD_RANK"] == "1":
            Path({str(folder.parent / "pid1")!r}).write_text(str(os.getpid()))
            time.sleep(2.0)
sys.meta_path.insert(0, Finder())
"""
    with started(driven(slow, folder), 2) as process:
        wait_for(folder.parent / "pid1")
        time.sleep(0.5)
        os.kill(int((folder.parent / "pid1").read_text()), signal.SIGINT)
        _, err = process.communicate(timeout=SECONDS_TO_END)
    assert process.returncode == 130
    assert Finished(process.returncode, "", err, 0.0).errors == ["interrupted; no result was written"]


def test_all_ranks_end_without_lines_of_the_launcher(folder: Path) -> None:
    write_case(folder, deformed="h.tif")
    job = finished([*DDIC, "run", str(folder / "case.toml")], 2)
    assert job.code == 2
    assert job.err.splitlines() == [f"{folder / 'h.tif'}: no such image file; check the path"]


def _limited(command: list[str], mebibytes: int) -> subprocess.CompletedProcess[str]:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (mebibytes * 2**20, mebibytes * 2**20))

    return subprocess.run(command, text=True, capture_output=True, timeout=SECONDS_TO_END, check=False,
                          preexec_fn=limit)


# Below each, libraries fail in a way of their own; OpenBLAS by a loop, a little above 1000.
@pytest.mark.parametrize("mebibytes", [150, 600, 1050, 1500])
def test_too_little_address_space_is_refused(folder: Path, mebibytes: int) -> None:
    job = _limited([sys.executable, "-m", "ddic", "run", str(folder / "case.toml")], mebibytes)
    assert job.returncode == 1
    lines = job.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"the address space of a process is limited to {mebibytes} MiB (ulimit -v)")


MPI_ENVIRONMENT = Path(__file__).parents[2] / "scripts" / "mpi_env.sh"


def test_a_limit_of_file_sizes_keeps_no_launcher_waiting(folder: Path) -> None:
    # PMIx would map a file of 4 MiB before the first rank starts, and wait for ever where it cannot.
    script = '. "$1"; shift; ulimit -f 8; exec timeout -k 5 "$@"'
    command = ["bash", "-c", script, "sh", str(MPI_ENVIRONMENT), str(SECONDS_TO_END), "mpiexec", "-n", "2", *DDIC,
               "run", str(folder / "case.toml")]
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI_", "PMIX_"))}
    done = subprocess.run(command, env=clean, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
                          timeout=2 * SECONDS_TO_END)
    assert done.returncode == 1
    assert "result.vtkhdf could not be read or written: File too large" in done.stderr


def test_no_folder_for_kernels_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    # As where neither the sources' folder nor the user's may be written to.
    monkeypatch.setattr(failures, "find_rank", lambda: None)
    monkeypatch.setattr(caching.CompileResultCacheImpl, "_locator_classes", [])
    with pytest.raises(SystemExit) as end, failures_as_lines():
        numba.njit(cache=True)(write_case)
    assert end.value.code == 1
    assert capsys.readouterr().err.splitlines() == ["there is no folder in which compiled kernels can be kept; set "
                                                    "NUMBA_CACHE_DIR to one that you may write to"]
