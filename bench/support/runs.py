"""Runs of the command line and of jobs under MPI, image pairs, and where all of that is kept."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
"""The repository: every command is started here, so that ``bench`` and ``accept`` can be imported."""

DATA = Path(os.environ.get("DDIC_BENCH_DATA") or ROOT / "bench" / "data")
"""Images, cases and results of runs; not part of the repository. Measurements at the same time need one each."""

TIMEOUT_S = 900
"""Seconds after which a run counts as hanging."""

MOST_LINES = 12
"""Last lines of a failed run's output that an error shows."""


class NotHereError(RuntimeError):
    """What a measurement needs is not on this machine: real images, other programs, the history of the repository."""


def ddic_command() -> str:
    """Give the path of the command line.

    Returns
    -------
    str
        The ``ddic`` beside the interpreter that runs this.
    """
    return str(Path(sys.executable).with_name("ddic"))


def environment(changes: Mapping[str, str] | None = None) -> dict[str, str]:
    """Give the environment of a new process: that with which this one began.

    MPI, once begun in a process, adds variables with which an ``mpiexec`` started from there fails. Python's
    ``os.environ`` does not see them; a process that is given no environment inherits them.

    Parameters
    ----------
    changes : mapping, optional
        Variables that differ from this process's.

    Returns
    -------
    dict
        Values by name.
    """
    return {**os.environ, **(changes or {})}


def mpirun(n_ranks: int, *command: str, changes: Mapping[str, str] | None = None) -> str:
    """Run a command on some ranks with an outer time limit.

    Parameters
    ----------
    n_ranks : int
        Number of MPI ranks.
    *command : str
        The command and its arguments.
    changes : mapping, optional
        Variables that differ from this process's.

    Returns
    -------
    str
        Its standard output.

    Raises
    ------
    RuntimeError
        Where it fails or takes longer than ``TIMEOUT_S``.
    """
    launcher = os.environ.get("MPIEXEC", "mpiexec")
    done = subprocess.run(["timeout", str(TIMEOUT_S), launcher, "-n", str(n_ranks), *command], cwd=ROOT, text=True,
                          env=environment(changes), capture_output=True, check=False)
    if done.returncode != 0:
        # What mpiexec says of it after a line of dashes is no reason.
        reason = "\n".join([*done.stdout.splitlines(), *done.stderr.partition("\n-----")[0].splitlines()][-MOST_LINES:])
        raise RuntimeError(f"{' '.join(command)} on {n_ranks} ranks ended with {done.returncode}:\n{reason}")
    return done.stdout


def run_job(n_ranks: int, module: str, *arguments: str) -> list[dict[str, Any]]:
    """Run a module of this repository on some ranks.

    Parameters
    ----------
    n_ranks : int
        Number of MPI ranks.
    module : str
        Its dotted name, ``bench.support.local_inverse_job`` for instance.
    *arguments : str
        Its arguments.

    Returns
    -------
    list of dict
        The JSON object of every line that it prints.

    Raises
    ------
    RuntimeError
        Where it fails.
    """
    printed = mpirun(n_ranks, sys.executable, "-m", "mpi4py", "-m", module, *arguments)
    return [json.loads(line) for line in printed.splitlines()]


def ddic_run(case: str, folder: Path, n_ranks: int, name: str = "result", output: str = "") -> dict[str, Any]:
    """Run a case text through the command line; the result is ``folder/NAME.vtkhdf``.

    Parameters
    ----------
    case : str
        Case file without ``[output]``.
    folder : Path
        Folder of the case file, which its relative paths start from.
    n_ranks : int
        Number of MPI ranks.
    name : str
        Name of the case file and of the result.
    output : str
        Other keys of ``[output]``.

    Returns
    -------
    dict
        The summary.
    """
    folder.mkdir(parents=True, exist_ok=True)
    case_file = folder / f"{name}.toml"
    case_file.write_text(f'{case}\n[output]\nfile = "{name}.vtkhdf"\n{output}\n', encoding="utf-8")
    mpirun(n_ranks, ddic_command(), "run", str(case_file))
    summary: dict[str, Any] = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    return summary


def ddic(*arguments: str, changes: Mapping[str, str] | None = None) -> None:
    """Run the command line on one rank.

    Parameters
    ----------
    *arguments : str
        Of ``ddic``.
    changes : mapping, optional
        Variables that differ from this process's.
    """
    subprocess.run([ddic_command(), *arguments], check=True, stdout=subprocess.DEVNULL,
                   env=environment(changes))


def images(*arguments: str, folder: Path) -> Path:
    """Make an image pair with ``ddic synth`` unless the same one is there already.

    Parameters
    ----------
    *arguments : str
        Of ``ddic synth``, without ``--output``.
    folder : Path
        Where the pair goes.

    Returns
    -------
    Path
        The folder.
    """
    stamp = folder / "arguments.json"
    wanted = json.dumps([*arguments, source_version()])
    if not stamp.is_file() or stamp.read_text(encoding="utf-8") != wanted:
        folder.mkdir(parents=True, exist_ok=True)
        for earlier in (*folder.glob("*reference.tif"), *folder.glob("*deformed.tif"), folder / "truth.json"):
            # Case files of an earlier run may name them, and ddic replaces no input.
            earlier.unlink(missing_ok=True)
        ddic("synth", *arguments, "--output", str(folder))
        stamp.write_text(wanted, encoding="utf-8")
    return folder


def source_version() -> str:
    """Digest the generator's source, so that images are never those of an older one.

    Returns
    -------
    str
        Hexadecimal digest.
    """
    digest = hashlib.sha256()
    for path in sorted((ROOT / "src" / "ddic" / "synth").glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def real_data() -> Path:
    """Find the folder of real images.

    Returns
    -------
    Path
        What DDIC_REAL_DATA names.

    Raises
    ------
    NotHereError
        Where it names no folder.
    """
    folder = os.environ.get("DDIC_REAL_DATA")
    if not folder or not Path(folder).is_dir():
        raise NotHereError("set DDIC_REAL_DATA to the folder of real images")
    return Path(folder).resolve()
