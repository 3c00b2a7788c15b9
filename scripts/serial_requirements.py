"""Prints ddic's runtime requirements without MPI and PETSc, one a line, from pyproject.toml."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PARALLEL_ONLY = {"mpi4py", "petsc4py"}


def main() -> None:
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    for requirement in tomllib.loads(text)["project"]["dependencies"]:
        if re.split(r"[^A-Za-z0-9_.-]", requirement)[0] not in PARALLEL_ONLY:
            print(requirement)


if __name__ == "__main__":
    main()
