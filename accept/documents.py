"""A newcomer's path: where is Eq. n, and do the documents build; each by the tool that a person would use."""

from __future__ import annotations

import re
import subprocess
import sys

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, NotHereError, environment

PRINTED = 400
"""Characters of a tool's last words that a row shows."""


def measure_equations(scale: Scale) -> list[Row]:
    """Run the test that opens the function of every numbered equation of [BP17].

    Parameters
    ----------
    scale : Scale
        A smoke run does the same.

    Returns
    -------
    list of Row
        One row.
    """
    del scale
    code, printed = _run("pytest", "-q", "-p", "no:cacheprovider", "tests/test_equations.py")
    counts = re.findall(r"\d+ (?:passed|failed|error)[^\n]*", printed)
    return [Row("docs/symbols.md: numbered equations of [BP17], the function of each opened by tests/test_equations.py",
                "every equation has a row; every function says that it is it",
                counts[-1] if counts else printed[-PRINTED:], code == 0)]


def measure_docs(scale: Scale) -> list[Row]:
    """Build the documents, check public docstrings, and run every example for its number.

    Parameters
    ----------
    scale : Scale
        A smoke run leaves out the examples, which are tests of their own.

    Returns
    -------
    list of Row
        One for each.
    """
    rows = [_docstrings(), _build()]
    return rows if scale.smoke else [*rows, _examples()]


def _build() -> Row:
    code, printed = _run("mkdocs", "build", "--strict", "--quiet", "--site-dir", str(ROOT / "bench" / "data" / "site"))
    if "No module named mkdocs" in printed:
        raise NotHereError("mkdocs is not installed; make docs installs it")
    n_warnings = len(re.findall(r"^(?:WARNING|ERROR)", printed, re.MULTILINE))
    return Row("make docs", "builds without a warning", f"{n_warnings} warnings, exit code {code}"
               + (f": {printed[-PRINTED:]}" if code else ""), code == 0 and n_warnings == 0)


def _docstrings() -> Row:
    done = subprocess.run([sys.executable, "scripts/check_docstrings.py"], cwd=ROOT, text=True, capture_output=True,
                          env=environment(), check=False)
    lines = (done.stdout + done.stderr).strip().splitlines()
    return Row("public names of src/ddic: shapes and units in docstrings (scripts/check_docstrings.py)",
               "nothing is missing", lines[-1][-PRINTED:] if lines else "nothing", done.returncode == 0)


def _examples() -> Row:
    code, printed = _run("pytest", "-q", "-p", "no:cacheprovider", "tests/test_examples.py")
    counts = re.findall(r"\d+ (?:passed|failed|error)[^\n]*", printed)
    return Row("examples/: every printed number", "as its page shows", counts[-1] if counts else printed[-PRINTED:],
               code == 0)


def _run(module: str, *arguments: str) -> tuple[int, str]:
    """Exit code and output of a Python tool."""
    done = subprocess.run([sys.executable, "-m", module, *arguments], cwd=ROOT, text=True, capture_output=True,
                          env=environment(), check=False)
    return done.returncode, done.stdout + done.stderr
