"""Figures beside their bounds, kept as JSON lines and printed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from bench.support.runs import ROOT
from ddic.io.input_file import find_source_commit

RESULTS = ROOT / "bench" / "results"
"""JSON lines of all that was measured; not part of the repository."""


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes
    ----------
    check : str
        What is measured.
    bound : str
        What it is measured against.
    measured : str
        What was found.
    holds : bool
        Whether it is within the bound.
    judged_small : bool
        Whether the bound is one for the tiny cases of a smoke run too: not one of times, of memory, or of large cases.
    """

    check: str
    bound: str
    measured: str
    holds: bool
    judged_small: bool = True

    @property
    def is_reported(self) -> bool:
        """Whether it stands beside another number without being judged against it."""
        return self.bound.startswith("reported")


def append_result(name: str, record: dict[str, Any]) -> None:
    """Append a JSON line to ``bench/results/NAME.jsonl``.

    Parameters
    ----------
    name : str
        Name of the file.
    record : dict
        What was found; commit and date are added.
    """
    RESULTS.mkdir(parents=True, exist_ok=True)
    stamped = {"commit": find_source_commit(), "date": datetime.now(UTC).isoformat(timespec="seconds"), **record}
    with (RESULTS / f"{name}.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(stamped) + "\n")


def show(row: Row) -> None:
    """Print a row.

    Parameters
    ----------
    row : Row
        What to print.
    """
    verdict = "holds" if row.holds else "FAILS"
    print(f"{verdict}  {row.check}\n       bound     {row.bound}\n       measured  {row.measured}", flush=True)


def show_all(rows: Sequence[Row]) -> int:
    """Print rows.

    Parameters
    ----------
    rows : sequence of Row
        What to print.

    Returns
    -------
    int
        Exit code: 1 where a bound is missed.
    """
    for row in rows:
        show(row)
    return 0 if all(row.holds for row in rows) else 1


def main(name: str, measure: Callable[[], Sequence[Row]]) -> None:
    """Measure, keep the rows in ``bench/results/NAME.jsonl``, print them, and exit with 1 where a bound is missed.

    Parameters
    ----------
    name : str
        Name of the result file.
    measure : callable
        Gives the rows.
    """
    rows = measure()
    for row in rows:
        append_result(name, asdict(row))
    sys.exit(show_all(rows))
