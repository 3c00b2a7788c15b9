"""Shapes of a case in place of a mask image: what is left out is the same to the pixel, and so are the fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from pydantic import TypeAdapter

import ddic
from ddic.case.loader import load_case
from ddic.case.schema import Shapes
from ddic.check.case import load_checked_case
from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.window import Window
from ddic.inputs.masks import draw_mask
from ddic.io.result_schema import Verdict
from ddic.mesh.plane import is_inside_edges
from ddic.parallel.team import Team
from support.cases import write_case, write_images

IMAGE = Window.of_size(60, 50)


def draw(shapes: list[Any], window: Window = IMAGE, below: ArraySource | None = None) -> np.ndarray:
    """What is left out, 1, of a window of an image of 60 x 50 px."""
    mask = draw_mask(TypeAdapter(Shapes).validate_python(shapes), IMAGE, "images.masked", below)
    assert mask is not None
    return 1 - mask.read(window)


def test_a_box_holds_the_pixels_of_a_cell() -> None:
    """Its left and upper sides are its own, as x_left <= x < x_right of a cell."""
    expected = np.zeros((50, 60), np.uint8)
    expected[10:20, 5:30] = 1
    assert np.array_equal(draw([[5, 10, 30, 20]]), expected)
    assert np.array_equal(draw([[4.01, 9.5, 29.01, 19.5]]), expected)
    assert np.array_equal(draw([{"vertices": [[5, 10], [5, 20], [30, 20], [30, 10]]}]), expected)


def test_a_circle_holds_the_centres_inside() -> None:
    """Of radius 5 about a pixel: of 81 centres 12 are on it, and those are not inside."""
    drawn = draw([{"center": [30, 25], "radius": 5}])
    rows, columns = np.indices(drawn.shape)
    assert np.array_equal(drawn == 1, (columns - 30) ** 2 + (rows - 25) ** 2 < 25)
    assert drawn.sum() == 69


def test_polygons_beside_an_even_odd_rule_of_another_make() -> None:
    """Vertices off the pixels' centres, out of the image too: no centre lies on a side."""
    draws = np.random.default_rng(3)
    rows, columns = np.indices((50, 60))
    points = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    for _ in range(20):
        angles = 2 * np.pi * (np.arange(7) + draws.uniform(0, 1, 7)) / 7
        radii = draws.uniform(5, 40, 7)
        vertices = [30, 25] + radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        sides = np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)
        inside = is_inside_edges(points, sides).reshape(50, 60)
        assert np.array_equal(draw([{"vertices": vertices.tolist()}]) == 1, inside)


def test_windows_are_parts_of_the_whole_and_another_mask_holds_too() -> None:
    shapes = [[5, 10, 30, 20], {"center": [40, 30], "radius": 8.5}, {"vertices": [[3, 48], [20, 22.5], [70, 60]]}]
    whole = draw(shapes)
    painted = np.random.default_rng(1).integers(0, 2, (50, 60)).astype(np.uint8)
    both = draw(shapes, below=ArraySource(Path("mask"), painted))
    assert np.array_equal(both, whole | (painted == 0))
    for window in (Window((0, 0), (1, 1)), Window((17, 11), (44, 33)), Window((59, 0), (60, 50))):
        assert np.array_equal(draw(shapes, window), whole[window.y0:window.y1, window.x0:window.x1])


MASKED = """masked = [
    [150, 20, 180.5, 170],
    { center = [60, 60], radius = 14.5 },
    { vertices = [[90, 110], [130, 105], [110, 140]] },
]
"""


SOLVER = '[solver]\nmethod = "conjugate_gradient"\n'


@pytest.mark.parallel([1, 2])
def test_fields_are_those_of_a_painted_mask(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    folders = {"masked.": MASKED, "painted.": 'reference_mask = "m.tif"\n'}
    if team.is_root:
        write_images(shared_path)
        # MUMPS, which "auto" would take, rounds otherwise in any two runs on several ranks.
        text = write_case(shared_path, SOLVER, images=MASKED).read_text(encoding="utf-8")
        shapes = load_case(shared_path / "case.toml").case.images.masked
        mask = draw_mask(shapes, Window.of_size(192, 192), "masked")
        assert mask is not None
        tifffile.imwrite(shared_path / "m.tif", mask.read(mask.extent))
        for name, keys in folders.items():
            (shared_path / f"{name}toml").write_text(
                text.replace(MASKED, keys) + f'[output]\nfile = "{name}vtkhdf"\n', encoding="utf-8")
    team.wait_for_all()
    one, other = (ddic.measure(shared_path / f"{name}toml") for name in folders)
    assert np.array_equal(one.displacement, other.displacement, equal_nan=True)
    assert np.array_equal(one.cell_data["residual_n_pixels"], other.cell_data["residual_n_pixels"])
    assert one.cell_data["residual_n_pixels"].sum() < 144 * 144 - 18 * 144
    # No other reason to look than that more than a tenth of the cells is masked.
    is_masked = one.cell_data["excluded"] == 5
    assert is_masked.any()
    assert np.array_equal(one.cell_data["excluded"] != 0, is_masked)
    assert one.verdict is not None
    assert [reason.partition(" cells ")[2][:42] for reason in one.verdict.reasons] == [
        "hold no pixel of the reference image that "]


@pytest.mark.parametrize("more", ["", '[correlation]\nspoilt_pixels = "keep"\n', "[pgd]\n"])
def test_masked_cells_are_marked_by_every_method(tmp_path: Path, more: str) -> None:
    write_images(tmp_path)
    result = ddic.measure(write_case(tmp_path, more, images="masked = [[40, 40, 72, 72]]\n"))
    is_masked = result.cell_data["residual_n_pixels"] == 0
    assert is_masked.any()
    assert np.array_equal(result.cell_data["excluded"], np.where(is_masked, 5, 0))
    assert result.verdict == Verdict("trust")


def test_python_takes_the_key_of_a_case(tmp_path: Path) -> None:
    """On arrays, and beside the mask of an image: nan under a shape counts as little as anything else there."""
    write_images(tmp_path)
    shapes = [[150, 20, 180.5, 170], {"center": [60, 60], "radius": 14.5}]
    by_case = ddic.measure(write_case(tmp_path, images=f"masked = {str(shapes).replace(':', '=')}".replace("'", "")))
    reference = tifffile.imread(tmp_path / "f.tif").astype(np.float32)
    reference[30:160, 152:180] = np.nan
    mesh = {"structured": {"region": [24, 24, 168, 168], "element_size": 16}}
    images = {"masked": shapes}
    used = np.ones(reference.shape, bool)
    used[46:75, 60] = False
    by_arrays = ddic.measure((ddic.Image(reference, used), tmp_path / "g.tif"), images=images, mesh=mesh)
    assert np.array_equal(by_arrays.displacement, by_case.displacement, equal_nan=True)


WRONG = {
    "[{ vertices = [[10, 10], [90, 90], [90, 10], [10, 90]] }]": "masked[0]: the polygon crosses or touches itself",
    "[[10, 10, 20, 20], [30, 10, 20, 20]]": "masked[1] = [30.0, 10.0, 20.0, 20.0]: expected x0 < x1 and y0 < y1",
    "[{ center = [300, 50], radius = 20 }]": "masked[0]: holds no pixel of the image of 192 x 192 px; move it",
    "[{ center = [50.5, 50.5], radius = 0.4 }]": "masked[0]: holds no pixel of the image",
    "[[1e300, 1e300, 1e301, 1e301]]": "masked[0]: holds no pixel of the image",
    "[[-1e308, -1e308, 1e308, 1e308]]": "masked: the mask leaves 0 px of",
    "[{ center = [96, 96], radius = 1e300 }]": "masked: the mask leaves 0 px of",
    "[[0, 0, 192, 191]]": "images.exclude_saturated: 0 px of the mesh are left to measure by",
    "[{ center = [10, 10] }]": "masked[0]: give either the vertices of a polygon, or center and radius of a circle",
    "[[1, 2, 3]]": "masked[0] = [1, 2, 3]: expected at least 4 items",
    "[3]": "masked[0] = 3: expected a list in square brackets",
}


@pytest.mark.parametrize("value", WRONG, ids=str)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_cannot_be_is_told_in_one_line(value: str, tmp_path: Path) -> None:
    write_images(tmp_path)
    path = write_case(tmp_path, images=f"masked = {value}")
    with pytest.raises(InputError) as caught:
        load_checked_case(path, 1)
    (line,) = caught.value.problems
    assert line.startswith(f"{path}: images.")
    assert WRONG[value] in line


def test_a_near_image_is_named_by_its_place(tmp_path: Path) -> None:
    write_images(tmp_path)
    near = ('[[near]]\nreference = "f.tif"\ndeformed = "g.tif"\nratio = 1.0\noffset = [0, 0]\n'
            "masked = [[200, 10, 210, 20]]\n")
    with pytest.raises(InputError, match=r"case\.toml: near\[0\]\.masked\[0\]: holds no pixel of the image"):
        load_checked_case(write_case(tmp_path, near), 1)
