"""The source tree that ddic runs from."""

from __future__ import annotations

import subprocess
from pathlib import Path


def find_source_commit() -> str:
    """Find the commit of the source tree that ddic runs from.

    Returns
    -------
    str
        Hexadecimal digits; "unknown" for an installed package.
    """
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        return "unknown"
    try:
        done = subprocess.run(["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True,
                              timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()
