"""The code before a restructuring, checked out beside the repository's own."""

from __future__ import annotations

import subprocess
from pathlib import Path

from bench.support.runs import DATA, ROOT, NotHereError

COMMIT = "a354d27"
"""Commit whose fields and rates the present ones are compared with."""


def checkout_before() -> Path:
    """Check out the code before, once, into ``bench/data``.

    Returns
    -------
    Path
        The checkout; its package is in ``src``.

    Raises
    ------
    NotHereError
        Where the repository's history does not reach back so far.
    """
    folder = DATA / f"checkout_{COMMIT}"
    if not folder.is_dir():
        done = subprocess.run(["git", "archive", COMMIT], cwd=ROOT, capture_output=True, check=False)
        if done.returncode != 0:
            raise NotHereError(f"commit {COMMIT} is not in the repository's history: {done.stderr.decode().strip()}")
        folder.mkdir(parents=True)
        subprocess.run(["tar", "--extract", "--directory", str(folder)], input=done.stdout, check=True)
    return folder
