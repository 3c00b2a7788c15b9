"""The code before a restructuring, checked out beside the repository's own."""

from __future__ import annotations

import subprocess
from pathlib import Path

from bench.support.runs import DATA, ROOT, NotHereError

COMMIT = "a354d27"
"""Commit whose fields and rates the present ones are compared with."""


def checkout_before(commit: str = COMMIT) -> Path:
    """Check out the code before, once, into ``bench/data``.

    Parameters
    ----------
    commit : str
        Another one, where what is compared has been changed on purpose since.

    Returns
    -------
    Path
        The checkout; its package is in ``src``.

    Raises
    ------
    NotHereError
        Where the repository's history does not reach back so far.
    """
    folder = DATA / f"checkout_{commit}"
    if not folder.is_dir():
        done = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=False)
        if done.returncode != 0:
            raise NotHereError(f"commit {commit} is not in the repository's history: {done.stderr.decode().strip()}")
        folder.mkdir(parents=True)
        subprocess.run(["tar", "--extract", "--directory", str(folder)], input=done.stdout, check=True)
    return folder
