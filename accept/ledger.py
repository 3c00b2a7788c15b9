"""The ledger of what was measured: ``accept/ledger.json``, part of the repository, one row a line.

A row stands there with the commit whose code measured it. Nothing enters it that was measured with code that no commit
holds, on a tiny case, or where something was missing that a measurement needs.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from bench.support.rows import RESULTS, Row
from bench.support.runs import ROOT

LEDGER = ROOT / "accept" / "ledger.json"


@dataclass(frozen=True)
class Entry:
    """A row that was measured.

    Attributes
    ----------
    table, check : str
        Where it belongs.
    row, bound, value : str
        What is measured, against what, and what was found.
    holds : bool
        Whether it is within the bound.
    commit : str
        Whose code measured it.
    date : str
        When, UTC.
    seconds : float
        That the check took, with all of its rows.
    """

    table: str
    check: str
    row: str
    bound: str
    value: str
    holds: bool
    commit: str
    date: str
    seconds: float


def read_ledger(path: Path = LEDGER) -> list[Entry]:
    """Read the ledger."""
    if not path.is_file():
        return []
    return [Entry(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))]


def keep_rows(check: tuple[str, str], rows: Sequence[Row], commit: str, seconds: float, path: Path = LEDGER) -> None:
    """Put the rows of a check into the ledger, in place of its earlier ones.

    Parameters
    ----------
    check : tuple of str
        Its table, and its name there.
    rows : sequence of Row
        What it found.
    commit : str
        Whose code measured them.
    seconds : float
        That it took.
    path : Path
        The ledger.
    """
    date = datetime.now(UTC).isoformat(timespec="seconds")
    found = [Entry(*check, row.check, row.bound, row.measured, row.holds, commit, date, round(seconds, 1))
             for row in rows]
    with _locked():
        others = [entry for entry in read_ledger(path) if (entry.table, entry.check) != check]
        _write(others + found, path)


def forget_all_but(checks: Sequence[tuple[str, str]], path: Path = LEDGER) -> None:
    """Remove the rows of checks that are no longer part of any table."""
    with _locked():
        entries = read_ledger(path)
        known = [entry for entry in entries if (entry.table, entry.check) in checks]
        if len(known) < len(entries):
            _write(known, path)


def _write(entries: list[Entry], path: Path) -> None:
    """Write all at once: who reads meanwhile sees the old file or the new one."""
    ordered = sorted(entries, key=lambda entry: (entry.table, entry.check))
    lines = ",\n".join(json.dumps(asdict(entry), ensure_ascii=False) for entry in ordered)
    beside = path.with_suffix(".json.new")
    beside.write_text(f"[\n{lines}\n]\n" if lines else "[]\n", encoding="utf-8")
    os.replace(beside, path)


@contextmanager
def _locked() -> Iterator[None]:
    """Keep other tables that are measured at the same time from writing."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    with (RESULTS / "ledger.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
