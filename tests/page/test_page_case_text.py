"""The text of a case, changed in one place at a time: values, comments and lines."""

from __future__ import annotations

import math
import re
import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.case.loader import load_case_text
from ddic.check.pattern import Pattern
from ddic.check.starter import write_starter_case
from ddic.errors import InputError
from ddic.page.case_text import (
    BY_NAME,
    FEWEST,
    KINDS,
    LINES,
    MESH,
    NEAR,
    Kind,
    Point,
    Shape,
    find_place,
    list_shapes,
    read_shape,
    remove_shape,
    set_mesh,
    set_shape,
    set_value,
)

ROOT = Path(__file__).parents[2]
HOLE, POLYGON = BY_NAME["hole: circle"], BY_NAME["hole: polygon"]
LINE, BOX = BY_NAME["line: crack, shear band"], BY_NAME["edge not controlled: box"]
WINDOW, REGION = BY_NAME["near field: window"], BY_NAME["region: rectangle"]
WAVELENGTH = ("regularization", "cut_off_wavelength")
SIZE = (*MESH, "element_size")


def starter(folder: Path = Path()) -> str:
    flat = np.ones((4, 4), dtype=bool)
    return write_starter_case(folder / "case.toml", folder / "f.tif", [], Pattern(flat, flat.astype(float), 4.0),
                              (10, 10, 90, 70))


COMMENTED = """\
# keep: of the file
title = "a [strange] # title"   # keep: title
discontinuity = "detect"  # of the line

# keep: images
[images]  # keep: header
reference = "f.tif"
deformed = [  # keep
    "g_1.tif",  # keep
    # keep: alone
    "g_2.tif",
]

[mesh.structured]  # keep: pixels
region = [  # of the region
    10.0,   # of x0
    12,
    90, 70.5,
]
element_size = 16  # of the size
circles = [
    # of the first
    { center = [30, 40], radius = 5.50 },  # of a
    { center = [50, 40], radius = 6 },     # of b
    # of the last
]
polygons = [{ vertices = [[1, 2], [3, 4],
                          [5, 2]] }]  # of polygons
# keep: after the mesh

[regularization] # keep: mechanics
cut_off_wavelength = 80  # of the wavelength
not_controlled = []
# keep: after
"""

SECTIONS = """\
[images]
reference = "f.tif"
deformed = "g.tif"
[mesh]
[mesh.structured]
region = [ 10, 12, 90, 70 ]
element_size = 8
[[mesh.structured.circles]]
# keep: of the first
center = [30, 40]
radius = 5
[[mesh.structured.circles]]
center = [50, 40]
radius = 6
# keep: of the next section
[[near]] # keep: one
reference = "n.tif"
deformed = "m.tif"
ratio = 2.0
offset = [0, 0]
# keep: between
[[near]]
reference = "o.tif"
deformed = "p.tif"
ratio = 2.0
offset = [0, 0]
region = [1, 2, 30, 40]  # of the window

[[discontinuity]]
vertices = [[1, 2], [3, 4]]  # of the first
opening = "tangential"
# keep: which slides
[[discontinuity]]
vertices = [
    [5, 6],
    [7, 8],  # of a vertex
    [9, 10],
]
# keep: of the output
[output]
file = "a.vtkhdf" """

INLINE = """\
discontinuity = [{ vertices = [[1, 2], [3, 4]], opening = "normal" }]  # of lines
images = { reference = "f.tif", deformed = "g.tif" }  # keep
mesh.structured = { region = [1, 2, 30, 40], element_size = 4.0 }  # keep
regularization = { cut_off_wavelength = 30.0, boxes = [[1, 2, 3, 4], [5, 6, 7, 8]] }  # keep
"""

DOTTED = """\
mesh.structured.region = [1, 2, 30, 40] # of the region
mesh.structured.element_size = 4.0 # of the size
regularization.cut_off_wavelength = 60 # of the wavelength
images.reference = "f.tif" # keep
images.deformed = "g.tif"
"""

APART = """\
[mesh.structured]
region = [1, 2, 30, 40]
# keep: of the regularization
[regularization]
cut_off_wavelength = 60
# keep: of the rest
[mesh.mapping]
scale = 2
"""

WRITTEN = {"starter": starter(), "commented": COMMENTED, "sections": SECTIONS, "inline": INLINE, "dotted": DOTTED,
           "apart": APART, "empty": "", "line ends": COMMENTED.replace("\n", "\r\n")}
OF_DOCS = {str(path.relative_to(ROOT)) + (f" {number}" if number else ""): text
           for path in [*sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "examples").rglob("*.toml"))]
           for number, text in enumerate(re.findall(r"```toml\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
                                         if path.suffix == ".md" else [path.read_text(encoding="utf-8")])}
TEXTS = WRITTEN | OF_DOCS


def prune(value: Any) -> Any:
    """Without sections that hold nothing."""
    if not isinstance(value, dict):
        return value
    inner = {key: prune(item) for key, item in value.items()}
    return {key: item for key, item in inner.items() if item != {}}


def expect_shape(data: dict[str, Any], shape: Shape) -> None:
    """What a text means once a shape is set, by plain lists and dictionaries."""
    value: Any = shape.describe()
    keys = shape.kind.keys
    if keys == NEAR:
        data["near"][shape.place]["region"] = value
        return
    for key in keys[:-1]:
        data = data.setdefault(key, {})
    if not shape.kind.several:
        data[keys[-1]] = value
        return
    if data.get(keys[-1]) == "detect":
        del data[keys[-1]]
    items = data.setdefault(keys[-1], [])
    if shape.place == len(items):
        items.append(value)
    elif keys == LINES:
        items[shape.place]["vertices"] = value["vertices"]
    else:
        items[shape.place] = value


def expect_removed(data: dict[str, Any], shape: Shape) -> None:
    keys = shape.kind.keys
    if keys == NEAR:
        del data["near"][shape.place]["region"]
        return
    for key in keys[:-1]:
        data = data[key]
    if shape.kind.several:
        del data[keys[-1]][shape.place]
    if not shape.kind.several or not data[keys[-1]]:
        del data[keys[-1]]


def find_comments(text: str, word: str) -> list[str]:
    return sorted(re.findall(rf"# {word}.*", text.replace("\r", "")))


numbers = st.one_of(st.integers(-50, 5000).map(float), st.floats(-50, 5000).map(lambda x: round(x, 3)))
points = st.tuples(numbers, numbers)


@st.composite
def shapes(draw: st.DrawFn, kind: Kind, place: int) -> Shape:
    fewest = FEWEST[kind.form]
    most = fewest if kind.form in ("box", "circle") else fewest + 3
    vertices = draw(st.lists(points, min_size=fewest, max_size=most))
    if kind.form == "box":
        (x0, y0), (x1, y1) = vertices
        vertices = [(min(x0, x1), min(y0, y1)), (max(x0, x1), max(y0, y1))]
    if kind.form == "circle":
        radius = draw(st.floats(0.001, 500).map(lambda r: round(r, 3)))
        vertices[1] = (vertices[0][0] + radius, vertices[0][1])
    return Shape(kind, tuple(vertices), place)


def same(shape: Shape, other: Shape) -> bool:
    """The same but for the rounding of a point on a rim."""
    return (shape.kind, shape.place) == (other.kind, other.place) and np.allclose(shape.vertices, other.vertices,
                                                                                 rtol=0, atol=1e-9)


@given(data=st.data(), name=st.sampled_from(sorted(TEXTS)))
@settings(max_examples=150)
def test_any_sequence_of_changes_says_what_was_drawn(data: st.DataObject, name: str) -> None:
    """Text by text, the file means what a plain dictionary means that was changed alike; comments stay."""
    text = TEXTS[name]
    expected = tomllib.loads(text)
    kept = find_comments(text, "keep")
    for _ in range(data.draw(st.integers(1, 6), label="changes")):
        drawn = [shape for shape in list_shapes(tomllib.loads(text)) if shape.kind.name[:8] != "region: "
                 or shape.kind is REGION]
        before = deepcopy(expected)
        way = data.draw(st.sampled_from(["new", "set", "remove", "number"]), label="change")
        if way == "new":
            kind = data.draw(st.sampled_from(KINDS), label="kind")
            place = find_place(text, kind)
            if kind is WINDOW and place >= len(expected.get("near", [])):
                with pytest.raises(InputError, match=rf"near field {place + 1}: there is no such \[\[near\]\] section"):
                    set_shape(text, Shape(kind, ((1.0, 2.0), (3.0, 4.0)), place))
                continue
            shape = data.draw(shapes(kind, place), label="shape")
            text = set_shape(text, shape)
            expect_shape(expected, shape)
            assert any(same(shape, read) for read in list_shapes(tomllib.loads(text)) if read.kind is kind)
        elif way == "set" and drawn:
            old = data.draw(st.sampled_from(drawn), label="old")
            shape = data.draw(shapes(old.kind, old.place), label="shape")
            text = set_shape(text, shape)
            expect_shape(expected, shape)
        elif way == "remove" and drawn:
            shape = data.draw(st.sampled_from(drawn), label="shape")
            text = remove_shape(text, shape)
            expect_removed(expected, shape)
        elif way == "number":
            keys = data.draw(st.sampled_from([WAVELENGTH, SIZE]), label="keys")
            value = data.draw(st.one_of(st.none(), numbers), label="value")
            section: Any = expected
            for key in keys[:-1]:
                section = section.setdefault(key, {})
            if value is None and keys[-1] not in section:
                expected = before
                continue
            text = set_value(text, keys, value)
            if value is None:
                del section[keys[-1]]
            else:
                section[keys[-1]] = value
        assert prune(tomllib.loads(text)) == prune(expected)
        assert find_comments(text, "keep") == kept


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_nothing_changes_where_the_same_is_set(name: str) -> None:
    """All shapes of a text are set as they are: not a character changes, nor where numbers are written as 5.50."""
    text = TEXTS[name]
    if not text.endswith("\n"):
        text += "\n"
    for shape in list_shapes(tomllib.loads(text)):
        assert set_shape(text, shape) == text
    for keys in (WAVELENGTH, SIZE):
        section: Any = tomllib.loads(text)
        for key in keys:
            section = section.get(key, {})
        if section != {}:
            assert set_value(text, keys, float(section)) == text


def changed_lines(old: str, new: str) -> list[tuple[str, str]]:
    assert old.count("\n") == new.count("\n")
    return [(one, other) for one, other in zip(old.split("\n"), new.split("\n"), strict=True) if one != other]


@pytest.mark.parametrize(("change", "old", "new"), [
    (lambda text: set_value(text, SIZE, 12.0), "element_size = 16  # of the size", "element_size = 12  # of the size"),
    (lambda text: set_value(text, WAVELENGTH, 62.5), "cut_off_wavelength = 80  # of the wavelength",
     "cut_off_wavelength = 62.5  # of the wavelength"),
    (lambda text: set_shape(text, Shape(REGION, ((11.0, 12.0), (90.0, 70.5)))), "    10.0,   # of x0",
     "    11,   # of x0"),
    (lambda text: set_shape(text, Shape(HOLE, ((30.0, 41.0), (35.5, 41.0)), 0)),
     "    { center = [30, 40], radius = 5.50 },  # of a", "    { center = [30, 41], radius = 5.50 },  # of a"),
    (lambda text: set_shape(text, Shape(POLYGON, ((1.0, 2.0), (3.0, 4.25), (5.0, 2.0)), 0)),
     "polygons = [{ vertices = [[1, 2], [3, 4],", "polygons = [{ vertices = [[1, 2], [3, 4.25],"),
])
def test_a_number_changes_its_line_alone(change: Any, old: str, new: str) -> None:
    assert changed_lines(COMMENTED, change(COMMENTED)) == [(old, new)]


def test_what_is_added_stands_where_a_person_would_write_it() -> None:
    """Behind the last key of its section, before the comments there; new sections at the end."""
    text = starter()
    text = set_shape(text, Shape(HOLE, ((50.0, 40.0), (65.5, 40.0)), find_place(text, HOLE)))
    text = set_shape(text, Shape(HOLE, ((20.5, 40.0), (30.5, 40.0)), find_place(text, HOLE)))
    text = set_value(text, WAVELENGTH, 80.0)
    text = set_shape(text, Shape(BOX, ((10.0, 10.0), (12.0, 70.0)), find_place(text, BOX)))
    text = set_shape(text, Shape(LINE, ((0.0, 30.0), (50.0, 35.0)), find_place(text, LINE)))
    new = [line for line in text.split("\n") if line not in starter().split("\n")]
    assert new == ["circles = [{center = [50, 40], radius = 15.5}, {center = [20.5, 40], radius = 10}]",
                   "[regularization]", "cut_off_wavelength = 80", "boxes = [[10, 10, 12, 70]]",
                   "[[discontinuity]]", "vertices = [[0, 30], [50, 35]]"]
    lines = text.split("\n")
    assert lines[lines.index(new[0]) - 1].startswith("element_size = ")
    assert lines[lines.index("[regularization]") - 1] == ""


@pytest.mark.parametrize(("text", "changed"), [
    ("[mesh.structured] # a\nregion = [1]\n[[mesh.structured.circles]]\nradius = 1\n",
     "[mesh.unstructured] # a\nregion = [1]\n[[mesh.unstructured.circles]]\nradius = 1\n"),
    ("title = '[mesh.structured]'\n[mesh]\n  [ mesh . structured ]\ncell = 'T3'\n",
     "title = '[mesh.structured]'\n[mesh]\n  [ mesh . unstructured ]\ncell = 'T3'\n"),
])
def test_another_maker_of_the_mesh_changes_headers_alone(text: str, changed: str) -> None:
    assert set_mesh(text, "unstructured") == changed
    assert set_mesh(changed, "structured") == text


@pytest.mark.parametrize("text", [
    "mesh = 3\n", "title = 'a'\n", "[mesh]\nfile = 'm.msh'\n", "[mesh]\nstructured = { region = [1] }\n",
    "[mesh.structured]\ncell = 'T3'\n[mesh.mapping]\nscale = 2\n"])
def test_a_mesh_of_another_make_is_left_to_its_author(text: str) -> None:
    with pytest.raises(InputError, match=r"mesh: no section \[mesh\.structured\] or"):
        set_mesh(text, "unstructured")


def test_sections_of_masks_hold_no_rectangle() -> None:
    text = "[[images.masked]]\ncenter = [1, 2]\nradius = 3\n"
    circle, box = BY_NAME["mask: circle"], BY_NAME["mask: rectangle"]
    assert set_shape(text, Shape(circle, ((1.0, 2.0), (5.0, 2.0)))) == text.replace("3", "4")
    with pytest.raises(InputError, match="masked: sections hold no rectangle; draw a polygon"):
        set_shape(text, Shape(box, ((1.0, 2.0), (5.0, 6.0)), find_place(text, box)))


def test_long_lists_stand_on_lines_of_their_own() -> None:
    text = starter()
    for number in range(4):
        text = set_shape(text, Shape(HOLE, ((10.0 * number, 40.0), (10.0 * number + 2.5, 40.0)), number))
    items = [f"    {{center = [{10 * number}, 40], radius = 2.5}}," for number in range(4)]
    assert text[text.index("circles = [\n"):].split("\n")[1:6] == [*items, "]"]


def test_the_last_one_leaves_nothing_empty() -> None:
    """What is drawn first and removed again leaves the text as it was, but for an empty line before a section."""
    for kind, vertices in ((HOLE, ((50.0, 40.0), (60.0, 40.0))), (POLYGON, ((1.0, 2.0), (3.0, 4.0), (5.0, 2.0))),
                           (LINE, ((0.0, 30.0), (50.0, 35.0))), (BOX, ((0.0, 0.0), (5.0, 5.0)))):
        shape = Shape(kind, vertices)
        removed = remove_shape(set_shape(starter(), shape), shape)
        assert removed.rstrip("\n") == starter().rstrip("\n")
    without = set_value(set_value(starter(), WAVELENGTH, 80.0), WAVELENGTH, None)
    assert without.rstrip("\n") == starter().rstrip("\n")
    load_case_text(without, Path("case.toml"))


def test_a_section_goes_and_the_comments_of_the_next_one_stay() -> None:
    first = read_shape(LINE, {"vertices": [[1, 2], [3, 4]]}, 0)
    assert first is not None
    text = remove_shape(SECTIONS, first)
    assert tomllib.loads(text)["discontinuity"] == [{"vertices": [[5, 6], [7, 8], [9, 10]]}]
    assert '\n# keep: which slides\n[[discontinuity]]\nvertices = [\n    [5, 6],' in text
    text = remove_shape(text, Shape(LINE, ((5.0, 6.0), (7.0, 8.0), (9.0, 10.0)), 0))
    assert "discontinuity" not in tomllib.loads(text)
    assert text.rstrip().endswith('# keep: which slides\n# keep: of the output\n[output]\nfile = "a.vtkhdf"')


def test_lines_keep_their_other_keys() -> None:
    for text in (SECTIONS, INLINE):
        new = set_shape(text, Shape(LINE, ((1.0, 2.0), (3.0, 5.5)), 0))
        before, after = tomllib.loads(text)["discontinuity"], tomllib.loads(new)["discontinuity"]
        assert after[0] == {**before[0], "vertices": [[1, 2], [3, 5.5]]}
        assert after[1:] == before[1:]


def test_windows_are_of_the_near_fields_that_have_none() -> None:
    """The second of two near fields has a window: the next one that is drawn is of the first, then there is none."""
    assert find_place(SECTIONS, WINDOW) == 0
    text = set_shape(SECTIONS, Shape(WINDOW, ((5.0, 6.0), (50.0, 60.0)), 0))
    assert [section["region"] for section in tomllib.loads(text)["near"]] == [[5, 6, 50, 60], [1, 2, 30, 40]]
    assert find_place(text, WINDOW) == 2
    with pytest.raises(InputError, match=r"near field 3: there is no such \[\[near\]\] section; write it"):
        set_shape(text, Shape(WINDOW, ((5.0, 6.0), (50.0, 60.0)), 2))


@pytest.mark.parametrize(("text", "kind", "message"), [
    ("mesh = 3\n", REGION, "mesh.structured: is no section"),
    ("[mesh]\nstructured = 3\n", HOLE, "mesh.structured: is no section"),
    ("regularization = [1, 2]\n", BOX, "regularization: is no section"),
    ("[mesh.structured]\ncircles = 3\n", HOLE, "circles: is no list"),
    ("[mesh.structured.circles]\ncenter = [1, 2]\n", HOLE, "circles: is no list"),
    ("[discontinuity]\nvertices = [[1, 2], [3, 4]]\n", LINE, "discontinuity: is no list"),
    ("near = 3\n", WINDOW, "near field 1: there is no such"),
    ("[near]\nreference = 'a'\n", WINDOW, "near field 1: there is no such"),
])
def test_a_text_of_another_make_is_not_guessed_at(text: str, kind: Kind, message: str) -> None:
    place = find_place(text, kind)
    vertices: tuple[Point, ...] = ((1.0, 2.0), (3.0, 4.0))
    with pytest.raises(InputError, match=message):
        set_shape(text, Shape(kind, vertices, place))


@pytest.mark.parametrize("value", [
    None, 3, "text", [], [1, 2, 3], [1, 2, 3, "x"], [1, 2, 3, math.nan], [1, 2, 3, math.inf], {}, {"center": [1, 2]},
    {"center": [1], "radius": 2}, {"center": 3, "radius": 2}, {"vertices": 3}, {"vertices": [[1, 2]]},
    {"vertices": [[1, 2], [3]]}, {"vertices": [[1, 2], ["a", "b"]]}, [10**400, 1, 2, 3], {"vertices": []},
    {"vertices": [[1, 2], [3, 10**400]]},
])
def test_what_cannot_be_drawn_is_passed_over(value: Any) -> None:
    for kind in KINDS:
        if kind.form != "line":
            assert read_shape(kind, value) is None
    assert read_shape(LINE, value) is None
    text: dict[str, Any] = {"mesh": {"structured": {"region": value, "circles": value, "polygons": [value]}},
                            "discontinuity": value, "near": value, "regularization": value}
    assert list_shapes(text) == []


def test_outlines() -> None:
    box = Shape(REGION, ((10.0, 20.0), (30.0, 50.0))).outline
    np.testing.assert_array_equal(box, [(10, 20), (30, 20), (30, 50), (10, 50), (10, 20)])
    circle = Shape(HOLE, ((10.0, 20.0), (13.0, 24.0))).outline
    np.testing.assert_allclose(np.linalg.norm(circle - [10.0, 20.0], axis=1), 5.0, rtol=1e-14)
    np.testing.assert_allclose(circle[0], circle[-1], atol=1e-14)
    triangle = ((1.0, 2.0), (3.0, 4.0), (5.0, 2.0))
    np.testing.assert_array_equal(Shape(POLYGON, triangle).outline, [*triangle, triangle[0]])
    np.testing.assert_array_equal(Shape(LINE, triangle).outline, triangle)
    # Corners in any order.
    assert Shape(REGION, ((30.0, 20.0), (10.0, 50.0))).describe() == [10.0, 20.0, 30.0, 50.0]
