"""Rules of the source that a reader feels: short recipes, few parameters, collective calls in one place."""

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
MOST_LINES, MOST_IMPORTS = 120, 12
"""Of a recipe: lines, and imports from ddic."""

MOST_PARAMETERS = 6
"""Of a function; kernels and the command line may have more."""

RAW_COMM = re.compile(r"\b_?comm\.\w+\(")
"""A call of a communicator's own method."""

LOOKS_AT_FRAMES, MORE_CODE_AT = ("problem", "methods", "start"), "f43a80d"
"""Packages that look at frames, and the commit that they were last too large at."""

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


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
    recipes = [found for path in sorted((SOURCE / "methods").glob("*.py")) for found in _long_recipe(path)]
    files = sorted(SOURCE.rglob("*.py"))
    many = [found for path in files for found in _many_parameters(path)]
    raw = [found for path in files if "parallel" not in path.parts for found in _raw_calls(path)]
    return [
        Row("recipes: files of methods/", f"at most {MOST_LINES} lines and {MOST_IMPORTS} imports from ddic each",
            _listed(recipes), not recipes),
        Row("functions of src/ but kernels and the command line", f"at most {MOST_PARAMETERS} parameters",
            _listed(many), not many),
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
    # What moved to a package that is new counts as what it was.
    new = sorted({path.parent.name for path in SOURCE.glob("*/__init__.py")}
                 - {path.parent.name for path in before.glob("*/__init__.py")})
    now, then = _count_packages(SOURCE, (*LOOKS_AT_FRAMES, *new)), _count_packages(before, LOOKS_AT_FRAMES)
    listed = ", ".join(f"{name} {count} for {then.get(name, 0)}" for name, count in now.items())
    n_now, n_then = sum(now.values()), sum(then.values())
    return [Row("code lines of what looks at frames: " + ", ".join(f"{name}/" for name in (*LOOKS_AT_FRAMES, *new)),
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


def _long_recipe(path: Path) -> Iterator[str]:
    text = path.read_text(encoding="utf-8")
    n_lines = len(text.splitlines())
    imports = [node for node in ast.walk(ast.parse(text))
               if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ddic")]
    if n_lines > MOST_LINES or len(imports) > MOST_IMPORTS:
        yield f"{path.name} has {n_lines} lines, {len(imports)} imports"


def _many_parameters(path: Path) -> Iterator[str]:
    # A readable kernel takes what the compiled one takes, which it explains.
    if "cli" in path.parts or "kernels" in path.stem:
        return
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, FUNCTIONS):
            continue
        if any("njit" in ast.unparse(decorator) for decorator in node.decorator_list):
            continue
        arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
        count = sum(argument.arg not in ("self", "cls") for argument in arguments)
        if count > MOST_PARAMETERS:
            yield f"{path.relative_to(SOURCE)}:{node.name} has {count}"


def _raw_calls(path: Path) -> Iterator[str]:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if RAW_COMM.search(line):
            yield f"{path.relative_to(SOURCE)}:{number}"


def _listed(found: list[str]) -> str:
    return "; ".join(found) or "none breaks it"
