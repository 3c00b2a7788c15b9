"""Every numbered equation of [BP17] has a row in docs/symbols.md, and the function of a row says that it is it."""

from __future__ import annotations

import importlib
import re
from functools import reduce
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
N_EQUATIONS = 41


def equation_rows() -> list[list[str]]:
    text = (ROOT / "docs" / "symbols.md").read_text(encoding="utf-8").split("## Equations of [BP17]")[1]
    lines = [line for line in text.split("\n## ")[0].splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[2:]]


ROWS = equation_rows()
IMPLEMENTED = [row for row in ROWS if row[2]]


def spanned(text: str) -> set[int]:
    """Numbers of "24-27", "24a" or "30, 31"."""
    found: set[int] = set()
    for first, last in re.findall(r"(\d+)[a-z]?(?:\s*-\s*(\d+))?", text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def named_equations(docstring: str) -> set[int]:
    """Numbers after "Eq." in a docstring."""
    found: set[int] = set()
    for numbers in re.findall(r"\bEqs?\.\s*\(?((?:\d+[a-z]?\)?(?:\s*(?:-|,|and)\s*\(?)?)+)", docstring):
        found |= spanned(numbers)
    return found


def test_numbers_are_read() -> None:
    assert named_equations("Assemble M, Eq. 5 of [BP17].") == {5}
    assert named_equations("Solve, Eq. (24a) of [BP17]; Eq. 30-31 of [BP17].") == {24, 30, 31}
    assert named_equations("Twelve, 12 and 13.") == set()


def test_every_equation_has_a_row() -> None:
    assert set().union(*(spanned(row[0]) for row in ROWS)) == set(range(1, N_EQUATIONS + 1))
    # A row without a function says why.
    assert [row[0] for row in ROWS if not row[2] and "not implemented" not in row[1]] == []


@pytest.mark.parametrize("row", IMPLEMENTED, ids=lambda row: f"{row[0]} {row[2]}".replace("`", ""))
def test_function_of_an_equation_names_it(row: list[str]) -> None:
    name, file = row[2].strip("`"), row[3].strip("`")
    assert (ROOT / file).is_file(), f"docs/symbols.md: Eq. {row[0]} is said to be in {file}, which does not exist"
    module = importlib.import_module(file.removeprefix("src/").removesuffix(".py").replace("/", "."))
    try:
        function = reduce(getattr, name.split("."), module)
    except AttributeError:
        pytest.fail(f"docs/symbols.md: Eq. {row[0]} is said to be {name}, which {file} does not hold")
    owner = reduce(getattr, name.split(".")[:-1], module)
    said = named_equations(function.__doc__ or "") | (named_equations(owner.__doc__ or "") if "." in name else set())
    missing = spanned(row[0]) - said
    assert not missing, f"{file}: the docstring of {name} does not say 'Eq. {sorted(missing)[0]} of [BP17]'"
