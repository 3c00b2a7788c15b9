"""All acceptance tables on tiny cases, so that no check can rot: ``make smoke``. No bound is judged.

Usage: python -m accept.smoke [TABLE ...], all by default; exit code 1 where a check does not run.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from bench.support.runs import DATA, ROOT, environment

TABLES = ("performance", "near-far", "house", "practice", "faults", "impressions", "core", "start", "right", "pgd",
          "xdic", "solver")
"""Names of all tables, those first that take longest."""

N_LANES = 2
"""Tables at a time: most of what a check does is to start programs of one process, one after the other."""

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
    with ThreadPoolExecutor(N_LANES) as lanes:
        running = {lanes.submit(_run_table, table): table for table in tables}
        for done in as_completed(running):
            code, printed = done.result()
            print(f"== {running[done]}\n{printed}", flush=True)
            if code:
                failed.append(running[done])
    print(f"did not run: {', '.join(failed)}" if failed else "all tables run")
    return 1 if failed else 0


def _run_table(table: str) -> tuple[int, str]:
    """Run a table as a program, with data of its own: another table may write the same files; code, what it prints."""
    begin = time.perf_counter()
    command = [sys.executable, "-m", f"accept.{table.replace('-', '_')}", "--smoke", "--jobs", N_JOBS]
    done = subprocess.run(command, cwd=ROOT, env=environment({"DDIC_BENCH_DATA": str(DATA / f"of_{table}")}), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    return done.returncode, f"{done.stdout}{time.perf_counter() - begin:.0f} s"


if __name__ == "__main__":
    sys.exit(run_smoke(sys.argv[1:] or TABLES))
