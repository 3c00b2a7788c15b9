"""The check of docstrings finds what it is there for, and lets pass what the style allows."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))

check_docstrings = pytest.importorskip("check_docstrings")

GOOD = '''
import numpy as np
from dataclasses import dataclass


def scale(values: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    """Multiply values by a number.

    Parameters
    ----------
    values : (n,) array
        Lengths, pixels.
    by : float
        The number.

    Returns
    -------
    (n,) array
        Lengths, pixels.

    Raises
    ------
    ValueError
        Where the number is negative.
    """
    if by < 0:
        raise ValueError("negative")
    return by * values


@dataclass(frozen=True)
class Pair:
    """Two images.

    Attributes
    ----------
    reference, deformed : (height, width) array
        Grey levels.
    """

    reference: NDArray[np.float64]
    deformed: NDArray[np.float64]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.reference.shape
'''


def codes(source: str, tmp_path: Path) -> list[str]:
    file = tmp_path / "module.py"
    file.write_text(source, encoding="utf-8")
    return [violation.code for violation in check_docstrings.check_files([file])]


def test_good_docstrings_pass(tmp_path: Path) -> None:
    assert codes(GOOD, tmp_path) == []


@pytest.mark.parametrize(("old", "new", "code"), [
    ('    """Multiply values by a number.', '    """Multiplies values by a number.', "SS05"),
    ("    values : (n,) array", "    values : array", "DD01"),
    ("    by : float\n        The number.\n", "", "PR01"),
    ("        The number.\n", "", "PR07"),
    ("    Returns\n    -------\n    (n,) array\n        Lengths, pixels.\n", "", "RT01"),
    ("    ValueError\n", "    TypeError\n", "DD03"),
    ("    reference, deformed :", "    reference :", "DD02"),
    ("        \"\"\"Height and width, pixels.\"\"\"\n", "", "GL08"),
])
def test_what_is_missing_is_found(old: str, new: str, code: str, tmp_path: Path) -> None:
    assert old in GOOD
    assert code in codes(GOOD.replace(old, new, 1), tmp_path)


CHILD = """

class Child(Pair):
    \"\"\"One more.\"\"\"

    def add(self, a: int) -> int:
        \"\"\"Add.\"\"\"
        return a
"""
LONG = """Add.

        Parameters
        ----------
        a : int
            One.

        Returns
        -------
        int
            The sum.
        """


def test_children_need_not_repeat_what_their_base_says(tmp_path: Path) -> None:
    assert codes(GOOD + CHILD, tmp_path) == ["PR01", "RT01"]
    base = CHILD.replace("Child(Pair)", "Base").replace("Add.", LONG)
    assert codes(GOOD + base + CHILD.replace("Child(Pair)", "Child(Base)"), tmp_path) == []


def test_one_sentence_is_enough_where_nobody_implements_or_imports_it(tmp_path: Path,
                                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_docstrings, "ROOT", tmp_path)
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text(encoding="utf-8"), encoding="utf-8")
    short = 'def add(a: int) -> int:\n    """Add."""\n    return a\n'
    begun = short.replace("Add.", "Add.\\n\\n    Parameters\\n    ----------\\n    a : int\\n        One.\\n    ")
    found = {}
    for place in ("api/measure.py", "solvers/sums.py"):
        file = tmp_path / "src" / "ddic" / place
        file.parent.mkdir(parents=True)
        found[place] = [codes_of(file, text) for text in (short, begun)]
    assert found["solvers/sums.py"] == [[], ["RT01"]]
    assert found["api/measure.py"] == [["PR01", "RT01"], ["RT01"]]


def codes_of(file: Path, source: str) -> list[str]:
    file.write_text('"""Sums."""\n\n' + source, encoding="utf-8")
    return sorted(violation.code for violation in check_docstrings.check_files([file]))
