"""All acceptance tables on tiny cases, so that no check can rot: ``make smoke``. No bound is judged.

Usage: python -m accept.smoke [TABLE ...], all by default; exit code 1 where a check does not run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence

from accept import core, faults, house, impressions, near_far, performance, pgd, practice, right, solver, start, xdic
from accept.table import Check, run_table

TABLES: dict[str, Mapping[str, Check]] = {
    "core": core.CHECKS,
    "solver": solver.CHECKS,
    "performance": performance.CHECKS,
    "near-far": near_far.CHECKS,
    "house": house.CHECKS,
    "right": right.CHECKS,
    "xdic": xdic.CHECKS,
    "start": start.CHECKS,
    "pgd": pgd.CHECKS,
    "impressions": impressions.CHECKS,
    "practice": practice.CHECKS,
    "faults": faults.CHECKS,
}
N_JOBS = "2"
"""Processes at a time of checks that count and do not time."""


def run_smoke(tables: Sequence[str]) -> int:
    """Run every check of some tables on tiny cases.

    Parameters
    ----------
    tables : sequence of str
        Names of TABLES.

    Returns
    -------
    int
        Exit code: 1 where a check does not run.
    """
    failed = []
    for table in tables:
        begin = time.perf_counter()
        print(f"== {table}", flush=True)
        if run_table(table, TABLES[table], ["--smoke", "--jobs", N_JOBS]) != 0:
            failed.append(table)
        print(f"{time.perf_counter() - begin:.0f} s", flush=True)
    print(f"did not run: {', '.join(failed)}" if failed else "all tables run")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(run_smoke(sys.argv[1:] or list(TABLES)))
