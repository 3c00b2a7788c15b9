"""All acceptance tables on tiny cases, so that no check can rot: ``make smoke``.

Every check must run, and every row must hold whose bound is one for tiny cases too: those of times, memory and large
cases are not judged.

Usage: python -m accept.smoke [TABLE ...], all by default; exit code 1 where a check does not run, a row that is judged
does not hold, or too few rows are judged.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from accept.table import Scale
from accept.tables import TABLES
from bench.support.rows import Row
from bench.support.runs import DATA, ROOT, environment

N_LANES = 2
"""Tables at a time: most of what a check does is to start programs of one process, one after the other."""

N_JOBS = "2"
"""Processes at a time of checks that count and do not time."""

LEAST_JUDGED = 0.6
"""Share of the rows with a bound that are judged by it; fewer would let the tables rot."""

LONGEST = 10
"""Minutes that all tables may take."""


def run_smoke(tables: Sequence[str]) -> int:
    """Run every check of some tables on tiny cases."""
    failed, verdicts = [], []
    with ThreadPoolExecutor(N_LANES) as lanes:
        # Of the last ones newcomer takes long: begun late, it would leave the other lane idle.
        running = {lanes.submit(_run_table, table): table for table in reversed(tables)}
        for done in as_completed(running):
            code, printed = done.result()
            print(f"== {running[done]}\n{printed}", flush=True)
            verdicts += re.findall(r"^(holds|FAILS|FAILED|ran) +\w+: ", printed, re.MULTILINE)
            if code:
                failed.append(running[done])
    n_judged = len(verdicts) - verdicts.count("ran")
    too_few = n_judged < LEAST_JUDGED * len(verdicts)
    print(f"{n_judged} of {len(verdicts)} rows judged ({n_judged / max(1, len(verdicts)):.0%}; at least "
          f"{LEAST_JUDGED:.0%}), {verdicts.count('holds')} hold")
    print(f"does not hold: {', '.join(failed)}" if failed else "all tables run, and hold where they are judged")
    return 1 if failed or too_few else 0


def _run_table(table: str) -> tuple[int, str]:
    """Run a table as a program, with data of its own: another table may write the same files; code, what it prints."""
    begin = time.perf_counter()
    command = [sys.executable, "-m", "accept.tables", table, "--smoke", "--jobs", N_JOBS]
    done = subprocess.run(command, cwd=ROOT, env=environment({"DDIC_BENCH_DATA": str(DATA / f"of_{table}")}), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    return done.returncode, f"{done.stdout}{time.perf_counter() - begin:.0f} s"


def measure_smoke(scale: Scale) -> list[Row]:
    """Measure how long all tables take on tiny cases, as CI runs them, and how many rows are judged there."""
    what = "every check of every table on a tiny case (make smoke)"
    bound = f"runs and holds, at least {LEAST_JUDGED:.0%} of the rows judged, in at most {LONGEST} minutes"
    if scale.smoke:
        return [Row(what, bound, "this run", True, judged_small=False)]
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "accept.smoke"], cwd=ROOT, text=True, env=environment(),
                          stdout=subprocess.PIPE, check=False)
    minutes = (time.perf_counter() - begin) / 60
    judged = re.findall(r"^\d+ of \d+ rows judged.*$", done.stdout, re.MULTILINE)
    failed = re.findall(r"^FAIL(?:S|ED) +(.*)$", done.stdout, re.MULTILINE)
    measured = f"{minutes:.1f} minutes; {', '.join(judged)}" + "".join(f"; not: {line}" for line in failed)
    return [Row(what, bound, measured, done.returncode == 0 and minutes <= LONGEST)]


if __name__ == "__main__":
    sys.exit(run_smoke(sys.argv[1:] or list(TABLES)))
