"""All acceptance tables beside their ledger: ``make accept`` and ``make accept-stale``.

Usage: python -m accept.all_tables run|stale|judge [--run] [--jobs N].

run: measure every check that is not in the ledger, or stands there with code that has changed since; then judge. What
is interrupted goes on where it was. stale: list the checks of which the code has changed; with --run, measure them.
judge: count the checks that stand there with code that has changed since; exit code 1 where a check is missing in the
ledger, or a row misses its bound without a reason in open_rows.py.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from accept.ledger import Entry, forget_all_but, read_ledger
from accept.open_rows import OPEN
from accept.support.code_of_check import choose, find_changed, find_code, find_uncommitted
from accept.tables import TABLES, find_checks
from bench.support.runs import ROOT, environment

CheckName = tuple[str, str]
"""A table, and the name of a check there."""

MOST_NAMED = 4
"""Changed files that are named."""


@dataclass(frozen=True)
class Stale:
    """A check of which the code has changed since it was measured.

    Attributes
    ----------
    check : tuple of str
        Its table, and its name there.
    entry : Entry
        A row of it.
    changed : list of str
        Files that differ; empty where the commit that measured it is not part of the repository.
    """

    check: CheckName
    entry: Entry
    changed: list[str]

    def describe(self) -> str:
        """Say what changed since when, in a line."""
        more = f" and {len(self.changed) - MOST_NAMED} more" if len(self.changed) > MOST_NAMED else ""
        named = ", ".join(self.changed[:MOST_NAMED])
        why = f"changed since: {named}{more}" if self.changed else "a commit that is not here"
        return f"{' '.join(self.check)}: measured {self.entry.date[:10]} at {self.entry.commit[:8]}, {why}"


def list_checks() -> list[CheckName]:
    """List the checks of all tables."""
    return [(table, name) for table in TABLES for name in find_checks(table)]


def list_missing(entries: Sequence[Entry]) -> list[CheckName]:
    """List the checks that are not in the ledger."""
    kept = {(entry.table, entry.check) for entry in entries}
    return [check for check in list_checks() if check not in kept]


def list_stale(entries: Sequence[Entry]) -> list[Stale]:
    """List the checks that were measured before the code that they run was last changed."""
    kept = {(entry.table, entry.check): entry for entry in entries}
    stale = []
    for table in TABLES:
        for name, check in find_checks(table).items():
            entry = kept.get((table, name))
            if entry is None:
                continue
            changed = find_changed(entry.commit)
            of_check = [] if changed is None else choose(changed, find_code(check))
            if changed is None or of_check:
                stale.append(Stale((table, name), entry, of_check))
    return stale


def judge(entries: Sequence[Entry]) -> int:
    """Print what is missing in the ledger, what is older than its code, and what does not hold unless it is known."""
    missing, stale = list_missing(entries), list_stale(entries)
    missed = [entry for entry in entries if not entry.holds]
    are_missed = {(entry.table, entry.check) for entry in missed}
    closed = [check for check in OPEN if check not in are_missed and check not in missing]
    for table, name in missing:
        print(f"missing: make accept-{table} CHECK={name}")
    for entry in missed:
        why = OPEN.get((entry.table, entry.check))
        print(f"{'FAILS' if why is None else 'open '}  {entry.row}\n       bound     {entry.bound}\n"
              f"       measured  {entry.value}\n"
              f"       command   make accept-{entry.table} CHECK={entry.check}, at {entry.commit[:8]}"
              + ("" if why is None else f"\n       why       {why}"))
    for table, name in closed:
        print(f"holds: {table} {name}; remove it from accept/open_rows.py")
    n_held = len(entries) - len(missed)
    print(f"accept/ledger.json: {n_held} of {len(entries)} rows hold, {len(missing)} checks are missing, "
          f"{len(stale)} are older than their code, {len(are_missed & set(OPEN))} are known to miss a bound")
    return 1 if missing or closed or are_missed - set(OPEN) else 0


def measure(checks: Sequence[CheckName], n_jobs: int) -> None:
    """Measure checks, those of a table in one process; each enters the ledger as soon as it is measured."""
    for table in TABLES:
        names = [name for of_table, name in checks if of_table == table]
        if names:
            print(f"== {table}: {', '.join(names)}", flush=True)
            subprocess.run([sys.executable, "-m", "accept.tables", table, "--jobs", str(n_jobs), *names], cwd=ROOT,
                           env=environment(), check=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, list or judge; 1 where a row is missing or does not hold, 2 where nothing measured could be kept."""
    parser = argparse.ArgumentParser(prog="python -m accept.all_tables")
    parser.add_argument("what", choices=("run", "stale", "judge"))
    parser.add_argument("--run", action="store_true", help="measure what is stale")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time of checks that count and do not time")
    chosen = parser.parse_args(arguments)
    entries = read_ledger()
    if chosen.what == "judge":
        return judge(entries)
    stale = list_stale(entries)
    for one in stale:
        print(one.describe(), flush=True)
    if chosen.what == "stale":
        print(f"{len(stale)} of {len({(e.table, e.check) for e in entries})} checks in accept/ledger.json are stale")
    if chosen.what == "stale" and not chosen.run:
        return 0
    uncommitted = choose(find_uncommitted(), frozenset({"src", "accept", "bench"}))
    if uncommitted:
        print(f"commit first, or nothing can be kept: {', '.join(uncommitted)}", file=sys.stderr)
        return 2
    forget_all_but(list_checks())
    wanted = [one.check for one in stale] + (list_missing(entries) if chosen.what == "run" else [])
    measure(wanted, chosen.jobs)
    return judge(read_ledger())


if __name__ == "__main__":
    sys.exit(main())
