"""Names of src/ddic keep to docs/glossary.md."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "ddic"
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
FILES = sorted(SOURCE.rglob("*.py"))


@dataclass(frozen=True)
class Name:
    text: str
    kind: str
    folder: str

    @property
    def words(self) -> str:
        """Words in lower case with underscores around and between them."""
        parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z0-9]+|\d+", self.text)
        return "_" + "_".join(part.lower() for part in parts) + "_"


def rows(section: str) -> list[list[str]]:
    """Cells of the rows of the table of one section of the glossary."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    body = re.search(rf"^## {section}\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert body
    table = [line for line in body[1].splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:]]


def quoted(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


FORBIDDEN = {quoted(row[0])[0]: set(quoted(row[2])) for row in rows("Words not to use")}
VERBS = {verb for row in rows("Verbs") for verb in quoted(row[0])}
NOUNS = {noun for row in rows("Nouns") for noun in quoted(row[0])}


def needs_no_verb(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a function is read like an attribute, a second constructor, read after with, or typed as a command."""
    ends = ("property", ".setter", "classmethod", "contextmanager", ".command", ".group")
    names = [ast.unparse(d.func if isinstance(d, ast.Call) else d) for d in node.decorator_list]
    return any(name.endswith(ends) for name in names)


def public_names(file: Path) -> Iterator[Name]:
    folder = file.relative_to(SOURCE).parts[0]
    yield Name(file.stem, "file", folder)
    waiting: list[ast.AST] = [*ast.parse(file.read_text(encoding="utf-8")).body]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.AnnAssign | ast.Assign):
            targets = [node.target] if isinstance(node, ast.AnnAssign) else node.targets
            named = [target.id for target in targets if isinstance(target, ast.Name)]
            # The SHIFT of a diagonal is nobody's motion: constants have words of their own.
            named = [name for name in named if not name.startswith("_") and not name.isupper()]
            yield from (Name(name, "field", folder) for name in named)
        if not isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) or node.name.startswith("_"):
            continue
        if isinstance(node, ast.ClassDef):
            yield Name(node.name, "class", folder)
            waiting += node.body
            continue
        yield Name(node.name, "property" if needs_no_verb(node) else "function", folder)
        arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        yield from (Name(a.arg, "parameter", folder) for a in arguments if a.arg not in {"self", "cls"})


def forbidden_in(name: Name) -> list[str]:
    return [word for word, fine in FORBIDDEN.items() if f"_{word}_" in name.words and name.folder not in fine]


def is_well_begun(name: Name) -> bool:
    return name.kind != "function" or name.text in NOUNS or name.words.split("_")[1] in VERBS


def test_glossary_is_read() -> None:
    assert len(rows("Terms")) > 30
    assert {"hand_out", "told", "shift"} <= set(FORBIDDEN)
    assert {"assemble", "read"} <= VERBS
    assert not VERBS & NOUNS
    assert forbidden_in(Name("CameraPose", "class", "kinematics")) == ["pose"]
    assert forbidden_in(Name("right_hand_side", "function", "solvers")) == []
    assert forbidden_in(Name("rigid_shift", "function", "images")) == []
    assert not is_well_begun(Name("coverage_of", "function", "mesh"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(SOURCE)))
def test_names_of_a_file_keep_to_the_glossary(file: Path) -> None:
    names = set(public_names(file))
    assert sorted(f"{name.kind} {name.text}: {word}" for name in names for word in forbidden_in(name)) == []
    assert sorted(name.text for name in names if not is_well_begun(name)) == []


def test_every_noun_is_in_use() -> None:
    used = {name.text for file in FILES for name in public_names(file)}
    assert NOUNS - used == set()
