"""Other acceptance tables as checks of one: each is started as a command of its own."""

from __future__ import annotations

import re
import subprocess
import sys
import time

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, environment

LONGEST_SMOKE = 10
"""Minutes that all tables may take on tiny cases."""


def measure_table(table: str, scale: Scale) -> list[Row]:
    """Measure another table.

    Parameters
    ----------
    table : str
        Its name: ``make accept-TABLE`` shows it.
    scale : Scale
        A smoke run leaves it to ``accept.smoke``, which runs them all.

    Returns
    -------
    list of Row
        Whether every row holds.
    """
    what, bound = f"make accept-{table}", "every row holds"
    if scale.smoke:
        return [Row(what, bound, "run by make smoke itself", True)]
    module = f"accept.{table.replace('-', '_')}"
    command = [sys.executable, "-m", module, "--jobs", str(scale.jobs)]
    done = subprocess.run(command, cwd=ROOT, text=True, env=environment(), stdout=subprocess.PIPE, check=False)
    print(done.stdout, flush=True)
    failed = re.findall(r"^FAILS  (.*)$", done.stdout, re.MULTILINE)
    n_held = len(re.findall(r"^holds  ", done.stdout, re.MULTILINE))
    measured = f"{n_held} of {n_held + len(failed)} rows hold" + "".join(f"; not: {row}" for row in failed)
    return [Row(what, bound, measured, done.returncode == 0 and not failed)]


def measure_smoke(scale: Scale) -> list[Row]:
    """Measure how long all tables take on tiny cases, as CI runs them.

    Parameters
    ----------
    scale : Scale
        A smoke run is measured by its caller.

    Returns
    -------
    list of Row
        One row.
    """
    what, bound = "every check of every table on a tiny case (make smoke)", f"runs, in at most {LONGEST_SMOKE} minutes"
    if scale.smoke:
        return [Row(what, bound, "this run", True)]
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "accept.smoke"], cwd=ROOT, text=True, env=environment(),
                          stdout=subprocess.PIPE, check=False)
    minutes = (time.perf_counter() - begin) / 60
    failed = re.findall(r"^FAILED (.*)$", done.stdout, re.MULTILINE)
    measured = f"{minutes:.1f} minutes" + "".join(f"; did not run: {line}" for line in failed)
    return [Row(what, bound, measured, done.returncode == 0 and minutes <= LONGEST_SMOKE)]
