"""An acceptance table: every check measured here and now, in full or, as far as bounds hold there, on tiny cases.

What is measured in full goes to the ledger with the commit whose code measured it.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from accept.ledger import keep_rows
from accept.support.code_of_check import choose, find_code, find_uncommitted
from bench.support.rows import RESULTS, Row, append_result, show
from bench.support.runs import DATA, NotHereError
from ddic.io.input_file import find_source_commit

FEWEST_LINES = 12
"""Last lines of an error's traceback that are printed for a check that could not be measured."""

MOST_NAMED = 3
"""Files that are named where a check is not kept."""


@dataclass(frozen=True)
class Scale:
    """How large the cases of a table are.

    Attributes
    ----------
    smoke : bool
        Tiny cases, on which only those bounds are judged that are bounds there too.
    jobs : int
        Processes at a time, of checks that count and do not time.
    """

    smoke: bool = False
    jobs: int = 1

    def folder(self, name: str) -> Path:
        """Give the folder of a check's files, another one for tiny cases."""
        return DATA / "smoke" / name if self.smoke else DATA / name


Check = Callable[[Scale], Sequence[Row]]
"""Measures one or several rows of a table."""


def run_table(table: str, checks: Mapping[str, Check], arguments: Sequence[str] | None = None) -> int:
    """Measure the checks that the command line names, all where it names none; print and keep their rows.

    A check that cannot be measured, for whatever reason, is a row that does not hold and stops no other.
    """
    parser = argparse.ArgumentParser(prog=f"python -m accept.tables {table}")
    parser.add_argument("names", nargs="*", metavar="CHECK", help=", ".join(checks))
    parser.add_argument("--smoke", action="store_true", help="tiny cases: only bounds that hold there too are judged")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time of checks that count and do not time")
    chosen = parser.parse_args(arguments)
    unknown = sorted(set(chosen.names) - set(checks))
    if unknown:
        parser.error(f"no such check: {', '.join(unknown)}; there are: {', '.join(checks)}")
    scale = Scale(chosen.smoke, chosen.jobs)
    # What checks of this table ran is kept beside their rows, begun afresh.
    (RESULTS / f"{runs_name(table)}.jsonl").unlink(missing_ok=True)
    # Whatever is committed while checks run, this process runs what it has imported.
    commit = find_source_commit()
    held = [_run_check((table, name), checks[name], scale, commit) for name in chosen.names or checks]
    which = "every bound that is judged on tiny cases holds" if scale.smoke else "every bound holds"
    print(which if all(held) else "some bounds do not hold")
    return 0 if all(held) else 1


def runs_name(table: str) -> str:
    """Give the result file of what a table's checks ran."""
    return f"accept_{table.replace('-', '_')}_runs"


@dataclass(frozen=True)
class _Measured:
    """What became of a check: its rows, whether it ran to its end, and whether all was there that it needs."""

    rows: Sequence[Row]
    ran: bool = True
    was_here: bool = True


def _run_check(which: tuple[str, str], check: Check, scale: Scale, commit: str) -> bool:
    """Measure a check, show its rows and keep them; whether all hold or, on tiny cases, all that are judged there."""
    (table, name), begin = which, time.perf_counter()
    found = _measure(name, check, scale)
    if scale.smoke:
        return _show_small(name, found)
    for row in found.rows:
        append_result(f"accept_{table}", {"name": name, **asdict(row)})
        show(row)
        print(f"       command   make accept-{table} CHECK={name}", flush=True)
    if found.was_here:
        _keep(which, check, found.rows, commit, time.perf_counter() - begin)
    return all(row.holds for row in found.rows)


def _measure(name: str, check: Check, scale: Scale) -> _Measured:
    """Rows of a check, one that does not hold where it cannot be measured."""
    try:
        return _Measured(check(scale))
    except NotHereError as error:
        row = Row(name, "measured", f"not measured: {error}", False, judged_small=False)
        return _Measured([row], was_here=False)
    except Exception as error:
        row = Row(name, "measured", f"could not be measured: {type(error).__name__}: {error}", False)
        print("\n".join(traceback.format_exc().splitlines()[-FEWEST_LINES:]), file=sys.stderr, flush=True)
        return _Measured([row], ran=False)


def _show_small(name: str, found: _Measured) -> bool:
    """Print what tiny cases gave; whether the check ran and all rows hold that are judged there."""
    for row in found.rows:
        judged = "holds" if row.holds else "FAILS" if found.ran else "FAILED"
        verdict = "told" if row.is_reported else judged if row.judged_small else "ran"
        bound = f" (bound: {row.bound})" if verdict == "FAILS" else ""
        print(f"{verdict:6s} {name}: {row.check}: {row.measured}{bound}", flush=True)
    return all(row.holds for row in found.rows if row.judged_small)


def _keep(which: tuple[str, str], check: Check, rows: Sequence[Row], commit: str, seconds: float) -> None:
    """Put rows into the ledger, unless no commit holds the code that measured them."""
    if commit == "unknown":
        print("       not in accept/ledger.json: this is no git repository", flush=True)
        return
    changed = choose(find_uncommitted(commit), find_code(check))
    if changed:
        print(f"       not in accept/ledger.json: {len(changed)} files that it runs differ from the last commit "
              f"({', '.join(changed[:MOST_NAMED])})", flush=True)
        return
    keep_rows(which, rows, commit, seconds)
