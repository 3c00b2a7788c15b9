"""An acceptance table: every check measured here and now, in full or, to see that it runs, on tiny cases."""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.support.rows import RESULTS, Row, append_result, show
from bench.support.runs import DATA, NotHereError

FEWEST_LINES = 12
"""Last lines of an error's traceback that are printed for a check that could not be measured."""


@dataclass(frozen=True)
class Scale:
    """How large the cases of a table are.

    Attributes
    ----------
    smoke : bool
        Tiny cases, on which no bound is judged: the checks must only run.
    jobs : int
        Processes at a time, of checks that count and do not time.
    """

    smoke: bool = False
    jobs: int = 1

    def folder(self, name: str) -> Path:
        """Give the folder of a check's files, another one for tiny cases.

        Parameters
        ----------
        name : str
            Of the check.

        Returns
        -------
        Path
            A folder below ``bench/data``, which need not exist.
        """
        return DATA / "smoke" / name if self.smoke else DATA / name


Check = Callable[[Scale], Sequence[Row]]
"""Measures one or several rows of a table."""


def run_table(table: str, checks: Mapping[str, Check], arguments: Sequence[str] | None = None) -> int:
    """Measure the checks that the command line names, all where it names none; print and keep their rows.

    A check that cannot be measured, for whatever reason, is a row that does not hold and stops no other.

    Parameters
    ----------
    table : str
        Name of the table: ``make accept-TABLE`` shows it.
    checks : mapping
        Checks by name, in the order in which they are measured.
    arguments : sequence of str, optional
        Of the command line; those of this process by default.

    Returns
    -------
    int
        Exit code: 1 where a bound is missed or, with ``--smoke``, where a check could not be measured.
    """
    parser = argparse.ArgumentParser(prog=f"python -m accept.{table.replace('-', '_')}")
    parser.add_argument("names", nargs="*", metavar="CHECK", help=", ".join(checks))
    parser.add_argument("--smoke", action="store_true", help="tiny cases: see that every check runs, judge no bound")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time of checks that count and do not time")
    chosen = parser.parse_args(arguments)
    unknown = sorted(set(chosen.names) - set(checks))
    if unknown:
        parser.error(f"no such check: {', '.join(unknown)}; there are: {', '.join(checks)}")
    scale = Scale(chosen.smoke, chosen.jobs)
    # What checks of this table ran is kept beside their rows, begun afresh.
    (RESULTS / f"{runs_name(table)}.jsonl").unlink(missing_ok=True)
    held = [_run_check(table, name, checks[name], scale) for name in chosen.names or checks]
    done = "every check ran" if scale.smoke else "every bound holds"
    print(done if all(held) else "some checks did not run" if scale.smoke else "some bounds do not hold")
    return 0 if all(held) else 1


def runs_name(table: str) -> str:
    """Give the result file of what a table's checks ran.

    Parameters
    ----------
    table : str
        Name of the table.

    Returns
    -------
    str
        For ``append_result``.
    """
    return f"accept_{table.replace('-', '_')}_runs"


def _run_check(table: str, name: str, check: Check, scale: Scale) -> bool:
    """Measure a check and show its rows; whether all hold or, with tiny cases, whether it ran."""
    command = f"make accept-{table} CHECK={name}"
    ran = True
    try:
        rows = check(scale)
    except NotHereError as error:
        rows = [Row(name, "measured", f"not measured: {error}", False)]
        ran = scale.smoke
    except Exception as error:
        ran = False
        rows = [Row(name, "measured", f"could not be measured: {type(error).__name__}: {error}", False)]
        print("\n".join(traceback.format_exc().splitlines()[-FEWEST_LINES:]), file=sys.stderr, flush=True)
    for row in rows:
        if scale.smoke:
            print(f"{'ran' if ran else 'FAILED':6s} {name}: {row.check}: {row.measured}", flush=True)
            continue
        append_result(f"accept_{table}", {"name": name, **asdict(row)})
        show(row)
        print(f"       command   {command}", flush=True)
    return ran if scale.smoke else ran and all(row.holds for row in rows)
