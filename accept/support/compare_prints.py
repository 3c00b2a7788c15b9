"""What a command printed beside what its page shows: every word and every number."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal
from itertools import zip_longest

NUMBER = re.compile(r"-?(?<![A-Za-z])\d+(?:\.\d+)?(?:e[-+]\d+)?")

_ROUNDING = 1e-9
"""Difference of two numbers of rounding errors, which have no digits to compare: that to which methods agree, px."""


def allow_difference(number: str) -> float:
    """Give the difference that a printed number may have from the one that a page shows.

    Three units of its last digit; none where it is whole, for it is counted or chosen. Images come from fixed seeds;
    libraries and partitions move a field by less than Gauss-Newton's tolerance, an RMS of 1e-4 px.

    Parameters
    ----------
    number : str
        As the page shows it.

    Returns
    -------
    float
        In its own unit.
    """
    if "." not in number:
        return _ROUNDING if "e" in number else 0.0
    exponent = Decimal(number).as_tuple().exponent
    if not isinstance(exponent, int):
        raise TypeError(f"{number} is no finite number")
    return 3.0 * 10.0**exponent


def find_differences(printed: str, shown: str, differs: Sequence[str] = ()) -> list[str]:
    """Compare what was printed with what a page shows, line by line; "..." stands for anything.

    Parameters
    ----------
    printed : str
        What was printed.
    shown : str
        What the page shows.
    differs : sequence of str
        Units: a number in front of one, numbers of a line whose label holds one, and those of a column that is headed
        by one may be others. A line of nothing but a label and such a number may be missing.

    Returns
    -------
    list of str
        A line for each that differs.
    """
    differences = []
    columns: list[int] = []
    for found, expected in zip_longest(_lines(printed, differs), _lines(shown, differs), fillvalue=""):
        headings = re.split(r"  +", expected.strip())
        if len(headings) > 2 and set(headings) & set(differs):
            columns = [place - len(headings) for place, heading in enumerate(headings) if heading in differs]
        if not _agree(_mask(found, differs, columns), _mask(expected, differs, columns)):
            differences.append(f"printed {found.strip()!r}, shown {expected.strip()!r}")
    return differences


def _lines(text: str, differs: Sequence[str]) -> list[str]:
    """Lines but those that say no more than that something took some seconds."""
    units = "|".join(re.escape(word) for word in differs)
    only = re.compile(rf"[^:]+: {NUMBER.pattern} (?:{units})" if units else r"(?!)")
    return [line for line in text.rstrip().splitlines() if not only.fullmatch(line)]


def _mask(line: str, differs: Sequence[str], columns: Sequence[int]) -> str:
    """A line without the numbers that may differ, and with single blanks."""
    label = line.partition(":")[0]
    if any(re.search(rf"(?<!\w){re.escape(word)}(?!\w)", label) for word in differs) and ":" in line:
        return NUMBER.sub("*", " ".join(line.split()))
    words = line.split()
    if columns and words and all(NUMBER.fullmatch(word) for word in words):
        for column in columns:
            words[column] = "*"
    masked = " ".join(words)
    for word in differs:
        masked = re.sub(rf"{NUMBER.pattern} {re.escape(word)}(?![\w/])", f"* {word}", masked)
    return masked


def _agree(found: str, expected: str) -> bool:
    pattern = ".*".join(re.escape(NUMBER.sub("#", part)) for part in expected.split("..."))
    if not re.fullmatch(pattern, NUMBER.sub("#", found)):
        return False
    if "..." in expected:
        return True
    numbers = zip(NUMBER.findall(found), NUMBER.findall(expected), strict=True)
    return all(abs(float(a) - float(b)) <= allow_difference(b) for a, b in numbers)
