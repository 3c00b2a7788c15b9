"""Ranks that cannot start: a library that one of them lacks, no memory, a limit on the address space."""

from __future__ import annotations

import os
from itertools import product
from pathlib import Path

from accept.support.ended_job import DDIC, LONGEST, Ended, Job, prepare_case
from accept.table import Scale
from bench.support.rows import Row, append_result

MODULES = ("click", "numpy", "petsc4py", "mpi4py", "cv2", "numba", "ddic.methods.run", "ddic.solvers.gauss_newton")
"""Before MPI begins, with it, and after it."""

SIZES_MIB = (100, 200, 300, 450, 600, 800, 1000, 1020, 1040, 1060, 1300, 2000)
"""Libraries need 1050 MiB: below, each fails in a way of its own; the last is enough."""

_BREAKING = """
import os, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["BROKEN_MODULE"]:
            raise {"ImportError": ImportError("no such library"), "MemoryError": MemoryError()}[os.environ["BROKEN_BY"]]
if os.environ.get("OMPI_COMM_WORLD_RANK") == os.environ.get("BROKEN_RANK"):
    sys.meta_path.insert(0, Finder())
"""
"""What Python runs first, as ``sitecustomize``."""


def measure_failing_starts(scale: Scale) -> list[Row]:
    """Start ddic on ranks of which one fails to import something, and within limits on the address space.

    Parameters
    ----------
    scale : Scale
        A smoke run does one of each kind.

    Returns
    -------
    list of Row
        How they end and how soon, for each of both.
    """
    folder = scale.folder("failing_starts")
    prepare_case(folder)
    return [*_break_one_rank(scale, folder), *_limit_address_space(scale, folder)]


def _break_one_rank(scale: Scale, folder: Path) -> list[Row]:
    modules, ranks = (MODULES[-2:-1], (2,)) if scale.smoke else (MODULES, (2, 4))
    (folder / "first").mkdir(exist_ok=True)
    (folder / "first" / "sitecustomize.py").write_text(_BREAKING, encoding="utf-8")
    ended = {}
    for n_ranks, module, kind in product(ranks, modules, ("ImportError", "MemoryError")):
        changes = {"PYTHONPATH": _prepend(folder / "first"), "BROKEN_MODULE": module, "BROKEN_BY": kind,
                   "BROKEN_RANK": str(n_ranks - 1)}
        with Job(n_ranks, [*DDIC, "run", "case.toml"], folder, changes) as job:
            ended[f"{kind} of {module} on {n_ranks} ranks"] = job.wait()
    return _judge("one rank has an ImportError or no memory while it starts", ended)


def _prepend(folder: Path) -> str:
    return os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH", "")])])


def _limit_address_space(scale: Scale, folder: Path) -> list[Row]:
    ended, n_measured = {}, 0
    for n_ranks, size in product((2,) if scale.smoke else (0, 2), SIZES_MIB[7:8] if scale.smoke else SIZES_MIB):
        limited = ["sh", "-c", f'ulimit -v {1024 * size}; exec "$@"', "sh", *DDIC, "run", "case.toml"]
        with Job(n_ranks, limited, folder) as job:
            done = job.wait()
        if done.code == 0:
            n_measured += 1
        else:
            ended[f"{size} MiB on {n_ranks} ranks"] = done
    return _judge(f"ulimit -v at 12 sizes, alone and on 2 ranks ({n_measured} measured)", ended)


def _judge(what: str, ended: dict[str, Ended]) -> list[Row]:
    """Whether all jobs ended with one line and exit code 1, and in time."""
    what = f"{what}: {len(ended)} that cannot start"
    wrong = [f"{name}: code {done.code}, {len(done.lines)} lines" for name, done in ended.items()
             if done.code != 1 or len(done.lines) != 1]
    slowest = max((done.seconds for done in ended.values()), default=0.0)
    append_result("failing_starts", {"what": what, "slowest_s": slowest, "wrong": wrong})
    return [Row(what, "each ends with one line and exit code 1",
                f"{len(ended) - len(wrong)} so{'; '.join(['', *wrong[:3]])}", not wrong),
            Row(f"{what}: the slowest", f"<= {LONGEST:g} s", f"{slowest:.1f} s", slowest <= LONGEST,
                judged_small=False)]
