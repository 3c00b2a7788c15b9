"""Write the tables of docs/case-file.md from the schema; with --check, fail where they differ from it.

A table stands below a line ``<!-- keys: SECTION -->``; SECTION is the keys that lead to it joined by dots, or nothing
for the top level. The text around is written by hand.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
import textwrap
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ddic.case.schema import Case, ImagingSection, find_section, find_section_in
from ddic.errors import InputError

DOCUMENT = Path(__file__).parents[1] / "docs" / "case-file.md"
HEAD = ("| key | type | default | unit | meaning |", "|---|---|---|---|---|")
TABLE = re.compile(r"(?P<mark><!-- keys: ?(?P<section>[\w.]*) -->\n)(?:\|.*\n)*")
COMPARISONS = {Gt: (">", "gt"), Ge: (">=", "ge"), Lt: ("<", "lt"), Le: ("<=", "le")}
PLAIN_TYPES = {bool: "true or false", int: "whole number", float: "number", str: "text", Path: "path"}


def write_tables(text: str) -> str:
    """Replace the tables of a document, each below its mark, by those of the schema; it is the same if they were right.

    Raises InputError where a mark names no section of the schema.
    """
    return TABLE.sub(_marked_table, text)


def format_table(section: type[BaseModel]) -> list[str]:
    """Describe the keys of a section in lines of a Markdown table: key, type, default, unit, meaning."""
    meanings = describe_keys(section)
    # Sections of the top level have chapters of their own.
    fields = section.model_fields.items()
    if issubclass(section, ImagingSection):
        # What images and volumes have in common comes last.
        fields = sorted(fields, key=lambda named: named[0] in ImagingSection.model_fields)
    rows = [_row(name, field, meanings.get(name, "")) for name, field in fields
            if section is not Case or find_section_in(field.annotation) is None]
    return [*HEAD, *rows]


def describe_keys(section: type[BaseModel]) -> dict[str, str]:
    """Read what the keys of a section mean: the text that stands below each in the source, of its bases too."""
    meanings = {}
    for base in reversed(section.__mro__[:section.__mro__.index(BaseModel)]):
        [parsed] = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        for key, text in pairwise(parsed.body if isinstance(parsed, ast.ClassDef) else ()):
            if isinstance(key, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                meanings[ast.unparse(key.target)] = " ".join(str(text.value.value).split())
    return meanings


def _marked_table(found: re.Match[str]) -> str:
    """The mark and its table."""
    name = found["section"]
    section = find_section(tuple(name.split(".")) if name else ())
    if section is None:
        raise InputError(f'keys: {name}: no such section of a case file; give one such as "mesh.structured"')
    return found["mark"] + "\n".join(format_table(section)) + "\n"


def _row(name: str, field: FieldInfo, meaning: str) -> str:
    """A key's line."""
    extra = _find_notes(field)
    shape = extra.get("shape")
    kind = _type_text(field.annotation, field.metadata) if shape is None else shape
    default = extra.get("default") or _default_text(field)
    unit = extra.get("unit", "")
    cells = (f"`{name}`", kind, default, unit, meaning)
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


def _find_notes(field: FieldInfo) -> dict[str, str]:
    """What the schema notes beside a key's type; of an optional one beside the type that it has where it is given."""
    notes: dict[str, str] = {}
    for part in get_args(field.annotation):
        for inner in get_args(part) if get_origin(part) is Annotated else ():
            if isinstance(inner, FieldInfo):
                notes |= _get_notes(inner)
    return notes | _get_notes(field)


def _get_notes(field: FieldInfo) -> dict[str, str]:
    notes = field.json_schema_extra
    return {key: str(value) for key, value in notes.items()} if isinstance(notes, dict) else {}


def _type_text(annotation: Any, metadata: list[Any]) -> str:
    """What a key takes, in words; metadata: bounds that pydantic took out of the annotation."""
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *constraints = get_args(annotation)
        bounds = [bound for item in constraints if isinstance(item, FieldInfo) for bound in item.metadata]
        return _type_text(inner, bounds)
    if origin in (Union, UnionType):
        inner, _none = get_args(annotation)
        return _type_text(inner, metadata)
    if origin is Literal:
        *first, last = (f"`{_toml(value)}`" if isinstance(value, str) else str(value) for value in get_args(annotation))
        return f"{', '.join(first)} or {last}"
    if find_section_in(annotation) is not None:
        return "list of sections" if origin is tuple else "section"
    if origin is tuple:
        return f"list of {PLAIN_TYPES[get_args(annotation)[0]]}s"
    bounds = [f"{COMPARISONS[type(bound)][0]} {getattr(bound, COMPARISONS[type(bound)][1]):g}" for bound in metadata
              if type(bound) in COMPARISONS]
    return f"{PLAIN_TYPES[annotation]} {' and '.join(bounds)}".rstrip()


def _default_text(field: FieldInfo) -> str:
    """The default as TOML, "required", or "none" where the key has no value if it is left out."""
    if field.is_required():
        return "required"
    holds_sections = find_section_in(field.annotation) is not None
    if field.default is None or (holds_sections and field.default == ()):
        return "none"
    return f"`{_toml(field.default)}`"


def _toml(value: Any) -> str:
    """A value as a case file writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | Path):
        return f'"{value}"'
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    # 1e-06 is written 1e-6.
    return re.sub(r"e-0(\d)$", r"e-\1", repr(value))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 where the tables are old")
    check = parser.parse_args().check
    committed = DOCUMENT.read_text(encoding="utf-8")
    written = write_tables(committed)
    if written == committed:
        return 0
    if check:
        print(f"{DOCUMENT}: its tables are not those of the schema; run python scripts/write_case_reference.py")
        return 1
    DOCUMENT.write_text(written, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
