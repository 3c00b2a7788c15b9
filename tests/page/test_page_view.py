"""The page of ddic view: colours, values under the pointer, differences, series, what leaves the page."""

from __future__ import annotations

import html
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from bokeh.models import CheckboxGroup, ColorBar, GlyphRenderer, Line, MultiLine, Plot
from click.testing import CliRunner
from numpy.typing import NDArray
from PIL import Image

import ddic
from ddic.cli.tables import probe
from ddic.errors import InputError
from ddic.page import frames as page_frames
from ddic.page.frames import FIELDS, Frames, move_back
from ddic.page.layers import HATCH, OPACITY, STROKE, list_colours
from ddic.page.view import make_view_page, open_results
from ddic.plots import canvas
from ddic.probes.probes import Probe, load_probes
from ddic.probes.tables import ProbeRecord, average_along, measure_probes, write_probe_table
from support.page_results import MESH, NOISE, Content, Motion, write_known
from support.page_tab import Jobs, Tab
from support.series_files import STRAIN, FrameFile, displace, write_series_file

ONE = Motion()
OTHER = Motion((0.5, -0.1), ((0.006, 0.001), (0.0, -0.004)))
FAR = Motion((12.0, -9.0), ((0.05, 0.0), (0.0, 0.02)))
"""Moves the mesh by more than a cell."""

PROBES = "Probes (a file for ddic probe --probes)"
MOVED, HATCHED = 0, 1
OpenView = Callable[..., Tab]
Rgb = NDArray[np.uint8]


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory, image_folder: Path) -> dict[str, Path]:
    """Results by name."""
    folder = tmp_path_factory.mktemp("results")
    images = image_folder / "f.tif", image_folder / "g.tif"
    outliers = 1.0 + np.arange(MESH.n_cells) / MESH.n_cells
    outliers[[10, 100, 200]] = 1e6
    contents = {
        "one": (ONE, Content(images)), "other": (OTHER, Content(images)), "far": (FAR, Content(images)),
        "outliers": (ONE, Content(images, residual=outliers)),
        "marked": (ONE, Content(images, excluded=(0, 1, 18, 19), doubtful=(16, 17, 1))),
        "unmeasured": (FAR, Content(images, excluded=(171, 172, 189, 190), unmeasured=(200,))),
        "bare": (ONE, Content(images, with_uncertainty=False)),
        "without_images": (ONE, Content((folder / "gone.tif", folder / "gone.tif"))),
        "broken_image": (ONE, Content((Path(__file__), images[1]))),
        "large": (ONE, Content(images, size="300x192")),
    }
    paths = {name: write_known(folder / f"{name}.vtkhdf", motion, content)
             for name, (motion, content) in contents.items()}
    times = (0.5, 1.0, 3.0)
    paths["series"] = write_series_file(folder / "series.vtkhdf", [FrameFile(time) for time in times])
    return paths


@pytest.fixture
def open_view(known: dict[str, Path], jobs: Jobs) -> OpenView:
    def open_tab(*names: str, probes: list[Probe] | None = None) -> Tab:
        return Tab(partial(make_view_page, [known[name] for name in names], probes or []), jobs)

    return open_tab


def colours_at(tab: Tab, points: NDArray[np.float64], pane: str = "field") -> NDArray[np.int64]:
    """Red, green, blue of the pixels that hold points, pixels of the image."""
    rgba, (x0, y0, x1, y1) = tab.shown(pane)
    pitch = np.array([(x1 - x0) / rgba.shape[1], (y1 - y0) / rgba.shape[0]])
    column, row = np.floor((points - [x0, y0]) / pitch).astype(int).T
    return np.asarray(rgba[row, column, :3], np.int64)


def limits_of(tab: Tab, pane: str = "field") -> tuple[float, float]:
    mapper = bar_of(tab, pane).color_mapper
    return mapper.low, mapper.high


def bar_of(tab: Tab, pane: str = "field") -> Any:
    (bar,) = [item for item in tab.find(Plot, name=pane).right if isinstance(item, ColorBar)]
    return bar


def mix(values: NDArray[np.float64], limits: tuple[float, float], grey: NDArray[np.int64],
        palette: str = "viridis") -> NDArray[np.float64]:
    """What values look like over grey levels."""
    share = np.clip((values - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)
    colours = list_colours(palette)[np.round(255 * share).astype(int)].astype(float)
    return OPACITY * colours + (1.0 - OPACITY) * grey


INSIDE = np.array([(30.2, 40.7), (96.0, 96.0), (150.5, 30.3), (100.1, 160.9), (28.0, 164.0)])


def hover(tab: Tab, x: float, y: float, pane: str = "field") -> str:
    """What is said when the browser tells of the pointer."""
    for source in tab.find(Plot, name=pane).js_event_callbacks["mousemove"]:
        source.args["source"].data = {"x": [x], "y": [y]}
    tab.settle()
    line = re.search(r"^(\w+\.vtkhdf: )?(x = |outside).*$", tab.texts(), re.MULTILINE)
    assert line
    return html.unescape(line[0])


def test_all_fields_of_a_result_are_offered(known: dict[str, Path], open_view: OpenView) -> None:
    """Those that it holds, under names that ddic plot knows."""
    assert open_view("one").widget("Field").options == [field.name for field in FIELDS]
    bare = open_view("bare").widget("Field").options
    assert bare == [field.name for field in FIELDS if field.kind not in ("sigma", "bias")]
    for name, expected in {"displacement x": ONE.displace(MESH.nodes)[:, 0], "sigma y": NOISE, "bias x": NOISE,
                           "strain xy": ONE.strain[2], "sigma yy": NOISE,
                           "displacement magnitude": np.linalg.norm(ONE.displace(MESH.nodes), axis=1)}.items():
        values = page_frames.BY_NAME[name].find_values(ddic.open(known["one"]))
        assert values is not None
        np.testing.assert_allclose(values.values, expected, atol=1e-15)


@pytest.mark.parametrize("name", ["displacement x", "displacement y", "displacement magnitude"])
def test_colours_are_those_of_the_values(open_view: OpenView, name: str) -> None:
    """Linear fields between nodes; one level of colour and one of rounding."""
    tab = open_view("one")
    tab.find(CheckboxGroup).active = []
    at_nodes = ONE.displace(MESH.nodes)
    here = ONE.displace(INSIDE)
    tab.enter("Field", name)
    axis = {"displacement x": 0, "displacement y": 1}.get(name)
    values = np.linalg.norm(at_nodes, axis=1) if axis is None else at_nodes[:, axis]
    expected = np.linalg.norm(here, axis=1) if axis is None else here[:, axis]
    limits = tuple(np.percentile(values, canvas.PERCENTILES))
    assert limits_of(tab) == pytest.approx(limits, rel=1e-12)
    tab.enter("Colours", "gray")
    shown = colours_at(tab, INSIDE)
    # In grey over grey, of which 30 % are the image's: between 0 and 76 levels more than the field's 70 %.
    of_field = 255 * OPACITY * np.clip((expected - limits[0]) / (limits[1] - limits[0]), 0, 1)
    beneath = shown[:, 0] - of_field
    # A pixel of the screen is a quarter of one of the image, along which the magnitude bends a little.
    assert beneath.min() > -3.0
    assert beneath.max() < 255 * (1 - OPACITY) + 3.0
    tab.enter("Colours", "viridis")
    grey = np.round(beneath / (1 - OPACITY))[:, None].clip(0, 255)
    # Grey levels as they were found from the other palette are off by some levels; 30 % of them count.
    np.testing.assert_allclose(colours_at(tab, INSIDE), mix(expected, limits, grey), atol=5.0)


def test_limits_are_percentiles_or_given(open_view: OpenView) -> None:
    tab = open_view("one")
    tab.enter("Field", "residual")
    values = 1.0 + np.arange(MESH.n_cells) / MESH.n_cells
    assert limits_of(tab) == pytest.approx(np.percentile(values, (2, 98)), rel=1e-12)
    tab.enter("percentiles", 10)
    tab.enter("and", 50)
    assert limits_of(tab) == pytest.approx(np.percentile(values, (10, 50)), rel=1e-12)
    for low, high in ((60, 50), (-1, 50), (10, 101), (None, 50), (50, 50)):
        tab.enter("percentiles", low)
        tab.enter("and", high)
        assert limits_of(tab) == pytest.approx(np.percentile(values, (2, 98)), rel=1e-12)
    tab.enter("from (empty: percentile)", 0.5)
    # One limit alone is none.
    assert limits_of(tab) == pytest.approx(np.percentile(values, (2, 98)), rel=1e-12)
    tab.enter("to", 3.0)
    assert limits_of(tab) == (0.5, 3.0)
    tab.enter("from (empty: percentile)", 4.0)
    assert limits_of(tab) == pytest.approx(np.percentile(values, (2, 98)), rel=1e-12)


def test_three_outliers_do_not_change_the_colours_of_the_others(open_view: OpenView) -> None:
    """Of 324 cells three are a million times as large: percentiles move by three ranks, some levels of 256."""
    centres = MESH.centroids[np.setdiff1d(np.arange(MESH.n_cells), [10, 100, 200])]
    shown = {}
    for name in ("one", "outliers"):
        tab = open_view(name)
        tab.enter("Field", "residual")
        tab.enter("Colours", "gray")
        shown[name] = colours_at(tab, centres)
    assert MESH.n_cells == 324
    assert np.abs(shown["one"] - shown["outliers"]).max() <= 3
    assert np.ptp(shown["outliers"]) > 100


def test_cells_that_say_little_are_hatched(open_view: OpenView) -> None:
    """Strokes within excluded cells (black) and doubtful ones (white), nowhere else; a cell that is both is black."""
    tab = open_view("marked")
    tab.find(CheckboxGroup).active = [HATCHED]
    rgba, box = tab.shown("field")
    tab.find(CheckboxGroup).active = []
    plain, _ = tab.shown("field")
    changed = (rgba != plain).any(axis=2)
    rows, columns = np.nonzero(changed)
    pitch = (box[2] - box[0]) / rgba.shape[1]
    places = np.column_stack([columns, rows]) * pitch + 0.5 * pitch + [box[0], box[1]]
    lowest, highest = MESH.outlines.find_boxes()
    marked = {0: 0, 1: 0, 18: 0, 19: 0, 16: 255, 17: 255}
    owner = np.full(len(places), -1)
    for cell in marked:
        owner[((places >= lowest[cell]) & (places <= highest[cell])).all(axis=1)] = cell
    assert set(owner.tolist()) == set(marked)
    for cell, level in marked.items():
        of_cell = rgba[rows[owner == cell], columns[owner == cell], :3]
        assert (of_cell == level).all()
        # A stroke of three pixels in nine, but for what the edges cut off.
        n_pixels = (8.0 / pitch)**2
        assert len(of_cell) / n_pixels == pytest.approx(STROKE / HATCH, abs=0.1)


@pytest.mark.parametrize("active", [[], [MOVED]])
def test_what_was_not_measured_has_no_colour(open_view: OpenView, active: list[int]) -> None:
    """The four cells about a node in the middle, whose displacement is not known; others have theirs."""
    tab = open_view("unmeasured")
    tab.find(CheckboxGroup).active = active
    node = MESH.nodes[200]
    assert node.tolist() == [104.0, 104.0]
    others = np.array([(92.0, 104.0), (104.0, 118.0), (30.0, 40.0)])
    seen = others + FAR.displace(others) if active else others
    assert [len(set(colour)) > 1 for colour in colours_at(tab, seen).tolist()] == [True] * 3
    if not active:
        within = node + np.array([(0.0, 0.5), (6.0, 6.0), (-6.0, 6.0), (6.0, -6.0), (-6.0, -6.0)])
        assert [len(set(colour)) for colour in colours_at(tab, within).tolist()] == [1] * 5
        assert "u_x = -, u_y = - " in hover(tab, 105.0, 106.0)
        assert "where nothing was measured" in hover(tab, 105.0, 106.0)
    values = np.linalg.norm(FAR.displace(np.delete(MESH.nodes, 200, axis=0)), axis=1)
    assert limits_of(tab) == pytest.approx(np.percentile(values, canvas.PERCENTILES), rel=1e-12)


def test_a_difference_is_the_known_one(open_view: OpenView) -> None:
    tab = open_view("one", "other")
    tab.enter("Beside it", "difference")
    tab.enter("Field", "displacement x")
    at_nodes = (ONE.displace(MESH.nodes) - OTHER.displace(MESH.nodes))[:, 0]
    # Values are written with all digits; percentiles of sums of two.
    assert limits_of(tab, "beside") == pytest.approx(np.percentile(at_nodes, canvas.PERCENTILES), rel=1e-12)
    assert bar_of(tab, "beside").title.startswith("difference of u_x")
    tab.enter("from (empty: percentile)", -0.5)
    tab.enter("to", 0.5)
    tab.enter("Colours", "gray")
    here = (ONE.displace(INSIDE) - OTHER.displace(INSIDE))[:, 0]
    left = ONE.displace(INSIDE)[:, 0]
    # The image is beneath both.
    difference = (colours_at(tab, INSIDE, "beside") - colours_at(tab, INSIDE))[:, 0]
    expected = 255 * OPACITY * (np.clip(here + 0.5, 0, 1) - np.clip(left + 0.5, 0, 1))
    np.testing.assert_allclose(difference, expected, atol=2.0)


def test_limits_of_a_difference_do_not_hang_on_what_is_in_sight(open_view: OpenView) -> None:
    tab = open_view("one", "other")
    tab.enter("Beside it", "difference")
    before = limits_of(tab, "beside")
    plot = tab.find(Plot, name="beside")
    plot.x_range.update(start=90.0, end=100.0)
    plot.y_range.update(start=100.0, end=90.0)
    tab.find(CheckboxGroup).active = [HATCHED, MOVED]
    assert limits_of(tab, "beside") == before


def test_panes_show_the_same_part(open_view: OpenView) -> None:
    tab = open_view("one", "other")
    left, right = (tab.find(Plot, name=name) for name in ("field", "beside"))
    assert left.x_range is right.x_range
    assert left.y_range is right.y_range
    left.x_range.update(start=90.0, end=110.0)
    left.y_range.update(start=110.0, end=90.0)
    tab.rest()
    assert tab.shown("field")[1] == tab.shown("beside")[1] == (89.5, 89.5, 110.5, 110.5)


def test_results_are_chosen(open_view: OpenView) -> None:
    tab = open_view("one", "other", "bare")
    assert tab.find(Plot, name="beside").visible
    tab.enter("Beside it", "(nothing)")
    assert not tab.find(Plot, name="beside").visible
    tab.enter("Field", "sigma x")
    tab.enter("Beside it", "bare.vtkhdf")
    assert bar_of(tab, "beside").title == "sigma x: not in this result"
    tab.enter("Result", "bare.vtkhdf")
    # The field that it does not have is chosen no longer.
    assert tab.widget("Field").value == "displacement magnitude"
    assert "sigma x" not in tab.widget("Field").options
    assert "bare.vtkhdf, time 2.5: trust this field" in tab.texts()
    tab.enter("Beside it", "difference")
    values = np.linalg.norm(ONE.displace(MESH.nodes), axis=1)
    assert np.abs(values).max() > 0
    # From the first of the others, which has the same field.
    assert limits_of(tab, "beside") == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_file_that_is_named_twice_is_one(open_view: OpenView) -> None:
    tab = open_view("one", "one")
    assert tab.widget("Result").options == ["one.vtkhdf"]
    assert [plot.name for plot in tab.document.models if isinstance(plot, Plot) and plot.name == "beside"] == []


def test_files_of_one_name_are_told_apart(known: dict[str, Path], tmp_path: Path, jobs: Jobs) -> None:
    copy = tmp_path / "one.vtkhdf"
    copy.write_bytes(known["one"].read_bytes())
    tab = Tab(partial(make_view_page, [known["one"], copy], []), jobs)
    assert tab.widget("Result").options == [str(known["one"]), str(copy)]


def test_results_of_images_of_different_size_are_refused(known: dict[str, Path]) -> None:
    with pytest.raises(InputError, match="of images of 192 x 192 and 300 x 192 px, which cannot be looked at"):
        open_results([known["one"], known["large"]])
    with pytest.raises(InputError, match="no such result file"):
        open_results([known["one"].with_name("absent.vtkhdf")])
    with pytest.raises(InputError):
        open_results([Path(__file__)])


# Under the pointer.


def as_probe_prints(path: Path, x: float, y: float) -> list[str]:
    """The numbers in the first row of ddic probe: u_x, u_y, its noise, the strains and theirs."""
    ran = CliRunner().invoke(probe, [str(path), "--point", f"{x},{y}"])
    assert ran.exit_code == 0
    row = next(line for line in ran.output.splitlines() if "point 1" in line and ":" not in line)
    numbers = row.split("point 1")[1].split()
    return [*numbers[:6], numbers[7]]


@pytest.mark.parametrize("name", ["one", "bare", "series"])
@pytest.mark.parametrize("point", [(30.25, 28.5), (40.0, 24.0), (49.75, 29.125)])
def test_the_pointer_reads_what_ddic_probe_prints(
        known: dict[str, Path], open_view: OpenView, name: str, point: tuple[float, float]) -> None:
    """On nodes and within cells, with standard deviations: the same digits."""
    tab = open_view(name)
    said = hover(tab, *point)
    printed = as_probe_prints(known[name], *point)
    found = re.match(r"x = (\S+), y = (\S+) px: u_x = (\S+), u_y = (\S+) ± (\S+) px; strain xx = (\S+), yy = (\S+), "
                     r"xy = (\S+) ± (\S+)(?: \((.*)\))?$", said)
    assert found, said
    assert [*found.groups()][2:9] == printed
    assert (float(found[1]), float(found[2])) == pytest.approx(point, abs=0.005)


def test_each_pane_reads_its_own_result(open_view: OpenView) -> None:
    """Of a difference it is the result that is less the other one."""
    tab = open_view("one", "other")
    for pane, name, motion in (("field", "one", ONE), ("beside", "other", OTHER)):
        u_x, u_y = motion.displace(np.array([(40.0, 50.0)]))[0]
        assert hover(tab, 40.0, 50.0, pane).startswith(
            f"{name}.vtkhdf: x = 40.00, y = 50.00 px: u_x = {u_x:.5g}, u_y = {u_y:.5g} ")
    tab.enter("Beside it", "difference")
    assert hover(tab, 40.0, 50.0, "beside").startswith("one.vtkhdf: ")


def test_beside_the_mesh_nothing_is_read(open_view: OpenView) -> None:
    assert hover(open_view("one"), 10.0, 3.0) == "x = 10.00, y = 3.00 px: outside the mesh or in a hole"


def test_the_pointer_follows_the_specimen_over_the_deformed_image(open_view: OpenView) -> None:
    """A point that is seen at x + u(x) is x: its displacement is read, and not that of another one."""
    tab = open_view("far")
    tab.find(CheckboxGroup).active = [MOVED]
    rest = np.array([(50.0, 60.0), (96.0, 96.0), (160.3, 31.7)])
    for here, there in zip(rest, rest + FAR.displace(rest), strict=True):
        said = hover(tab, *there)
        x, y, u_x, u_y = map(float, re.findall(r"= (-?[\d.]+)", said)[:4])
        # Two digits of places, five of displacements.
        assert (x, y) == pytest.approx(tuple(here), abs=0.0051)
        assert (u_x, u_y) == pytest.approx(tuple(FAR.displace(here[None])[0]), rel=1e-4)
    # Where the mesh was and is no longer.
    assert hover(tab, 25.0, 166.0) == "outside the mesh: what is seen there was not measured"
    tab.find(CheckboxGroup).active = []
    assert "x = 25.00, y = 166.00 px: u_x = " in hover(tab, 25.0, 166.0)


def test_a_field_lies_where_the_specimen_is(open_view: OpenView) -> None:
    """At rest from 24 to 168 px; over the deformed image its corners have moved with u."""
    tab = open_view("far")
    corners = np.array([(24.0, 24.0), (168.0, 24.0), (168.0, 168.0), (24.0, 168.0)])
    inward = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])

    def is_coloured(points: NDArray[np.float64]) -> list[bool]:
        return [len(set(colour)) > 1 for colour in colours_at(tab, points).tolist()]

    for moved, at in ((False, corners), (True, corners + FAR.displace(corners))):
        tab.find(CheckboxGroup).active = [MOVED] if moved else []
        assert is_coloured(at + inward) == [True] * 4
        assert is_coloured(at - inward) == [False] * 4


def test_each_field_lies_over_its_own_image(open_view: OpenView, image_folder: Path) -> None:
    """Outside the mesh the grey levels are those of the reference or of the deformed image."""
    tab = open_view("one")
    rows, columns = np.mgrid[2:20, 2:190:5]
    places = np.column_stack([columns.ravel(), rows.ravel()])
    for active, name in (([], "f.tif"), ([MOVED], "g.tif")):
        tab.find(CheckboxGroup).active = active
        image = tifffile.imread(image_folder / name)
        low, high = np.percentile(image, (0.5, 99.5))
        expected = 255 * np.clip((image[rows, columns].ravel() - low) / (high - low), 0, 1)
        np.testing.assert_allclose(colours_at(tab, places.astype(float))[:, 0], expected, atol=1.001)


def test_move_back_is_the_inverse_of_the_displacement(known: dict[str, Path]) -> None:
    result = ddic.open(known["far"])
    points = np.random.default_rng(3).uniform(24.0, 168.0, (50, 2))
    moved = points + FAR.displace(points)
    back = move_back(result, [(x, y) for x, y in moved.tolist()])
    np.testing.assert_allclose(back, points, atol=1e-11)
    with pytest.raises(InputError, match="outside the mesh"):
        move_back(result, [(25.0, 166.0)])


def test_probes_are_placed_on_the_specimen(open_view: OpenView) -> None:
    """Clicked over the deformed image they are where the point was, and are drawn where it is."""
    tab = open_view("far")
    tab.find(CheckboxGroup).active = [MOVED]
    tab.widget("Draw").value = "probe: point"
    (x, y), = np.array([(96.0, 96.0)]) + FAR.displace(np.array([(96.0, 96.0)]))
    tab.click(x, y, "field")
    assert tab.widget(PROBES).value == "[point.point_1]\npoint = [96, 96]\n"
    drawn = next(r.data_source for r in tab.find(Plot, name="field").renderers
                 if isinstance(r.glyph, MultiLine) and r.glyph.line_color == "#40e0ff")
    assert (drawn.data["x"], drawn.data["y"]) == (pytest.approx([x], abs=0.1), pytest.approx([y], abs=0.1))
    tab.find(CheckboxGroup).active = []
    assert (drawn.data["x"], drawn.data["y"]) == ([96.0], [96.0])
    tab.find(CheckboxGroup).active = [MOVED]
    tab.click(2.0, 190.0, "field")
    assert "outside the mesh: what is seen there was not measured" in tab.texts()
    assert tab.widget(PROBES).value == "[point.point_1]\npoint = [96, 96]\n"


@pytest.mark.parametrize("name", ["without_images", "broken_image"])
def test_images_that_are_gone_are_grey(open_view: OpenView, name: str) -> None:
    """Of the size that the result names, so that the field lies where it did."""
    tab = open_view(name)
    _, box = tab.shown("field")
    assert box == (-0.5, -0.5, 191.5, 191.5)
    assert set(colours_at(tab, np.array([(2.0, 2.0), (180.0, 180.0)])).ravel().tolist()) == {127}
    assert len(set(colours_at(tab, INSIDE[:1])[0].tolist())) > 1
    assert hover(tab, 96.0, 96.0).startswith("x = 96.00, y = 96.00 px: u_x = 0.4, u_y = -0.3 ")
    tab.press("PNG")
    if name == "broken_image":
        assert f"{Path(__file__)}: not an image that can be read" in tab.texts()
    else:
        assert tab.saved()[1].startswith(b"\x89PNG")


# Probes and series.


def table_of(tab: Tab) -> list[list[str]]:
    rows = re.search(r"<table cellpadding=4>(.*?)</table>", tab.texts(), re.DOTALL)
    assert rows
    return [re.findall(r"<t[hd]>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", rows[1])]


def curves(tab: Tab, name: str) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Curves of a figure by the names in its legend."""
    plot = tab.find(Plot, name=name)
    (legend,) = [item for item in plot.right if type(item).__name__ == "Legend"]
    found = {}
    for item in legend.items:
        (line,) = [r for r in item.renderers if isinstance(r, GlyphRenderer) and isinstance(r.glyph, Line)]
        found[item.label.value] = (np.asarray(line.data_source.data["x"]), np.asarray(line.data_source.data["y"]))
    return found


SERIES_PROBES = """\
[point.A]
point = [20, 20]
[line.B]
start = [12, 20]
end = [45, 25]
spacing = 3
[extensometer.C]
start = [12, 15]
end = [42, 15]
[gauge.D]
centre = [30, 20]
length = 12
"""


@pytest.fixture
def probes(tmp_path: Path) -> list[Probe]:
    path = tmp_path / "probes.toml"
    path.write_text(SERIES_PROBES, encoding="utf-8")
    return load_probes(path)


def test_frames_of_a_series_are_shown(open_view: OpenView) -> None:
    tab = open_view("series")
    slider = tab.widget("Frame")
    assert (slider.start, slider.end, slider.visible) == (1, 3, True)
    tab.enter("Field", "displacement x")
    for number, time in ((3, 3.0), (1, 0.5), (2, 1.0)):
        tab.enter("Frame", number)
        assert f"series.vtkhdf, frame {number}, time {time:g}: look before you trust this field: a place of frame " \
               f"{number}" in tab.texts()
        assert limits_of(tab)[1] == pytest.approx(0.01 * time * 50, rel=0.1)
        said = hover(tab, 30.0, 20.0)
        assert f"u_x = {displace(np.array([[30.0, 20.0]]), time)[0, 0]:.5g}," in said


def test_curves_are_what_probes_read(known: dict[str, Path], open_view: OpenView, probes: list[Probe]) -> None:
    tab = open_view("series", probes=probes)
    records = measure_probes(ddic.open_series(known["series"]), probes)
    picks: dict[str, Callable[[ProbeRecord], NDArray[np.float64]]] = {
        "u_x": lambda record: record.reading.displacement[:, 0],
        "strain yy": lambda record: record.reading.strain[:, 1], "strain along": lambda record: record.reading.along}
    for quantity, pick in picks.items():
        tab.enter("Curve of", quantity)
        shown = curves(tab, "curves")
        assert list(shown) == ["A", "B", "C", "D"]
        for name, (times, values) in shown.items():
            of_probe = [record for record in records if record.reading.probe.name == name]
            np.testing.assert_array_equal(times, [0.5, 1.0, 3.0])
            np.testing.assert_array_equal(values, [average_along(pick(record)) for record in of_probe])
    # Of an even field, along x.
    np.testing.assert_allclose(curves(tab, "curves")["C"][1], STRAIN * np.array([0.5, 1.0, 3.0]), rtol=1e-12)
    for number in (2, 3):
        tab.enter("Frame", number)
        record = next(r for r in records[4 * (number - 1):] if r.reading.probe.name == "B")
        distance, values = curves(tab, "profile")["B"]
        np.testing.assert_array_equal(distance, record.reading.distance)
        np.testing.assert_array_equal(values, record.reading.along)


def test_the_table_has_the_digits_of_ddic_probe(
        known: dict[str, Path], open_view: OpenView, probes: list[Probe]) -> None:
    tab = open_view("series", probes=probes)
    tab.enter("Frame", 3)
    head, *rows = table_of(tab)
    assert head[:4] == ["probe", "u_x", "u_y", "± σ [px]"]
    assert [row[0] for row in rows] == ["A", "B", "C", "D"]
    ran = CliRunner().invoke(probe, [str(known["series"]), "--point", "20,20", "--extensometer", "12,15,42,15"])
    *_, a, c = [line.split() for line in ran.output.splitlines() if line.strip().startswith(("0.5", "1 ", "3 "))]
    # time, "point 1", u_x, u_y, noise, xx, yy, xy, along, noise.
    assert rows[0][1:9] == a[3:11]
    assert rows[2][1:9] == c[3:11]


def test_the_table_of_the_page_is_that_of_ddic_probe(
        known: dict[str, Path], open_view: OpenView, probes: list[Probe], tmp_path: Path) -> None:
    """Byte by byte."""
    for name in ("series", "one"):
        tab = open_view(name, probes=probes)
        tab.press("CSV of the probes")
        table = tmp_path / f"{name}.csv"
        read = ddic.open_series(known[name]) if name == "series" else [ddic.open(known[name])]
        write_probe_table(table, measure_probes(read, probes))
        assert tab.saved() == (f"{name}.probes.csv", table.read_bytes())


def test_probes_are_read_once(open_view: OpenView, probes: list[Probe], monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are not read again for another frame or another curve."""
    read: list[int] = []

    def measure(results: Any, asked: list[Probe], *rest: Any) -> Any:
        read.append(len(asked))
        return measure_probes(results, asked, *rest)

    monkeypatch.setattr("ddic.page.probe_box.measure_probes", measure)
    tab = open_view("series", probes=probes[:3])
    tab.enter("Frame", 2)
    tab.enter("Curve of", "u_y")
    assert read == [3]
    tab.enter(PROBES, SERIES_PROBES)
    assert read == [3, 1]


def test_a_series_that_cannot_be_read_any_more_is_told(
        known: dict[str, Path], tmp_path: Path, jobs: Jobs, probes: list[Probe]) -> None:
    copy = tmp_path / "series.vtkhdf"
    copy.write_bytes(known["series"].read_bytes())
    tab = Tab(partial(make_view_page, [copy], []), jobs)
    copy.unlink()
    tab.enter(PROBES, SERIES_PROBES)
    assert "series.vtkhdf: no such result file" in tab.texts()


def test_probes_are_drawn_and_told_where_they_are_wrong(open_view: OpenView) -> None:
    tab = open_view("one")
    tab.widget("Draw").value = "probe: extensometer"
    tab.click(40.0, 40.0, "field")
    tab.click(100.0, 85.0, "field")
    assert tab.widget(PROBES).value == "[extensometer.extensometer_1]\nstart = [40, 40]\nend = [100, 85]\n"
    assert table_of(tab)[1][0] == "extensometer_1"
    tab.enter(PROBES, "[extensometer.E]\nstart = [1, 2]\nend = [1, 2]")
    assert "both ends are (1, 2); give two points" in tab.texts()
    tab.enter(PROBES, "")
    assert not tab.find(Plot, name="profile").visible
    assert not tab.find(Plot, name="curves").visible


def test_convergence_is_shown(open_view: OpenView) -> None:
    tab = open_view("one")
    (shown,) = {tuple(np.asarray(r.data_source.data["y"]).tolist()) for plot in tab.document.models
                if isinstance(plot, Plot) and plot.yaxis and plot.yaxis[0].axis_label == "correction [px]"
                for r in plot.renderers}
    assert shown == (0.1, 1e-4)


# What leaves the page.


@pytest.mark.parametrize("field", ["displacement x", "strain von-mises", "sigma xx", "bias y", "residual"])
@pytest.mark.parametrize("active", [[], [MOVED]])
def test_figures_are_exported(open_view: OpenView, field: str, active: list[int]) -> None:
    """PNG of 150 dots an inch, SVG and PDF, whichever image is shown."""
    tab = open_view("one")
    tab.find(CheckboxGroup).active = active
    tab.enter("Field", field)
    tab.press("PNG")
    name, content = tab.saved()
    assert name == f"one.{field.replace(' ', '_')}.png"
    with Image.open(BytesIO(content)) as image:
        image.load()
        assert image.format == "PNG"
        assert min(image.size) > 300
        assert len(image.convert("RGB").getcolors(1 << 24)) > 50
    if field == "displacement x":
        tab.press("SVG")
        name, content = tab.saved()
        assert name.endswith(".svg")
        assert ET.fromstring(content).tag == "{http://www.w3.org/2000/svg}svg"
        tab.press("PDF")
        name, content = tab.saved()
        assert name.endswith(".pdf")
        assert content.startswith(b"%PDF-")
        assert content.rstrip().endswith(b"%%EOF")


def test_figures_of_frames_have_their_numbers(open_view: OpenView) -> None:
    tab = open_view("series", "series")
    tab.enter("Frame", 2)
    tab.press("PNG")
    assert tab.saved()[0] == "series.frame_2.displacement_magnitude.png"


def test_a_short_series_beside_a_long_one_shows_its_last_frame(
        known: dict[str, Path], tmp_path: Path, jobs: Jobs) -> None:
    short = write_series_file(tmp_path / "short.vtkhdf", [FrameFile(0.5), FrameFile(1.0)])
    tab = Tab(partial(make_view_page, [known["series"], short], []), jobs)
    tab.enter("Frame", 3)
    tab.enter("Result", "short.vtkhdf")
    assert "short.vtkhdf, frame 2, time 1" in tab.texts()
    tab.press("PNG")
    assert tab.saved()[0] == "short.frame_2.displacement_magnitude.png"


def test_frames_keep_one_result(known: dict[str, Path]) -> None:
    frames = Frames(known["series"])
    assert frames[1] is frames[1]
    assert frames[9] is frames[2]
    assert [result.attributes["time"]["deformed"] for result in frames.read_all()] == [0.5, 1.0, 3.0]
