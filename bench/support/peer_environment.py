"""The peers' environment, never ddic's own: made at first use in bench/data/peers-venv, with one thread a process."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.support.runs import DATA, ROOT

REQUIREMENTS = ("pyxel-dic>=2026.10.8", "pyvale>=2026.10.2", "numba>=0.60", "al-dvc>=1.2.1", "spam>=0.9.1")
TIMEOUT = "3600"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
FOLDER = DATA / "peers-venv"


def peers_are_there() -> bool:
    """Say whether the peers' environment was made before.

    Returns
    -------
    bool
        False where ``peers_python`` would install it.
    """
    return (FOLDER / "requirements.json").is_file()


def peers_python() -> Path:
    """The interpreter of the peers' environment, which is made where it is missing or was made for other requirements.

    Raises RuntimeError where the packages cannot be installed.
    """
    python, stamp = FOLDER / "bin" / "python", FOLDER / "requirements.json"
    wanted = json.dumps(REQUIREMENTS)
    if not stamp.is_file() or stamp.read_text(encoding="utf-8") != wanted:
        _succeed([sys.executable, "-m", "venv", "--clear", str(FOLDER)])
        _succeed([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *REQUIREMENTS])
        stamp.write_text(wanted, encoding="utf-8")
    return python


def run_peer(job: Path, *arguments: str) -> tuple[dict[str, Any], float]:
    """Run a job of the peers' environment in a process of its own; see ``run_job``."""
    return run_job([str(peers_python()), str(job), *arguments])


def run_ddic(module: str, n_ranks: int, *arguments: str) -> tuple[dict[str, Any], float]:
    """Run a job of ddic's environment on some ranks; see ``run_job``."""
    launcher = os.environ.get("MPIEXEC", "mpiexec")
    return run_job([launcher, "-n", str(n_ranks), sys.executable, "-m", "mpi4py", "-m", module, *arguments])


def run_job(command: Sequence[str]) -> tuple[dict[str, Any], float]:
    """Run a command with one thread a process.

    Returns the record that its last line holds as JSON, and the CPU seconds of it and of all that it started.
    Raises RuntimeError where the command fails.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    printed = _succeed(["timeout", TIMEOUT, *command])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    record: dict[str, Any] = json.loads(printed.splitlines()[-1])
    return record, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _succeed(command: Sequence[str]) -> str:
    """Standard output of a command that must succeed."""
    # The peers' environment must see neither ddic's source nor a window system.
    environment = {**os.environ, **ONE_THREAD, "MPLBACKEND": "Agg", "QT_QPA_PLATFORM": "offscreen"}
    if str(FOLDER) in " ".join(command):
        environment.pop("PYTHONPATH", None)
    done = subprocess.run(command, cwd=ROOT, env=environment, text=True, capture_output=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout[-2000:]}"
                           f"{done.stderr[-4000:]}")
    return done.stdout
