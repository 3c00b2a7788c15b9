"""Rules of the source that a reader feels: modules of one chapter's length, collective calls in one place."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeGuard

from accept.table import Scale
from bench.support.before import checkout_before
from bench.support.rows import Row
from bench.support.runs import ROOT

SOURCE = ROOT / "src" / "ddic"
MOST_CODE_LINES, LONG_BY_NATURE = 400, ("pixel_kernels", "schema")
"""Of a module: lines of code; and modules that are one list or one kernel from end to end."""

RAW_COMM = re.compile(r"\b_?comm\.\w+\(")
"""A call of a communicator's own method."""

LOOKS_AT_FRAMES, MORE_CODE_AT = ("problem", "methods", "start"), "f43a80d"
"""Packages that look at frames, and the commit that they were last too large at."""

SPLIT_OFF = ("inputs", "check", "visibility")
"""Packages that hold what was in these then."""


def measure_source(scale: Scale) -> list[Row]:
    """Look for what breaks the rules.

    Parameters
    ----------
    scale : Scale
        A smoke run does the same.

    Returns
    -------
    list of Row
        One for each rule.
    """
    del scale
    files = sorted(SOURCE.rglob("*.py"))
    sizes = {path: count_code_lines(path.read_text(encoding="utf-8")) for path in files
             if path.stem not in LONG_BY_NATURE}
    largest = max(sizes, key=lambda path: sizes[path])
    raw = [found for path in files if "parallel" not in path.parts for found in _raw_calls(path)]
    return [
        Row(f"largest module of src/ but {' and '.join(LONG_BY_NATURE)}", f"at most {MOST_CODE_LINES} lines of code",
            f"{largest.relative_to(SOURCE)}: {sizes[largest]}", sizes[largest] <= MOST_CODE_LINES),
        Row("calls of a communicator outside parallel/", "none", _listed(raw), not raw),
    ]


def measure_frame_code(scale: Scale) -> list[Row]:
    """Count the code lines of what looks at frames.

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
    before = checkout_before(MORE_CODE_AT) / "src" / "ddic"
    packages = (*LOOKS_AT_FRAMES, *SPLIT_OFF)
    now, then = _count_packages(SOURCE, packages), _count_packages(before, LOOKS_AT_FRAMES)
    listed = ", ".join(f"{name} {count} for {then.get(name, 0)}" for name, count in now.items())
    n_now, n_then = sum(now.values()), sum(then.values())
    return [Row("code lines of what looks at frames: " + ", ".join(f"{name}/" for name in packages),
                f"fewer than the {n_then} of {MORE_CODE_AT}", f"{n_now} ({listed})", n_now < n_then,
                judged_small=False)]


def _count_packages(source: Path, packages: Sequence[str]) -> dict[str, int]:
    return {name: sum(count_code_lines(path.read_text(encoding="utf-8")) for path in (source / name).rglob("*.py"))
            for name in packages}


def count_code_lines(text: str) -> int:
    """Count lines that hold code: no blank ones, comments or docstrings.

    Parameters
    ----------
    text : str
        Python source.

    Returns
    -------
    int
        Lines.
    """
    documented = {line for node in ast.walk(ast.parse(text)) if _is_bare_text(node)
                  for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    no_code = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    coded = {line for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type not in no_code
             for line in range(token.start[0], token.end[0] + 1)}
    return len(coded - documented)


def _is_bare_text(node: ast.AST) -> TypeGuard[ast.Expr]:
    """Docstrings, and texts that describe what stands above them."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _raw_calls(path: Path) -> Iterator[str]:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if RAW_COMM.search(line):
            yield f"{path.relative_to(SOURCE)}:{number}"


def _listed(found: list[str]) -> str:
    return "; ".join(found) or "none breaks it"
