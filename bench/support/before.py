"""The code before a restructuring, checked out beside the repository's own."""

from __future__ import annotations

import subprocess
from pathlib import Path

from bench.support.runs import DATA, ROOT, NotHereError

COMMIT = "a354d27"
"""Commit whose fields and rates the present ones are compared with."""


def checkout_before() -> Path:
    """Check out the code before, once, as a git worktree in ``bench/data/before``.

    Returns
    -------
    Path
        The checkout; its package is in ``src``.

    Raises
    ------
    NotHereError
        Where the repository's history does not reach back so far.
    """
    folder = DATA / f"before_{COMMIT}"
    if not (folder / "src").is_dir():
        command = ["git", "worktree", "add", "--force", "--detach", str(folder), COMMIT]
        done = subprocess.run(command, cwd=ROOT, text=True, capture_output=True, check=False)
        if done.returncode != 0:
            raise NotHereError(f"commit {COMMIT} cannot be checked out: {done.stderr.strip()}")
    return folder
