"""The files that a check of an acceptance table runs, and which of them have changed since a commit.

What a module imports is followed through ``ddic``, ``accept`` and ``bench``, as it stands in the source. So are the
modules that it starts as programs, which it names in a string. Whoever imports ``ddic`` itself or starts its command
line runs all of the product. A file whose comments and docstrings alone differ has not changed.
"""

from __future__ import annotations

import ast
import hashlib
import subprocess
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path

from bench.support.runs import ROOT

PACKAGES = {"ddic": "src/ddic", "accept": "accept", "bench": "bench"}
"""Folders of the packages that are followed."""

NO_SOURCE = ("bench/data/", "bench/results/")
"""Folders below them that hold no source of this repository, though Python files may lie there."""

RUNS, STARTS_DDIC = "bench.support.runs", frozenset({"ddic", "ddic_command", "ddic_run", "images"})
"""A module, and those of its functions that start the command line."""

KEEPERS = frozenset({"accept.table", "accept.tables", "accept.ledger", "accept.all_tables",
                     "accept.support.code_of_check", "bench.support.rows"})
"""Modules that keep and print what is measured, and have no part in it."""

LEDGER = "accept/ledger.json"
"""Which is no code, though a folder that is read may hold it."""

READ: Mapping[str, tuple[str, ...]] = {
    "accept.demo_pairs": ("examples/demo",),
    "accept.environment": ("Makefile", "constraints", "pyproject.toml", "scripts"),
    "accept.kinematics": ("examples",),
    "accept.pages": ("docs", "examples", "scripts", "README.md", "CONTRIBUTING.md", "Makefile", "mkdocs.yml",
                     "tests/test_equations.py"),
    "accept.paper_pictures": ("examples/near_far",),
    "accept.recorded": ("accept/recorded",),
    "accept.slurm_job": ("scripts",),
    "accept.smoke": ("accept", "bench"),
    "accept.source_rules": ("src/ddic",),
}
"""What modules read beside what they import."""


def find_code(check: Callable[..., object]) -> frozenset[str]:
    """Find all files that a check runs or reads."""
    return _code_of(_defining_module(check))


@cache
def find_changed(commit: str, root: Path = ROOT) -> frozenset[str] | None:
    """Find the files that differ between a commit and the last one of this branch."""
    try:
        return _compare(root, commit, "HEAD")
    except subprocess.CalledProcessError:
        return None


def find_uncommitted(commit: str = "HEAD", root: Path = ROOT) -> frozenset[str]:
    """Find the files that differ between a commit and the working tree, or are not part of the repository yet."""
    new = _git(root, "ls-files", "--others", "--exclude-standard").splitlines()
    return _compare(root, commit, None) | frozenset(new)


def choose(files: frozenset[str], code: frozenset[str]) -> list[str]:
    """Choose the files that are part of some code."""
    return sorted(file for file in files - {LEDGER} if code & {file, *map(str, Path(file).parents)})


def _defining_module(check: Callable[..., object]) -> str:
    while isinstance(check, partial):
        check = check.func
    return check.__module__


@cache
def _code_of(module: str) -> frozenset[str]:
    modules = _modules()
    found: set[str] = set()
    ahead = [module]
    while ahead:
        name = ahead.pop()
        if name in found or name in KEEPERS:
            continue
        found.add(name)
        ahead += _runs(name)
    return frozenset({modules[name] for name in found}.union(*(READ.get(name, ()) for name in found)))


@cache
def _modules() -> dict[str, str]:
    """Files of all modules of the followed packages, by dotted name."""
    modules = {}
    for package, folder in PACKAGES.items():
        for path in (ROOT / folder).rglob("*.py"):
            file = path.relative_to(ROOT).as_posix()
            if file.startswith(NO_SOURCE):
                continue
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            modules[".".join([package, *(part for part in parts if part != "__init__")])] = file
    return modules


@cache
def _runs(module: str) -> frozenset[str]:
    """The modules that a module imports or starts, with the packages that they are in."""
    modules = _modules()
    named = set(_names(module, ast.parse((ROOT / modules[module]).read_text(encoding="utf-8"))))
    programs = {Path(file).name: name for name, file in modules.items() if not name.startswith("ddic")}
    found = {name for name in named if name in modules} | {programs[name] for name in named if name in programs}
    if "ddic" in found and not module.startswith("ddic"):
        found |= {name for name in modules if name.startswith("ddic")}
    # A package is imported before what it holds.
    for name in list(found):
        parts = name.split(".")
        found |= {".".join(parts[:n]) for n in range(1, len(parts))} - {"ddic"}
    return frozenset(name for name in found if name in modules)


def _names(module: str, tree: ast.Module) -> Iterator[str]:
    """Names that may be those of modules or of their files."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
            if node.module == RUNS and STARTS_DDIC & {alias.name for alias in node.names}:
                yield "ddic"
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and module != RUNS:
            yield node.value


def _compare(root: Path, commit: str, until: str | None) -> frozenset[str]:
    """Files that differ between two commits, or a commit and the working tree."""
    commits = [commit] if until is None else [commit, until]
    listed = _git(root, "diff", "--raw", "--no-abbrev", "--no-renames", *commits, "--").splitlines()
    return frozenset(line.partition("\t")[2] for line in listed if _differs(root, line))


def _differs(root: Path, line: str) -> bool:
    """Whether a file that git says differs, in a line of its raw form, does so in more than comments and docstrings."""
    change, _, file = line.partition("\t")
    # Names of the contents: zeros for those of the working tree.
    *_, before, after, status = change.split()
    if status != "M" or not file.endswith(".py"):
        return True
    try:
        now = _bare_of(root, after) if after.strip("0") else _bare((root / file).read_text(encoding="utf-8"))
        return _bare_of(root, before) != now
    except (OSError, SyntaxError):
        return True


@cache
def _bare_of(root: Path, contents: str) -> bytes:
    # Most files have few contents among all commits that something was measured at.
    return _bare(_git(root, "cat-file", "blob", contents))


def _bare(source: str) -> bytes:
    """A digest of what a source does: of its syntax tree without docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        for statements in (getattr(node, "body", None), getattr(node, "orelse", None)):
            if isinstance(statements, list):
                statements[:] = [s for s in statements if not _is_text(s)]
    return hashlib.sha256(ast.dump(tree).encode()).digest()


def _is_text(statement: ast.AST) -> bool:
    return (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            and isinstance(statement.value.value, str))


def _git(root: Path, *arguments: str) -> str:
    return subprocess.run(["git", "-C", str(root), *arguments], check=True, capture_output=True, text=True).stdout
