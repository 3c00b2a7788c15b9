"""The text of a case file, changed in one place at a time: all else, comments too, stays as it was written."""

from __future__ import annotations

from typing import Any

import tomlkit
from tomlkit.items import AoT, Array, Table

from ddic.errors import InputError
from ddic.page.shapes import LINES, Kind, Shape

LONGEST_LINE = 100
"""Of a list, characters, from which on its items stand on lines of their own."""


def put_shape(text: str, shape: Shape) -> str:
    """Write a shape to its place: over the one that is there, or after the last one."""
    document: Any = tomlkit.parse(text)
    value = _convert(shape.describe())
    kind = shape.kind
    if kind.keys == LINES:
        _put_line(document, shape)
    elif kind.keys[0] == "near":
        _find_near(document, shape)[kind.keys[-1]] = value
    else:
        section = _find_section(document, kind.keys[:-1])
        if kind.several:
            _put_in_list(section, kind.keys[-1], shape.place, value)
        else:
            _set(section, kind.keys[-1], value)
    return str(tomlkit.dumps(document))


def remove_shape(text: str, shape: Shape) -> str:
    """Take a shape out of the text."""
    document: Any = tomlkit.parse(text)
    *sections, key = shape.kind.keys
    if shape.kind.keys == LINES:
        holder: Any = document[key]
    elif shape.kind.keys[0] == "near":
        del _find_near(document, shape)[key]
        return str(tomlkit.dumps(document))
    else:
        holder = _find_section(document, tuple(sections))
        if not shape.kind.several:
            del holder[key]
            return str(tomlkit.dumps(document))
        holder = holder[key]
    del holder[shape.place]
    if not holder:
        # An empty list of sections would be one without a value.
        owner = document if shape.kind.keys == LINES else _find_section(document, tuple(sections))
        del owner[key]
    return str(tomlkit.dumps(document))


def set_number(text: str, keys: tuple[str, ...], value: float | None) -> str:
    """Set a number of a section, or take it out where it is None."""
    document: Any = tomlkit.parse(text)
    section = _find_section(document, keys[:-1])
    if value is None:
        section.pop(keys[-1], None)
        if not section:
            del document[keys[0]]
    else:
        _set(section, keys[-1], _convert(value))
    return str(tomlkit.dumps(document))


def count_values(text: str, kind: Kind) -> int:
    """Count the values in the list of a kind's key: the place of the next one."""
    data: Any = tomlkit.parse(text)
    for key in kind.keys:
        if not hasattr(data, "get") or key not in data:
            return 0
        data = data[key]
    return len(data)


def _convert(value: Any) -> Any:
    """Numbers as a person writes them: 16 and not 16.0."""
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        table.update({key: _convert(item) for key, item in value.items()})
        return table
    if isinstance(value, list):
        items = tomlkit.array()
        items.extend(_convert(item) for item in value)
        return items
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _find_section(document: Any, keys: tuple[str, ...]) -> Any:
    """A section of the document, made at its end where it is not there."""
    section = document
    for key in keys:
        if key not in section:
            made = tomlkit.table()
            if section is document:
                document.add(tomlkit.nl())
            section.add(key, made)
        section = section[key]
    if not isinstance(section, dict):
        raise InputError(f"{'.'.join(keys)}: is no section in this text; correct it there")
    return section


def _set(section: Any, key: str, value: Any) -> None:
    """Set a key; the comment behind it stays."""
    item = tomlkit.item(value)
    if key in section:
        before = section.item(key).trivia
        item.trivia.comment_ws, item.trivia.comment = before.comment_ws, before.comment
    section[key] = item


def _put_in_list(section: Any, key: str, place: int, value: Any) -> None:
    if key not in section:
        section[key] = tomlkit.array()
    values = section[key]
    if not isinstance(values, Array | AoT):
        raise InputError(f"{key}: is no list in this text; correct it there")
    if place < len(values):
        values[place] = value
    else:
        values.append(value)
    if isinstance(values, Array):
        values.multiline(len(values.as_string()) > LONGEST_LINE)


def _put_line(document: Any, shape: Shape) -> None:
    """A discontinuity's vertices, whose section keeps its other keys."""
    described = shape.describe()
    vertices = _convert(described["vertices"] if isinstance(described, dict) else described)
    key = LINES[0]
    if key in document and not isinstance(document[key], AoT):
        del document[key]
    if key not in document:
        document.add(tomlkit.nl())
        document.add(key, tomlkit.aot())
    sections = document[key]
    if shape.place < len(sections):
        _set(sections[shape.place], "vertices", vertices)
        return
    made: Table = tomlkit.table()
    made.add("vertices", vertices)
    sections.append(made)


def _find_near(document: Any, shape: Shape) -> Any:
    """The section of a near field whose window is drawn."""
    sections = document.get("near", [])
    if shape.place >= len(sections):
        raise InputError(f"near field {shape.place + 1}: the case has {len(sections)} [[near]] sections; write one "
                         "with its images and mapping first")
    return sections[shape.place]
