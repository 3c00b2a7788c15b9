"""What is drawn on an image and stands in a case file: its kinds, and the text, changed in one place at a time.

All else in the text, comments too, stays as it was written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import tomlkit
from tomlkit import items

from ddic.arrays import Array
from ddic.case.loader import DETECT
from ddic.errors import InputError

Point = tuple[float, float]
Form = Literal["box", "polygon", "circle", "line"]

FEWEST = {"box": 2, "polygon": 3, "circle": 2, "line": 2}
"""Clicks of each form: two opposite corners, the vertices, the centre and a point of the circle, the vertices."""

VERTICES = "click its vertices, then Finish or a double click"

CLICKS = {"box": "click two opposite corners", "polygon": VERTICES, "circle": "click its centre, then its rim",
          "line": VERTICES}

N_SIDES = 72
"""Sides of the polygon that a circle is drawn as."""

MESH, BY_GMSH = ("mesh", "structured"), ("mesh", "unstructured")
REGION = (*MESH, "region")
DEFORMED = ("images", "deformed")
MASKED = ("images", "masked")
LINES = ("discontinuity",)
NEAR = ("near", "region")


@dataclass(frozen=True)
class Kind:
    """What a drawn shape means.

    Attributes
    ----------
    name : str
        As the page calls it.
    keys : tuple of str
        Where it stands in the case file: sections and key; of a mesh by gmsh see ``find_keys``.
    form : {"box", "polygon", "circle", "line"}
        How it is written there.
    several : bool
        Whether the key takes a list of them.
    """

    name: str
    keys: tuple[str, ...]
    form: Form
    several: bool = False

    @property
    def is_in_list(self) -> bool:
        """Whether the key itself holds the list, and not each of several sections one of them."""
        return self.several and self.keys != NEAR


KINDS = (
    Kind("region: rectangle", REGION, "box"),
    Kind("region: polygon", REGION, "polygon"),
    Kind("region: circle", REGION, "circle"),
    Kind("hole: circle", (*MESH, "circles"), "circle", several=True),
    Kind("hole: polygon", (*MESH, "polygons"), "polygon", several=True),
    Kind("mask: rectangle", MASKED, "box", several=True),
    Kind("mask: polygon", MASKED, "polygon", several=True),
    Kind("mask: circle", MASKED, "circle", several=True),
    Kind("line: crack, shear band", LINES, "line", several=True),
    Kind("edge not controlled: box", ("regularization", "boxes"), "box", several=True),
    Kind("near field: window", NEAR, "box", several=True),
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
            # Without the rounding of the point on the rim.
            return {"center": [*self.vertices[0]], "radius": round(math.dist(*self.vertices), 9)}
        return {"vertices": [[*vertex] for vertex in self.vertices]}


def read_shape(kind: Kind, value: Any, place: int = 0) -> Shape | None:
    """Read a value of a case file as a shape of a kind; None where it has another form, or is wrong."""
    try:
        vertices = _read_vertices(kind.form, value)
    except (TypeError, ValueError, KeyError, OverflowError):
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


def find_keys(keys: tuple[str, ...], data: Mapping[str, Any]) -> tuple[str, ...]:
    """Find where a case holds what others have in [mesh.structured]: in [mesh.unstructured] where it has that."""
    mesh = data.get(MESH[0])
    is_by_gmsh = keys[:2] == MESH and isinstance(mesh, Mapping) and BY_GMSH[1] in mesh
    return BY_GMSH + keys[2:] if is_by_gmsh else keys


def _list_values(kind: Kind, data: Any) -> list[tuple[int, Any]]:
    """Values of a kind's key with their places in its list."""
    for step, key in enumerate(find_keys(kind.keys, data)):
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


def find_place(text: str, kind: Kind) -> int:
    """Find the place of the next shape of a kind: after the last one, or in the first near field without a window."""
    taken = [place for place, _ in _list_values(kind, tomlkit.parse(text).unwrap())]
    return next(place for place in range(len(taken) + 1) if place not in taken) if kind.several else 0


def set_shape(text: str, shape: Shape) -> str:
    """Write a shape to its place: over the one that is there, or after the last one."""
    document = _parse(text)
    holder, key, value = _find_holder(document, shape), shape.kind.keys[-1], shape.describe()
    if not shape.kind.is_in_list:
        _set(holder, key, value)
        return _write(document)
    if key not in holder and shape.kind.keys == LINES:
        document.add(tomlkit.nl())
        document.add(key, tomlkit.aot())
    elif key not in holder or holder[key] == DETECT:
        _set(holder, key, [])
    if not isinstance(holder[key], list):
        raise InputError(f"{key}: is no list in this text; correct it there")
    if isinstance(holder[key], items.AoT) and not isinstance(value, dict):
        raise InputError(f"{key}: sections hold no rectangle; draw a polygon, or write {key} = [...] in the text")
    _set_in_list(holder[key], shape.place, value)
    return _write(document)


def remove_shape(text: str, shape: Shape) -> str:
    """Take a shape out of the text, and what it leaves empty."""
    document = _parse(text)
    holder, key = _find_holder(document, shape), shape.kind.keys[-1]
    if not shape.kind.is_in_list or len(holder[key]) == 1:
        return _remove_key(document, holder, key)
    if isinstance(holder[key], items.AoT):
        return _cut_section(document, holder[key][shape.place])
    del holder[key][shape.place]
    return _write(document)


def set_value(text: str, keys: tuple[str, ...], value: float | str | list[str] | None) -> str:
    """Set a key of a section, or take it out where it is None, and the section that it leaves empty."""
    document = _parse(text)
    section = _find_section(document, find_keys(keys, document)[:-1])
    if value is None:
        return _remove_key(document, section, keys[-1])
    _set(section, keys[-1], value)
    return _write(document)


MESH_HEADER = re.compile(r"^(\s*\[{1,2}\s*mesh\s*\.\s*)(?:un)?structured\b", re.MULTILINE)


def set_mesh(text: str, name: str) -> str:
    """Have the region meshed by ``structured`` or ``unstructured`` cells: the headers of its sections change alone."""
    changed = MESH_HEADER.sub(rf"\g<1>{name}", text)
    mesh = tomlkit.parse(changed).get(MESH[0])
    if not isinstance(mesh, dict) or list(mesh) != [name]:
        raise InputError("mesh: no section [mesh.structured] or [mesh.unstructured] alone describes it in this text; "
                         "correct it there")
    return changed


def _parse(text: str) -> Any:
    return tomlkit.parse(text if text.endswith("\n") else text + "\n")


def _write(document: Any) -> str:
    return str(tomlkit.dumps(document))


def _remove_key(document: Any, section: Any, key: str) -> str:
    if isinstance(section[key], items.AoT):
        return _cut_section(document, section[key][0])
    del section[key]
    return _cut_section(document, section) if isinstance(section, items.Table) and not section else _write(document)


MARK = "#\0"
"""A comment that no text can have."""


def _cut_section(document: Any, section: items.Table) -> str:
    """The text without a section; comments in it stay, for the last are often of the next one."""
    comments = "".join(item.as_string() for key, item in section.value.body if key is None)
    section.trivia.comment = MARK
    text = _write(document)
    if MARK not in text:
        # Of dotted keys, which have no header.
        return text
    begin = text.rfind("\n", 0, text.index(MARK)) + 1
    end = text.index("\n", begin) + 1 + len(section.as_string())
    return text[:begin] + comments + text[end:]


def _find_holder(document: Any, shape: Shape) -> Any:
    """The section that holds the key of a shape."""
    if shape.kind.keys != NEAR:
        return _find_section(document, find_keys(shape.kind.keys, document)[:-1])
    sections = document.get(NEAR[0], [])
    if not isinstance(sections, list) or shape.place >= len(sections):
        raise InputError(f"near field {shape.place + 1}: there is no such [[near]] section; write it with its images "
                         "and mapping first")
    return sections[shape.place]


def _find_section(document: Any, keys: tuple[str, ...]) -> Any:
    """A section of the document, made at its end where it is not there."""
    section = document
    for key in keys:
        if key not in section:
            if section is document:
                document.add(tomlkit.nl())
            section[key] = tomlkit.table()
        section = section[key]
        if not isinstance(section, dict):
            raise InputError(f"{'.'.join(keys)}: is no section in this text; correct it there")
    return section


def _set(holder: Any, key: Any, value: Any) -> None:
    """Set a key of a section, or an item of a list; what is the same already stays as it was written."""
    if isinstance(holder, dict) and key not in holder:
        _append(holder, key, value)
        return
    old = holder[key]
    if isinstance(value, dict) and isinstance(old, dict) and value.keys() <= old.keys():
        for name, inner in value.items():
            _set(old, name, inner)
    elif isinstance(value, list) and isinstance(old, items.Array):
        while len(old) > len(value):
            del old[-1]
        for place, inner in enumerate(value):
            _set_in_list(old, place, inner)
    elif old != value or isinstance(old, bool):
        item = tomlkit.item(_convert(value))
        if isinstance(old, items.Item):
            item.trivia.comment_ws, item.trivia.comment = old.trivia.comment_ws, old.trivia.comment
        holder[key] = item


def _append(section: Any, key: str, value: Any) -> None:
    """Add a key behind the last one: the comments at the end of a section are often those of the next one."""
    last: list[Any] = []
    if isinstance(section, items.Table):
        body = section.value.body
        while body and body[-1][0] is None:
            last.insert(0, body.pop())
    section[key] = _convert(value)
    if last:
        section.value.body.extend(last)


def _set_in_list(values: Any, place: int, value: Any) -> None:
    """Set an item of a list, or add it at its end."""
    if place < len(values):
        _set(values, place, value)
    elif isinstance(values, items.AoT):
        made = tomlkit.table()
        for name, inner in value.items():
            made.add(name, _convert(inner))
        values.append(made)
    else:
        values.append(_convert(value))
        text = values.as_string()
        if len(text) > LONGEST_LINE and "\n" not in text:
            values.multiline(True)


MOST_WHOLE = 1e15
"""Below it whole numbers are written as such: 16 and not 16.0."""


def _convert(value: Any) -> Any:
    """A value as a person writes it."""
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        table.update({key: _convert(item) for key, item in value.items()})
        return table
    if isinstance(value, list):
        array = tomlkit.array()
        array.extend(_convert(item) for item in value)
        return array
    is_whole = not isinstance(value, str) and float(value).is_integer() and abs(value) < MOST_WHOLE
    return int(value) if is_whole else value
