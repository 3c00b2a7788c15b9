"""Rules of the source that a reader feels: short recipes, few parameters, collective calls in one place."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT

SOURCE = ROOT / "src" / "ddic"
MOST_LINES, MOST_IMPORTS = 120, 12
"""Of a recipe: lines, and imports from ddic."""

MOST_PARAMETERS = 6
"""Of a function; kernels and the command line may have more."""

RAW_COMM = re.compile(r"\b_?comm\.\w+\(")
"""A call of a communicator's own method."""

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
