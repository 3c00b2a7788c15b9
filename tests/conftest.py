from __future__ import annotations

import faulthandler
import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from pathlib import Path

# Before numpy is imported: BLAS reads these once.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import support.worker_environment  # noqa: F401  before MPI starts

# isort: split
import cv2
import hypothesis
import pytest
from mpi4py import MPI

RANKS = (1, 2, 3, 4)

cv2.setNumThreads(1)

# Whoever starts the tests in the background, or by nohup, has these ignored; tests send them to programs.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("fixed", deadline=None, derandomize=True)
# Ranks that draw different examples would call different collectives.
_fixed = bool(os.environ.get("CI")) or MPI.COMM_WORLD.size > 1
hypothesis.settings.load_profile("fixed" if _fixed else "local")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage while modules are read and tests made: a fifth of the time went into it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """Leave modules and test items out of the collections after each test: they took half of the time on four ranks."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _collect_on_all_ranks_together() -> Iterator[None]:
    """Destroy distributed objects at one point: the collector may run at different times on the ranks."""
    yield
    if MPI.COMM_WORLD.size > 1:
        gc.collect()
        if "petsc4py.PETSc" in sys.modules:
            sys.modules["petsc4py.PETSc"].garbage_cleanup()
        MPI.COMM_WORLD.barrier()


@pytest.fixture
def shared_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh folder that all ranks see: rank 0's."""
    root = MPI.COMM_WORLD.rank == 0
    path: Path = MPI.COMM_WORLD.bcast(tmp_path_factory.mktemp("shared") if root else None)
    return path


@pytest.fixture
def real_data() -> Path:
    """Folder of the real images; without DDIC_REAL_DATA the test is skipped."""
    folder = os.environ.get("DDIC_REAL_DATA")
    if not folder:
        pytest.skip("DDIC_REAL_DATA is not set")
    path = Path(folder).resolve()
    if not path.is_dir():
        pytest.fail(f"DDIC_REAL_DATA={folder} is not a folder")
    return path


def pytest_configure(config: pytest.Config) -> None:
    """Register what mpi-pytest registers only once a test uses it: -m with an unknown marker is an error."""
    for size in RANKS:
        config.addinivalue_line("markers", f"parallel[{size}]: runs on {size} rank(s)")


def pytest_exception_interact(report: pytest.CollectReport | pytest.TestReport) -> None:
    """Under mpiexec show a failure at once: the other ranks may now wait for ever in a collective."""
    if MPI.COMM_WORLD.size > 1:
        rank = MPI.COMM_WORLD.rank
        sys.stderr.write(f"\nrank {rank}: {report.nodeid}\n{report.longreprtext}\n")
        sys.stderr.flush()


def pytest_unconfigure(config: pytest.Config) -> None:
    """Let every rank print its summary: the first non-zero exit makes mpiexec end the others."""
    if MPI.COMM_WORLD.size > 1:
        # Until the process ends: a rank that never comes here, or hangs in MPI_Finalize, belongs to no test.
        limit = float(config.getini("faulthandler_timeout") or 0)
        if limit > 0:
            faulthandler.dump_traceback_later(limit, file=sys.__stderr__, exit=True)
        MPI.COMM_WORLD.barrier()
