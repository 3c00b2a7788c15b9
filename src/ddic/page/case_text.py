"""What is drawn on an image and stands in a case file: its kinds, and the text, changed in one place at a time.

All else in the text, comments too, stays as it was written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import tomlkit
from tomlkit import items

from ddic.arrays import Array
from ddic.errors import InputError

Point = tuple[float, float]
Form = Literal["box", "polygon", "circle", "line"]

FEWEST = {"box": 2, "polygon": 3, "circle": 2, "line": 2}
"""Clicks of each form: two opposite corners, the vertices, the centre and a point of the circle, the vertices."""

CLICKS = {
    "box": "click two opposite corners",
    "polygon": "click its vertices, then Finish or a double click",
    "circle": "click its centre, then its rim",
    "line": "click its vertices, then Finish or a double click",
}

N_SIDES = 72
"""Sides of the polygon that a circle is drawn as."""


@dataclass(frozen=True)
class Kind:
    """What a drawn shape means.

    Attributes
    ----------
    name : str
        As the page calls it.
    keys : tuple of str
        Where it stands in the case file: sections and key.
    form : {"box", "polygon", "circle", "line"}
        How it is written there.
    several : bool
        Whether the key takes a list of them.
    """

    name: str
    keys: tuple[str, ...]
    form: Form
    several: bool = False


MESH = ("mesh", "structured")
REGION = (*MESH, "region")
LINES = ("discontinuity",)

KINDS = (
    Kind("region: rectangle", REGION, "box"),
    Kind("region: polygon", REGION, "polygon"),
    Kind("region: circle", REGION, "circle"),
    Kind("hole: circle", (*MESH, "circles"), "circle", several=True),
    Kind("hole: polygon", (*MESH, "polygons"), "polygon", several=True),
    Kind("line: crack, shear band", LINES, "line", several=True),
    Kind("edge not controlled: box", ("regularization", "boxes"), "box", several=True),
    Kind("near field: window", ("near", "region"), "box", several=True),
)

BY_NAME = {kind.name: kind for kind in KINDS}


@dataclass(frozen=True)
class Shape:
    """A drawn shape.

    Attributes
    ----------
    kind : Kind
        What it means.
    vertices : tuple of (x, y)
        What was clicked, pixels of the reference image.
    place : int
        In the list of the key; 0 where it takes no list.
    """

    kind: Kind
    vertices: tuple[Point, ...]
    place: int = 0

    @property
    def name(self) -> str:
        """What the page calls it; counted from 1 where there may be several."""
        return f"{self.kind.name} {self.place + 1}" if self.kind.several else self.kind.name

    @property
    def outline(self) -> Array:
        """What is drawn, (n, 2), pixels; the last point is the first one, but for lines."""
        points = np.array(self.vertices)
        if self.kind.form == "box":
            (x0, y0), (x1, y1) = points
            return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)])
        if self.kind.form == "circle":
            angle = np.linspace(0.0, 2.0 * math.pi, N_SIDES + 1)
            radius = np.linalg.norm(points[1] - points[0])
            return np.asarray(points[0] + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        return np.vstack([points, points[:1]]) if self.kind.form == "polygon" else points

    def describe(self) -> dict[str, Any] | list[Any]:
        """Write it as its key takes it."""
        if self.kind.form == "box":
            x, y = zip(*self.vertices, strict=True)
            return [min(x), min(y), max(x), max(y)]
        if self.kind.form == "circle":
            radius = float(f"{math.dist(*self.vertices):.6g}")
            return {"center": [*self.vertices[0]], "radius": radius}
        return {"vertices": [[*vertex] for vertex in self.vertices]}


def read_shape(kind: Kind, value: Any, place: int = 0) -> Shape | None:
    """Read a value of a case file as a shape of a kind; None where it has another form, or is wrong."""
    try:
        vertices = _read_vertices(kind.form, value)
    except (TypeError, ValueError, KeyError):
        return None
    is_finite = all(math.isfinite(number) for vertex in vertices for number in vertex)
    return Shape(kind, vertices, place) if is_finite and len(vertices) >= FEWEST[kind.form] else None


def _read_vertices(form: Form, value: Any) -> tuple[Point, ...]:
    if form == "box":
        x0, y0, x1, y1 = map(float, value)
        return (x0, y0), (x1, y1)
    if form == "circle":
        x, y = map(float, value["center"])
        return (x, y), (x + float(value["radius"]), y)
    return tuple((float(x), float(y)) for x, y in value["vertices"])


def list_shapes(data: Mapping[str, Any]) -> list[Shape]:
    """List what a parsed case file holds that can be drawn."""
    shapes = []
    for kind in KINDS:
        for place, value in _list_values(kind, data):
            shape = read_shape(kind, value, place)
            if shape is not None:
                shapes.append(shape)
    return shapes


def _list_values(kind: Kind, data: Any) -> list[tuple[int, Any]]:
    """Values of a kind's key with their places in its list."""
    for step, key in enumerate(kind.keys):
        if isinstance(data, list):
            # A key in each of several sections, as near.region.
            rest = kind.keys[step:]
            return [(place, section[rest[0]]) for place, section in enumerate(data)
                    if isinstance(section, Mapping) and rest[0] in section]
        if not isinstance(data, Mapping) or key not in data:
            return []
        data = data[key]
    if not kind.several:
        return [(0, data)]
    return list(enumerate(data)) if isinstance(data, list) else []


LONGEST_LINE = 100
"""Of a list, characters, from which on its items stand on lines of their own."""


def set_shape(text: str, shape: Shape) -> str:
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
    if not isinstance(values, items.Array | items.AoT):
        raise InputError(f"{key}: is no list in this text; correct it there")
    if place < len(values):
        values[place] = value
    else:
        values.append(value)
    if isinstance(values, items.Array):
        values.multiline(len(values.as_string()) > LONGEST_LINE)


def _put_line(document: Any, shape: Shape) -> None:
    """A discontinuity's vertices, whose section keeps its other keys."""
    described = shape.describe()
    vertices = _convert(described["vertices"] if isinstance(described, dict) else described)
    key = LINES[0]
    if key in document and not isinstance(document[key], items.AoT):
        del document[key]
    if key not in document:
        document.add(tomlkit.nl())
        document.add(key, tomlkit.aot())
    sections = document[key]
    if shape.place < len(sections):
        _set(sections[shape.place], "vertices", vertices)
        return
    made = tomlkit.table()
    made.add("vertices", vertices)
    sections.append(made)


def _find_near(document: Any, shape: Shape) -> Any:
    """The section of a near field whose window is drawn."""
    sections = document.get("near", [])
    if shape.place >= len(sections):
        raise InputError(f"near field {shape.place + 1}: the case has {len(sections)} [[near]] sections; write one "
                         "with its images and mapping first")
    return sections[shape.place]
