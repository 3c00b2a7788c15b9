"""The tables of docs/case-file.md say what the schema says."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, Field

from ddic.case import schema
from ddic.errors import InputError

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

reference = importlib.import_module("write_case_reference")

SECTIONS = [value for value in vars(schema).values()
            if isinstance(value, type) and issubclass(value, schema.Section) and value is not schema.Section]


class Inner(BaseModel):
    pass


class Example(BaseModel):
    file: Path
    """A file."""
    length: schema.PositivePixels | None = None
    """A length."""
    ratio: Annotated[float, Field(gt=0, lt=1)] = 1e-6
    """A ratio."""
    kind: Literal["a", "b", "c"] = "b"
    """A kind."""
    degree: Literal[3, 5] = 3
    """A degree."""
    names: tuple[str, ...] = ("one", "two")
    """Names."""
    place: Annotated[tuple[float, float], schema.note(shape="[x, y]")] = (0.0, 1.5)
    """A place."""
    inner: Inner | None = None
    """More."""
    list_of: tuple[Inner, ...] = ()
    """More
    of it."""
    count: Annotated[int | None, Field(ge=1), schema.note(default="all")] = None
    """How many."""
    chosen: bool = False
    """Whether."""


def test_a_line_tells_type_default_unit_and_meaning() -> None:
    assert reference.format_table(Example)[2:] == [
        "| `file` | path | required | | A file. |",
        "| `length` | number > 0 | none | px | A length. |",
        "| `ratio` | number > 0 and < 1 | `1e-6` | | A ratio. |",
        '| `kind` | `"a"`, `"b"` or `"c"` | `"b"` | | A kind. |',
        "| `degree` | 3 or 5 | `3` | | A degree. |",
        '| `names` | list of texts | `["one", "two"]` | | Names. |',
        "| `place` | [x, y] | `[0.0, 1.5]` | | A place. |",
        "| `inner` | section | none | | More. |",
        "| `list_of` | list of sections | none | | More of it. |",
        "| `count` | whole number >= 1 | all | | How many. |",
        "| `chosen` | true or false | `false` | | Whether. |",
    ]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_key_is_described(section: type[schema.Section]) -> None:
    # Sections at the top level have chapters of their own.
    fields = section.model_fields if section is not schema.Case else {"title": section.model_fields["title"]}
    assert [name for name in fields if not reference.describe_keys(section).get(name)] == []


def test_what_is_not_below_a_mark_stays() -> None:
    text = "Words.\n\n<!-- keys: output -->\n| old | table |\n| 1 | 2 |\n\nMore words.\n| another | table |\n"
    written = reference.write_tables(text)
    assert written.startswith("Words.\n\n<!-- keys: output -->\n| key | type |")
    assert written.endswith("|\n\nMore words.\n| another | table |\n")
    assert "| old |" not in written
    assert reference.write_tables(written) == written


def test_a_mark_of_no_section_is_refused() -> None:
    with pytest.raises(InputError, match=r"mesh\.volume"):
        reference.write_tables("<!-- keys: mesh.volume -->\n")
