from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel, Field

from ddic.case import schema
from ddic.case.reference import format_table, write_tables
from ddic.errors import InputError

SECTIONS = [value for value in vars(schema).values()
            if isinstance(value, type) and issubclass(value, schema.Section) and value is not schema.Section]


class Inner(BaseModel):
    pass


class Example(BaseModel):
    file: Path = Field(description="A file.")
    length: schema.Positive | None = Field(default=None, description="A length.", json_schema_extra={"unit": "px"})
    ratio: float = Field(default=1e-6, gt=0, lt=1, description="A ratio.")
    kind: Literal["a", "b", "c"] = Field(default="b", description="A kind.")
    degree: Literal[3, 5] = Field(default=3, description="A degree.")
    names: tuple[str, ...] = Field(default=("one", "two"), description="Names.")
    place: tuple[float, float] = Field(default=(0.0, 1.5), description="A place.",
                                       json_schema_extra={"shape": "[x, y]"})
    inner: Inner | None = Field(default=None, description="More.")
    list_of: tuple[Inner, ...] = Field(default=(), description="More of it.")
    count: int | None = Field(default=None, ge=1, description="How many.", json_schema_extra={"default": "all"})
    chosen: bool = Field(default=False, description="Whether.")


def test_a_line_tells_type_default_unit_and_meaning() -> None:
    assert format_table(Example)[2:] == [
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
    assert [name for name, field in fields.items() if not field.description] == []


def test_what_is_not_below_a_mark_stays() -> None:
    text = "Words.\n\n<!-- keys: output -->\n| old | table |\n| 1 | 2 |\n\nMore words.\n| another | table |\n"
    written = write_tables(text)
    assert written.startswith("Words.\n\n<!-- keys: output -->\n| key | type |")
    assert written.endswith("|\n\nMore words.\n| another | table |\n")
    assert "| old |" not in written
    assert write_tables(written) == written


def test_a_mark_of_no_section_is_refused() -> None:
    with pytest.raises(InputError, match=r"mesh\.volume"):
        write_tables("<!-- keys: mesh.volume -->\n")
