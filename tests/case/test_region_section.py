"""What a case file says of the region that is meshed."""

from __future__ import annotations

from pathlib import Path

import pytest

from ddic.case.loader import load_case
from ddic.case.schema import ShapeSection
from ddic.errors import InputError

IMAGES = '[images]\nreference = "f.tif"\ndeformed = "g.tif"\n'
KINDS = pytest.mark.parametrize("kind", ["structured", "unstructured"])


def write(folder: Path, kind: str, region: str) -> Path:
    path = folder / "case.toml"
    path.write_text(f"{IMAGES}[mesh.{kind}]\nelement_size = 10\n{region}\n")
    return path


def problems(path: Path) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_case(path)
    return [line.removeprefix(f"{path}: ") for line in caught.value.problems]


@KINDS
@pytest.mark.parametrize(("text", "box"), [
    ("region = [10, 20, 90, 70.5]", (10, 20, 90, 70.5)),
    ("region = { center = [50, 40], radius = 30 }", (20, 10, 80, 70)),
    ("region = { vertices = [[10, 60], [50, 5], [90, 70]] }", (10, 5, 90, 70)),
    ("[mesh.KIND.region]\nvertices = [[10, 60], [50, 5], [90, 70]]", (10, 5, 90, 70)),
])
def test_all_forms(tmp_path: Path, kind: str, text: str, box: tuple[float, ...]) -> None:
    section = load_case(write(tmp_path, kind, text.replace("KIND", kind))).case.mesh.meshed
    assert section is not None
    assert section.box == box
    assert isinstance(section.region, ShapeSection) == ("vertices" in text or "center" in text)
    assert section.cell == ("Q4" if kind == "structured" else "T3")


@KINDS
@pytest.mark.parametrize(("text", "line"), [
    ("", "region: this key is missing; it has no default"),
    ("region = 4", "region = 4: expected a list in square brackets"),
    ("region = [1, 2, 3]", "region = [1, 2, 3]: expected at least 4 items"),
    ("region = { centre = [50, 40], radius = 30 }", 'region.centre: unknown key; did you mean "center"?'),
    ("region = { vertices = [[1, 2], [90, 4]] }", "region.vertices = [[1, 2], [90, 4]]: expected at least 3 items"),
    ("region = { vertices = [[1, 2], [90, 4], [nan, 8]] }",
     "region.vertices[2][0] = nan: expected a finite number"),
    ("region = { center = [50, 40], radius = 0 }", "region.radius = 0: expected more than 0"),
    ("region = { center = [50, 40] }",
     "region: give either the vertices of a polygon, or center and radius of a circle"),
    ("region = {}", "region: give either the vertices of a polygon, or center and radius of a circle"),
    ("region = { center = [50, 40], radius = 30, vertices = [[1, 2], [90, 4], [5, 8]] }",
     "region: give either the vertices of a polygon, or center and radius of a circle"),
])
def test_one_clear_line(tmp_path: Path, kind: str, text: str, line: str) -> None:
    assert problems(write(tmp_path, kind, text)) == [f"mesh.{kind}.{line}"]


@KINDS
def test_a_region_holds_an_element(tmp_path: Path, kind: str) -> None:
    found = problems(write(tmp_path, kind, "region = { center = [50, 40], radius = 4 }"))
    assert found == [f"mesh.{kind}: region must hold at least one element of element_size: its box is 8 x 8 px; "
                     "give the lesser corner first, [x0, y0, ...], or smaller elements"]


def test_one_mesh_only(tmp_path: Path) -> None:
    both = "region = [10, 20, 90, 70]\n[mesh.unstructured]\nregion = [10, 20, 90, 70]\nelement_size = 10"
    expected = ["mesh: give one of mesh.file, [mesh.structured] and [mesh.unstructured]"]
    assert problems(write(tmp_path, "structured", both)) == expected
    (tmp_path / "case.toml").write_text(f"{IMAGES}[mesh]\nmapping = {{ scale = 2 }}\n")
    assert problems(tmp_path / "case.toml") == expected


def test_masks_are_for_structured_meshes(tmp_path: Path) -> None:
    (line,) = problems(write(tmp_path, "unstructured", 'region = [10, 20, 90, 70]\nmask = "m.png"'))
    assert line == ("mesh.unstructured.mask: unknown key; it belongs to [volumes] or [near.mesh.structured] or "
                    "[mesh.structured]")
