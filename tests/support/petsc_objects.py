"""PETSc objects that have been made and not yet destroyed, as PETSc's own log counts them."""

from __future__ import annotations

import re
from pathlib import Path

from petsc4py import PETSc

from ddic.parallel.team import Team

_LINE = re.compile(r"^ *(\S.*?) +(\d+) +(\d+)(?: .*)?$", re.MULTILINE)


def count_live_objects(team: Team, folder: Path) -> dict[str, int]:
    """Live objects by class on rank 0, given to all; collective. folder: one that all ranks see.

    What was made before the first call does not count when it lives, and counts as less than none when it goes.
    """
    if not PETSc.Log.isActive():
        PETSc.Log.begin()
    path = folder / "log.txt"
    viewer = PETSc.Viewer().createASCII(str(path), comm=team.comm)
    PETSc.Log.view(viewer)
    viewer.destroy()

    def read() -> dict[str, int]:
        table = path.read_text().split("Object Type")[1].split("=====")[0]
        live: dict[str, int] = {}
        for name, made, destroyed in _LINE.findall(table):
            live[name] = live.get(name, 0) + int(made) - int(destroyed)
        return {name: n for name, n in live.items() if n}

    return team.on_root(read)
