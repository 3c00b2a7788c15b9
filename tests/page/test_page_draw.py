"""The page of ddic draw: clicks make the text of a case, the text makes the drawing, and what is wrong is told."""

from __future__ import annotations

import html
import os
import re
import sys
import time
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bokeh.events import ButtonClick, DoubleTap
from bokeh.models import Button, CheckboxGroup, MultiLine, Plot, PointDrawTool, Segment

from ddic.case.loader import load_case
from ddic.errors import InputError
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh
from ddic.page import drawn_case
from ddic.page.clicks import DOUBLE_CLICK_S
from ddic.page.draw import STRENGTHS, make_draw_page
from ddic.page.drawn_case import DrawnCase, check_text, open_drawn_case
from ddic.probes.probes import PointProbe, load_probes
from page.conftest import OpenDraw
from support.cases import REGION as SHOWN
from support.cases import case_text, write_images
from support.page_tab import Jobs, Tab

HOLE, LINE, REGION = "hole: circle", "line: crack, shear band", "region: rectangle"
POINTS = "Its points: x, y; x, y; ... (px)"
DEFORMED = "Deformed images: one; a.tif, b.tif; or a pattern, zoom-*.tif"
PROBES = "Probes (a file for ddic probe --probes)"
SIZE, WAVELENGTH = "Element size (px)", "Cut-off wavelength (px)"


def text_area(tab: Tab, folder: Path) -> Any:
    return tab.widget(str(folder / "case.toml"))


def text_of(tab: Tab, folder: Path) -> str:
    return str(text_area(tab, folder).value)


def problems(tab: Tab) -> str:
    """What is told in red."""
    found = re.findall(r'<div style="color: #b00020">(.*?)</div>', tab.texts(), re.DOTALL)
    return html.unescape("\n".join(found)).replace("<br>", "\n")


def added_lines(before: str, after: str) -> list[str]:
    return [line for line in after.split("\n") if line not in before.split("\n")]


def test_clicks_make_the_text_that_a_person_would_write(open_draw: OpenDraw, folder: Path) -> None:
    """A pixel of the image is four of the screen: a tenth of a pixel is what can be clicked."""
    tab = open_draw()
    before = text_of(tab, folder)
    tab.draw(REGION, [(20.04, 170.0), (172.06, 19.96)])
    tab.draw(HOLE, [(96.0, 96.0), (96.0, 110.52)])
    tab.draw("hole: polygon", [(40.0, 40.0), (60.0, 40.0), (50.0, 62.34)], finish=True)
    tab.draw(LINE, [(10.0, 130.0), (80.123, 135.0)], finish=True)
    tab.enter(WAVELENGTH, 80)
    tab.draw("edge not controlled: box", [(170.0, 10.0), (180.0, 180.0)])
    tab.enter(SIZE, 12.5)
    expected = [
        "region = [20, 20, 172.1, 170]    # x0, y0, x1, y1: where the reference image bears a pattern",
        "element_size = 12.5    # px: features of 4.8 px, 3.4 along the side of an element",
        "circles = [{center = [96, 96], radius = 14.5}]",
        "polygons = [{vertices = [[40, 40], [60, 40], [50, 62.3]]}]",
        "[[discontinuity]]", "vertices = [[10, 130], [80.1, 135]]",
        "[regularization]", "cut_off_wavelength = 80", "boxes = [[170, 10, 180, 180]]"]
    assert added_lines(before, text_of(tab, folder)) == expected
    assert problems(tab) == ""
    assert "ready to run" in tab.texts()
    assert tab.widget("Drawn").options == [
        REGION, f"{HOLE} 1", "hole: polygon 1", f"{LINE} 1", "edge not controlled: box 1"]


def test_a_polygon_ends_with_a_double_click(open_draw: OpenDraw, folder: Path) -> None:
    """Both clicks of it are one vertex; too few vertices end nothing."""
    tab = open_draw()
    tab.widget("Draw").value = "hole: polygon"
    tab.click(40.0, 40.0)
    tab.double_click(60.0, 40.0)
    assert "polygons" not in tomllib.loads(text_of(tab, folder))["mesh"]["structured"]
    tab.double_click(50.0, 60.0)
    assert tomllib.loads(text_of(tab, folder))["mesh"]["structured"]["polygons"] == [
        {"vertices": [[40, 40], [60, 40], [50, 60]]}]


def test_a_fast_click_elsewhere_is_a_click(open_draw: OpenDraw, folder: Path) -> None:
    """The browser tells of it as the second of a double one."""
    tab = open_draw()
    tab.draw(HOLE, [(96.0, 96.0)])
    tab.send("image", DoubleTap, 110.0, 96.0)
    assert "circles = [{center = [96, 96], radius = 14}]" in text_of(tab, folder)


def test_a_double_click_that_ends_a_shape_does_not_begin_the_next_one(open_draw: OpenDraw, folder: Path) -> None:
    """Of a rectangle the first of both ends it; a corner of the next one at the same place is clicked later."""
    tab = open_draw()
    tab.widget("Draw").value = "mask: rectangle"
    tab.click(30.0, 30.0)
    tab.double_click(60.0, 50.0)
    tab.click(100.0, 90.0)
    tab.click(110.0, 120.0)
    time.sleep(DOUBLE_CLICK_S)
    tab.click(110.0, 120.0)
    tab.click(130.0, 130.0)
    assert tomllib.loads(text_of(tab, folder))["images"]["masked"] == [
        [30, 30, 60, 50], [100, 90, 110, 120], [110, 120, 130, 130]]


def test_both_clicks_of_a_double_one_are_one_where_they_snap(folder: Path, jobs: Jobs) -> None:
    """Onto the outline of the mesh's mask, 6 pixels of the screen away: farther than a click from its repetition."""
    mask = np.zeros((192, 192), np.uint8)
    mask[40:150, 40:150] = 255
    cv2.imwrite(str(folder / "mask.png"), mask)
    (folder / "case.toml").write_text(case_text(region=f'{SHOWN}\nmask = "mask.png"'), encoding="utf-8")
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "f.tif", folder / "case.toml")), jobs)
    tab.widget("Draw").value = "mask: polygon"
    tab.click(80.0, 80.0)
    tab.click(110.0, 80.0)
    tab.double_click(100.0, 38.5)
    assert tomllib.loads(text_of(tab, folder))["images"]["masked"] == [{"vertices": [[80, 80], [110, 80], [100, 40]]}]


def test_masks_are_drawn_in_all_forms(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw(case_text())
    tab.draw("mask: rectangle", [(60.0, 50.0), (30.0, 30.0)])
    tab.draw("mask: circle", [(96.0, 96.0), (96.0, 110.5)])
    assert "masked = [[30, 30, 60, 50], {center = [96, 96], radius = 14.5}]" in text_of(tab, folder)
    tab.draw("mask: polygon", [(120.0, 40.0), (140.0, 40.0), (130.0, 62.0)], finish=True)
    assert tomllib.loads(text_of(tab, folder))["images"]["masked"][2] == {"vertices": [[120, 40], [140, 40], [130, 62]]}
    assert tab.widget("Drawn").options == [REGION, "mask: rectangle 1", "mask: polygon 3", "mask: circle 2"]
    assert "ready to run" in tab.texts()
    tab.enter("Drawn", "mask: circle 2")
    tab.press("Remove")
    tab.draw("mask: polygon", [(40.0, 100.0), (80.0, 140.0), (80.0, 100.0), (40.0, 140.0)], finish=True)
    assert "case.toml: images.masked[2]: the polygon crosses or touches itself" in problems(tab)


GMSH = """\
[mesh.unstructured]   # by gmsh
region = { center = [96, 96], radius = 70.0 }  # the disk
element_size = 16.0   # coarse
circles = [{ center = [96, 96], radius = 20 }]
[regularization]
cut_off_wavelength = 80
not_controlled = ["hole_0"]
"""


def gmsh_text() -> str:
    return case_text().partition("[mesh.structured]")[0] + GMSH


def test_a_mesh_by_gmsh_is_drawn_and_changed_in_one_line(open_draw: OpenDraw, folder: Path) -> None:
    pytest.importorskip("gmsh")
    tab = open_draw(gmsh_text())
    assert tab.widget("Drawn").options == ["region: circle", f"{HOLE} 1"]
    assert (tab.widget("Mesh").value, tab.widget(SIZE).value) == ("unstructured", 16)
    assert re.search(r"hole_0 \(\d+ nodes\)", tab.texts())
    rgba, _ = tab.shown()
    assert (rgba[..., 0] != rgba[..., 2]).any()
    tab.enter(SIZE, 20)
    assert text_of(tab, folder) == gmsh_text().replace("16.0", "20")
    tab.enter("Drawn", "region: circle")
    tab.enter(POINTS, "96, 96; 166.5, 96")
    assert text_of(tab, folder) == gmsh_text().replace("16.0", "20").replace("70.0", "70.5")
    tab.draw("hole: polygon", [(60.0, 50.0), (80.0, 50.0), (70.0, 64.0)], finish=True)
    assert tomllib.loads(text_of(tab, folder))["mesh"]["unstructured"]["polygons"]
    text_area(tab, folder).value = gmsh_text().replace("hole_0", "hole_7")
    tab.settle()
    assert "hole_7" in problems(tab)


def test_the_maker_of_the_mesh_is_chosen(open_draw: OpenDraw, folder: Path) -> None:
    pytest.importorskip("gmsh")
    tab = open_draw(gmsh_text())
    tab.enter("Mesh", "structured")
    assert text_of(tab, folder) == gmsh_text().replace("unstructured", "structured")
    assert "ready to run" in tab.texts()
    tab.press("Undo")
    assert (tab.widget("Mesh").value, text_of(tab, folder)) == ("unstructured", gmsh_text())
    text_area(tab, folder).value = case_text().partition("[mesh")[0] + '[mesh]\nfile = "m.msh"\n'
    tab.settle()
    tab.widget("Mesh").value = "structured"
    assert "no section [mesh.structured] or [mesh.unstructured] alone describes it" in problems(tab)
    assert tab.widget("Mesh").value == ""
    text_area(tab, folder).value = gmsh_text() + "broken ["
    tab.settle()
    tab.enter("Mesh", "structured")
    assert text_of(tab, folder) == gmsh_text() + "broken ["
    assert tab.widget("Mesh").value == ""


def test_where_gmsh_is_not_installed_a_line_says_what_to_install(
        open_draw: OpenDraw, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gmsh", None)
    tab = open_draw(case_text())
    tab.enter("Mesh", "unstructured")
    (line,) = problems(tab).splitlines()
    assert "mesh.unstructured: gmsh makes this mesh and cannot be imported" in line
    assert "pip install gmsh" in line


def test_warnings_of_the_check_are_told_beside_its_report(open_draw: OpenDraw, folder: Path) -> None:
    """What nothing asks for is no problem, and is told once."""
    tab = open_draw(case_text('[solver]\nmethod = "monolithic"\nsubdomains = 4'))
    told = "solver.subdomains changes nothing here: it goes with a method of several subdomains; leave it out"
    assert tab.texts().count(told) == 1
    assert problems(tab) == ""
    assert "ready to run" in tab.texts()
    text_area(tab, folder).value = case_text()
    tab.settle()
    assert told not in tab.texts()


def test_nothing_is_drawn_while_the_image_is_moved(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    before = text_of(tab, folder)
    tab.click(40.0, 40.0)
    tab.double_click(50.0, 40.0)
    assert text_of(tab, folder) == before


def test_where_it_is_zoomed_in_clicks_have_more_digits(open_draw: OpenDraw, folder: Path) -> None:
    """A hundredth of a pixel where 8 px fill the screen."""
    tab = open_draw()
    plot = tab.find(Plot, name="image")
    plot.x_range.update(start=92.0, end=100.0)
    plot.y_range.update(start=100.0, end=92.0)
    tab.draw(HOLE, [(96.123, 96.0), (99.456, 96.0)])
    assert "circles = [{center = [96.12, 96], radius = 3.34}]" in text_of(tab, folder)


def test_what_is_in_sight_is_read_once_it_rests(open_draw: OpenDraw) -> None:
    """Zoomed to 8 px they are shown as such, though the browser tells of every step of the wheel."""
    tab = open_draw()
    plot = tab.find(Plot, name="image")
    for half in (60.0, 30.0, 4.0):
        plot.x_range.update(start=96.0 - half, end=96.0 + half)
        plot.y_range.update(start=96.0 + half, end=96.0 - half)
    assert tab.shown()[1] == (-0.5, -0.5, 191.5, 191.5)
    tab.rest()
    rgba, box = tab.shown()
    assert box == (91.5, 91.5, 100.5, 100.5)
    assert rgba.shape[0] >= 760


def test_the_drawing_follows_the_text(open_draw: OpenDraw, folder: Path) -> None:
    hole, mechanics = "circles = [{ center = [96, 80], radius = 20 }]", "[regularization]\ncut_off_wavelength = 64"
    tab = open_draw(case_text(f"{hole}\n{mechanics}"))
    plot = tab.find(Plot, name="image")
    outlines = next(r.data_source.data for r in plot.renderers
                    if isinstance(r.glyph, MultiLine) and r.glyph.line_color == "#ffd040")
    assert [len(xs) for xs in outlines["xs"]] == [5, 73]
    assert (max(outlines["xs"][1]), max(outlines["ys"][1])) == (116.0, 100.0)
    assert (tab.widget(SIZE).value, tab.widget(WAVELENGTH).value) == (16, 64)
    # The wavelength to scale, from the corner of the mesh.
    bar = next(r.data_source.data for r in plot.renderers if isinstance(r.glyph, Segment))
    assert (bar["x"], bar["x1"], bar["y"], bar["text"]) == ([24.0], [88.0], [24.0], ["l_c = 64 px"])
    text = text_of(tab, folder).replace("[96, 80]", "[50, 60]")
    text_area(tab, folder).value = text
    assert max(outlines["xs"][1]) == 116.0
    outlines = next(r.data_source.data for r in plot.renderers
                    if isinstance(r.glyph, MultiLine) and r.glyph.line_color == "#ffd040")
    assert (max(outlines["xs"][1]), max(outlines["ys"][1])) == (70.0, 80.0)


def test_the_mesh_is_drawn_over_the_image(open_draw: OpenDraw) -> None:
    """Lines of cells of 16 px from 24 px on, four pixels of the screen to one: bluish there, grey between."""
    tab = open_draw(case_text())
    rgba, box = tab.shown()
    pitch = (box[2] - box[0]) / rgba.shape[1]

    def is_grey(x: float, y: float) -> bool:
        pixel = rgba[round((y - box[1]) / pitch - 0.5), round((x - box[0]) / pitch - 0.5)]
        return len(set(pixel[:3].tolist())) == 1

    assert not any(is_grey(x, 90.0) for x in (24.0, 40.0, 104.0, 168.0))
    assert not any(is_grey(90.0, y) for y in (24.0, 40.0, 104.0, 168.0))
    assert all(is_grey(x, 90.0) for x in (16.0, 32.0, 100.0, 176.0))
    tab.find(CheckboxGroup).active = []
    rgba, _ = tab.shown()
    assert (rgba[..., :3] == rgba[..., :1]).all()


def test_texture_is_drawn_by_element_and_weak_nodes_are_marked(folder: Path, jobs: Jobs) -> None:
    """The right half of the image is flat: its nodes are marked, and its elements have the colour of none."""
    image = cv2.imread(str(folder / "f.tif"), cv2.IMREAD_UNCHANGED)
    image[:, 96:] = 128
    cv2.imwrite(str(folder / "f.tif"), image)
    (folder / "case.toml").write_text(case_text(), encoding="utf-8")
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "f.tif", folder / "case.toml")), jobs)
    tab.find(CheckboxGroup).active = [2]
    rgba, box = tab.shown()
    pitch = (box[2] - box[0]) / rgba.shape[1]
    # Blocks of 16 px from 96 on are flat; 10 rows of nodes from 104 to 168.
    n_dots, _, _, centres = cv2.connectedComponentsWithStats((rgba[..., 0] != rgba[..., 1]).astype(np.uint8))
    assert n_dots == 1 + 50
    # Rounded to a pixel of the screen, and four of them wide.
    columns = np.unique(box[0] + pitch * (centres[1:, 0] + 0.5))
    np.testing.assert_allclose(columns, np.arange(104.0, 169.0, 16.0), atol=pitch)
    tab.find(CheckboxGroup).active = [1]
    rgba, box = tab.shown()
    left, right = (rgba[round(90.0 / pitch), round(x / pitch), :3].astype(int) for x in (60.0, 140.0))
    # Red at the low end of the colours, green or yellow where texture is as in most of the pattern.
    assert right[0] > right[1]
    assert left[1] >= left[0]
    assert STRENGTHS[0] < 0 < STRENGTHS[1]


def test_of_a_rectangle_no_whole_mesh_is_built(drawn: DrawnCase, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither where it is found fit nor where something else is wrong."""
    build = GridLines.build_mesh

    def build_small(grid: GridLines) -> Mesh:
        # Its outline is one rectangle.
        assert grid.n_cells == 1
        return build(grid)

    monkeypatch.setattr(GridLines, "build_mesh", build_small)
    checked = check_text(drawn.text, drawn)
    assert isinstance(checked.mesh, GridLines)
    assert checked.report is not None
    wrong = check_text(f"{drawn.text}\n[regularization]\ncut_off_wavelength = 1e6\n", drawn)
    assert isinstance(wrong.mesh, GridLines)
    assert wrong.problems


def test_what_is_too_large_to_be_drawn_is_told(drawn: DrawnCase, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh with a hole is built as a whole: beyond a limit its outline alone is drawn."""
    text = drawn.text.replace("element_size = ", "circles = [{ center = [96, 96], radius = 20 }]\nelement_size = ")
    checked = check_text(text, drawn)
    assert isinstance(checked.mesh, Mesh)
    monkeypatch.setattr(drawn_case, "MOST_CELLS", checked.mesh.n_cells - 1)
    refused = check_text(text, drawn)
    assert (refused.mesh, refused.report) == (None, None)
    assert refused.problems == []
    assert "outlines alone, and ddic check" in refused.warnings[0]
    assert check_text(drawn.text, drawn).report is not None


def test_undo_takes_back_one_change_after_the_other(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    texts = [text_of(tab, folder)]
    tab.draw(HOLE, [(96.0, 96.0), (110.0, 96.0)])
    texts.append(text_of(tab, folder))
    tab.enter(SIZE, 8)
    texts.append(text_of(tab, folder))
    text_area(tab, folder).value = "broken ["
    tab.settle()
    for text in texts[::-1]:
        tab.press("Undo")
        assert text_of(tab, folder) == text
    assert tab.widget(SIZE).value == 16
    tab.press("Undo")
    assert text_of(tab, folder) == texts[0]
    tab.draw(HOLE, [(96.0, 96.0), (110.0, 96.0)])
    tab.press("Undo")
    assert text_of(tab, folder) == texts[0]


def test_undo_takes_back_probes_and_clicks_too(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    before = text_of(tab, folder)
    tab.draw(HOLE, [(96.0, 96.0), (110.0, 96.0)])
    tab.draw("probe: point", [(40.0, 40.0)])
    # A first click alone.
    tab.draw("probe: gauge", [(60.0, 60.0)])
    with_hole = text_of(tab, folder)
    tab.press("Undo")
    assert "point_1" in tab.widget(PROBES).value
    tab.press("Undo")
    assert (tab.widget(PROBES).value, text_of(tab, folder)) == ("", with_hole)
    tab.press("Undo")
    assert text_of(tab, folder) == before


def test_deformed_images_are_named(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    assert tab.widget(DEFORMED).value == "g.tif"
    before = text_of(tab, folder)
    tab.enter(DEFORMED, "g.tif, f.tif")
    assert added_lines(before, text_of(tab, folder)) == ['deformed = ["g.tif", "f.tif"]']
    assert tab.widget(DEFORMED).value == "g.tif, f.tif"
    tab.enter(DEFORMED, "?.tif")
    assert added_lines(before, text_of(tab, folder)) == ['deformed = "?.tif"']
    tab.enter(DEFORMED, "absent.tif")
    assert "absent.tif: no such image file" in problems(tab)
    # A case that is known to be wrong is not run.
    tab.press("Run")
    assert not (folder / "case.toml").exists()


def test_what_is_being_checked_is_not_run(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    text_area(tab, folder).value = case_text("# changed")
    # The check waits beside the page.
    button = tab.find(Button, label="Run")
    button._trigger_event(ButtonClick(button))
    assert "is being checked; run it in a moment" in tab.texts()
    assert not (folder / "case.toml").exists()


def test_boxes_say_what_the_text_says(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    text_area(tab, folder).value = "broken ["
    tab.settle()
    for title, typed, said in ((SIZE, 33, 16), (DEFORMED, "other.tif", "g.tif")):
        tab.enter(title, typed)
        assert tab.widget(title).value == said
        assert "not valid TOML; correct the text first" in problems(tab)


def test_shapes_are_removed(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    before = text_of(tab, folder)
    for x in (60.0, 120.0):
        tab.draw(HOLE, [(x, 96.0), (x + 10.0, 96.0)])
    tab.enter("Drawn", f"{HOLE} 1")
    tab.press("Remove")
    assert added_lines(before, text_of(tab, folder)) == ["circles = [{center = [120, 96], radius = 10}]"]
    assert tab.widget("Drawn").value == f"{HOLE} 1"
    tab.press("Remove")
    assert text_of(tab, folder) == before


def handles(tab: Tab) -> Any:
    (tool,) = [tool for tool in tab.find(Plot, name="image").tools if isinstance(tool, PointDrawTool)]
    return tool.renderers[0].data_source


def test_a_handle_that_is_dragged_changes_its_point_alone(open_draw: OpenDraw, folder: Path) -> None:
    """Others keep their digits, however many."""
    line = "[[discontinuity]]\nvertices = [\n    [10.12345, 100.0],\n    [90, 105],\n    [180, 111.111111],\n]"
    tab = open_draw(case_text(line))
    tab.enter("Drawn", f"{LINE} 1")
    assert handles(tab).data == {"x": [10.12345, 90.0, 180.0], "y": [100.0, 105.0, 111.111111]}
    handles(tab).data = {"x": [10.12345, 95.987, 180.0], "y": [100.0, 105.0, 111.111111]}
    tab.settle()
    assert text_of(tab, folder) == case_text(line).replace("[90, 105]", "[96, 105]")
    assert tab.widget(POINTS).value == "10.12345, 100; 96, 105; 180, 111.111111"


def test_a_circle_moves_by_its_centre_and_grows_by_its_rim(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw(case_text("circles = [{ center = [96, 80], radius = 20.123456 }]  # the hole"))
    tab.enter("Drawn", f"{HOLE} 1")
    assert handles(tab).data == {"x": [96.0, 116.123456], "y": [80.0, 80.0]}
    handles(tab).data = {"x": [100.04, 116.123456], "y": [81.0, 80.0]}
    tab.settle()
    assert "circles = [{ center = [100, 81], radius = 20.123456 }]  # the hole\n" in text_of(tab, folder)
    assert handles(tab).data == {"x": [100.0, 120.123456], "y": [81.0, 81.0]}
    handles(tab).data = {"x": [100.0, 100.0], "y": [81.0, 91.26]}
    tab.settle()
    assert "circles = [{ center = [100, 81], radius = 10.3 }]  # the hole\n" in text_of(tab, folder)


def test_a_handle_cannot_be_taken_out(open_draw: OpenDraw, folder: Path) -> None:
    """As the backspace key does in the browser: the page shows it again."""
    tab = open_draw(case_text("circles = [{ center = [96, 80], radius = 20 }]"))
    tab.enter("Drawn", f"{HOLE} 1")
    before = text_of(tab, folder)
    handles(tab).data = {"x": [96.0], "y": [80.0]}
    tab.settle()
    assert text_of(tab, folder) == before
    assert handles(tab).data == {"x": [96.0, 116.0], "y": [80.0, 80.0]}


def test_points_are_typed(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw(case_text("[[discontinuity]]\nvertices = [[1234.56789, 100], [90, 105]]"))
    tab.enter("Drawn", f"{LINE} 1")
    assert tab.widget(POINTS).value == "1234.56789, 100; 90, 105"
    tab.enter(POINTS, "1234.56789, 100; 90, 105.25;  120.5 , 110 ;")
    assert tomllib.loads(text_of(tab, folder))["discontinuity"] == [
        {"vertices": [[1234.56789, 100], [90, 105.25], [120.5, 110]]}]


WRONG: dict[str, tuple[str, str]] = {
    # What is drawn, or not.
    "a hole larger than the region": (
        "circles = [{ center = [96, 96], radius = 500 }]", "no cell is left; holes and mask cover the whole region"),
    "a hole beside the region": (
        "circles = [{ center = [500, 96], radius = 10 }]", "hole_0 holds the centre of no cell"),
    "a radius of nothing": ("circles = [{ center = [96, 96], radius = 0 }]", "circles[0].radius = 0"),
    "a negative radius": ("circles = [{ center = [96, 96], radius = -5 }]", "circles[0].radius = -5"),
    "a circle without a radius": ("circles = [{ center = [96, 96] }]", "circles[0].radius: this key is missing"),
    "two vertices": ("polygons = [{ vertices = [[60, 60], [120, 120]] }]", "polygons[0].vertices"),
    "the same vertex twice": (
        "polygons = [{ vertices = [[60, 60], [60, 60], [60, 60]] }]", "polygons[0]: the polygon crosses or touches"),
    "vertices on a line": (
        "polygons = [{ vertices = [[60, 60], [80, 80], [100, 100]] }]", "polygons[0]: the polygon crosses or touches"),
    "a vertex that is no number": ('polygons = [{ vertices = [[60, "a"], [80, 80], [100, 60]] }]', "polygons[0]"),
    "nan": ("circles = [{ center = [nan, 96], radius = 5 }]", "circles[0].center"),
    "infinity": ("circles = [{ center = [inf, 96], radius = 5 }]", "circles[0].center"),
    "a line beside the mesh": ("[[discontinuity]]\nvertices = [[300, 300], [400, 400]]", "discontinuity"),
    "a line within a cell": ("[[discontinuity]]\nvertices = [[90, 90], [92, 91]]", "discontinuity"),
    "a line of one point": ("[[discontinuity]]\nvertices = [[90, 90]]", "discontinuity[0].vertices"),
    "a line whose vertex repeats": (
        "[[discontinuity]]\nvertices = [[10, 90], [10, 90], [180, 90]]", "a vertex repeats the one before it"),
    "a word for a line": ('[discontinuity]\nvertices = "across"', "discontinuity"),
    "a box without nodes": (
        "[regularization]\ncut_off_wavelength = 64\nboxes = [[500, 500, 600, 600]]", "500"),
    "a wavelength of no cell": ("[regularization]\ncut_off_wavelength = 1", "cut_off_wavelength = 1: the mesh"),
    "a negative wavelength": ("[regularization]\ncut_off_wavelength = -80", "cut_off_wavelength = -80"),
    "a regularization without a weight": ("[regularization]\nboxes = []", "regularization.cut_off_wavelength or"),
    "a near field without images": ("[[near]]\nregion = [1, 2, 3, 4]", "near[0].reference: this key is missing"),
    "a key of nobody": ("wavelength = 5", "wavelength"),
    "a section of nobody": ("[elements]\nsize = 5", "elements"),
    "cells of nobody": ('cell = "Q8"', "cell"),
    "a mask that is not there": ('mask = "absent.png"', "absent.png"),
}


WHOLE: dict[str, tuple[str, str]] = {
    "an empty text": ("", "images"),
    "no TOML": ("[images\n", "not valid TOML"),
    "a word": ("hello", "not valid TOML"),
    "half a number": ("[mesh.structured]\nelement_size = 1,5\n", "numbers have a decimal point"),
    "a backslash": ('[images]\nreference = "C:\\images\\f.tif"\n', "a backslash begins an escape"),
    "NUL": ('title = "a\\u0000b"\n' + case_text(), "NUL character"),
    "thousands of digits": (case_text().replace("= 16", "= " + "9" * 5000), "thousands of digits"),
    "hundreds of digits": (case_text().replace("= 16", "= " + "9" * 400), "more than 64 bits"),
    "a depth of hundreds": ("a = " + "[" * 900 + "]" * 900 + "\n", "levels deep"),
    "a text for a number": (case_text().replace("= 16", '= "16"'), "element_size"),
    "a truth for a number": (case_text().replace("= 16", "= true"), "element_size"),
    "no size": (case_text().replace("= 16", "= 0"), "element_size = 0"),
    "no number": (case_text().replace("= 16", "= nan"), "element_size"),
    "a size of less than a pixel": (case_text().replace("= 16", "= 0.5"), "some hold no pixel"),
    "1e12 cells": (case_text(region="region = [0, 0, 1e6, 1e6]").replace("= 16", "= 1"), "asks for 1e+12 elements"),
    "1e12 cells with a hole": (
        case_text("circles = [{ center = [9, 9], radius = 3 }]", region="region = [0, 0, 1e6, 1e6]").replace(
            "element_size = 16", "element_size = 1"), "asks for 1e+12 elements"),
    "1e24 cells": (case_text(region="region = [0, 0, 1e12, 1e12]").replace("= 16", "= 1"), "asks for 1e+24 elements"),
    "cells of 1e-9 px": (case_text().replace("= 16", "= 1e-9"), "elements, more than"),
    "a region outside": (case_text(region="region = [500, 500, 700, 700]"), "lies outside the image"),
    "a region over the edge": (case_text(region="region = [24, 24, 300, 168]"), "outside the image"),
    "a region the wrong way round": (case_text(region="region = [168, 168, 24, 24]"), "must hold at least one element"),
    "a region of no cell": (case_text(region="region = [24, 24, 30, 30]"), "must hold at least one element"),
    "a region of three numbers": (case_text(region="region = [24, 24, 168]"), "region"),
    "no region": (case_text(region=""), "region"),
    "no mesh": ('[images]\nreference = "f.tif"\ndeformed = "g.tif"\n', "mesh"),
    "two meshes": (case_text('[mesh]\nfile = "a.msh"'), "mesh"),
    "no deformed image": (case_text(deformed="absent.tif"), "absent.tif"),
    "another reference image": (case_text().replace("f.tif", "g.tif"), "images.reference: this page shows"),
    "a folder for an image": (case_text(deformed="."), "is a folder"),
}


@pytest.fixture
def tab(open_draw: OpenDraw) -> Tab:
    return open_draw(case_text())


def test_what_is_wrong_is_told_and_the_page_goes_on(tab: Tab, folder: Path) -> None:
    """More than fifty kinds of mistakes on one page, one after the other, each told in a line with what is wrong."""
    mistakes = {name: (case_text(more), told) for name, (more, told) in WRONG.items()} | WHOLE
    assert len(mistakes) > 50
    area = text_area(tab, folder)
    for name, (text, told) in mistakes.items():
        begin = time.process_time()
        area.value = text
        tab.settle()
        assert told in problems(tab), f"{name}: {problems(tab)}"
        assert not re.search(r"Traceback|^\w*Error:", problems(tab), re.MULTILINE), name
        assert time.process_time() - begin < 5.0, name
    area.value = case_text()
    tab.settle()
    assert problems(tab) == ""
    tab.draw(HOLE, [(96.0, 96.0), (106.0, 96.0)])
    # A hole over the edge is a notch.
    tab.draw(HOLE, [(24.0, 96.0), (40.0, 96.0)])
    assert "ready to run" in tab.texts()


@pytest.mark.parametrize(("typed", "told"), [
    ("", "2 points or more expected"), ("1, 2", "2 points or more"), ("1, 2; 3", "2 points or more"),
    ("1, 2; 3, x", "2 points or more"), ("1, 2; nan, 4", "2 points or more"), ("1, 2; 3, inf", "2 points or more"),
    ("1 2; 3 4", "2 points or more"), ("1, 2, 3; 3, 4, 5", "2 points or more"), ("1,2;1e999,3", "2 points or more"),
])
def test_wrong_points_change_nothing(tab: Tab, folder: Path, typed: str, told: str) -> None:
    before = text_of(tab, folder)
    tab.enter("Drawn", REGION)
    tab.enter(POINTS, typed)
    assert text_of(tab, folder) == before
    assert told in problems(tab)


def test_what_cannot_be_changed_by_clicks_is_told(tab: Tab, folder: Path) -> None:
    """A window without a near field, and texts that only a person can put right."""
    tab.draw("near field: window", [(30.0, 30.0), (60.0, 60.0)])
    assert "near field 1: there is no such [[near]] section" in problems(tab)
    for text, told in (("mesh = 3\n", "mesh.structured: is no section in this text"), ("broken [", "case.toml"),
                       (case_text("circles = 3"), "circles: is no list"), (case_text('circles = "a"'), "no list")):
        text_area(tab, folder).value = text
        tab.settle()
        tab.draw(HOLE, [(96.0, 96.0), (106.0, 96.0)])
        assert told in problems(tab)
        assert text_of(tab, folder) == text
    tab.enter(SIZE, 9)
    assert "circles" in problems(tab)


def test_what_the_check_does_not_foresee_is_told_too(
        open_draw: OpenDraw, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tab = open_draw()

    def fail(*_: object) -> None:
        raise ZeroDivisionError("of a check")

    monkeypatch.setattr(drawn_case, "check_case", fail)
    tab.enter(SIZE, 8)
    assert problems(tab) == "ZeroDivisionError: of a check"


def test_of_texts_that_follow_fast_the_last_one_is_checked(
        open_draw: OpenDraw, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tab = open_draw()
    checked = []

    def check(text: str, drawn: DrawnCase) -> drawn_case.Checked:
        checked.append(text)
        return check_text(text, drawn)

    monkeypatch.setattr("ddic.page.draw.check_text", check)
    area = text_area(tab, folder)
    for size in ("12", "10", "8"):
        area.value = re.sub(r"element_size = \d+", f"element_size = {size}", area.value)
    tab.settle()
    assert len(checked) == 1
    assert "element_size = 8 " in checked[0]
    assert "441 nodes" in tab.texts()


def test_a_probe_text_that_is_wrong_and_right_again(open_draw: OpenDraw) -> None:
    """What is wrong with a probe is told until it is right; then what the check found."""
    tab = open_draw()
    probes = "Probes (a file for ddic probe --probes)"
    tab.draw("probe: line", [(40.0, 40.0), (80.0, 60.04)])
    assert tab.widget(probes).value == "[line.line_1]\nstart = [40, 40]\nend = [80, 60]\n"
    tab.draw("probe: point", [(40.0, 50.0)])
    tab.enter(probes, "[point.A]\npoint = 3")
    assert "point.A.point = 3: expected [x, y]" in problems(tab)
    tab.enter(probes, "[point.A]\npoint = [3, 4]")
    assert problems(tab) == ""
    assert "ready to run" in tab.texts()


def test_clicks_snap_to_the_outline_of_a_mask(folder: Path, jobs: Jobs) -> None:
    """Within eight pixels of the screen, two of the image, of a disc's edge; farther away points stay."""
    mask = np.zeros((192, 192), np.uint8)
    cv2.circle(mask, (96, 96), 60, 255, -1)
    cv2.imwrite(str(folder / "mask.png"), mask)
    (folder / "case.toml").write_text(case_text('mask = "mask.png"'), encoding="utf-8")
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "f.tif", folder / "case.toml")), jobs)
    tab.draw(LINE, [(155.0, 96.5), (100.3, 96.0)], finish=True)
    (x, y), other = tomllib.loads(text_of(tab, folder))["discontinuity"][0]["vertices"]
    # A pixel of the disc that has one of the outside beside it.
    assert mask[y, x] == 255
    assert not mask[y - 1:y + 2, x - 1:x + 2].all()
    assert np.hypot(x - 155.0, y - 96.5) < 2.0
    assert other == [100.3, 96]
    # Both ends of a probe at one place, two clicks apart.
    tab.draw("probe: line", [(155.0, 102.3), (156.1, 102.0)])
    assert "give two points" in problems(tab)


# The file.


def test_an_existing_case_changes_in_one_line(open_draw: OpenDraw, folder: Path) -> None:
    written = case_text("# a comment\n[output]\nfile = 'a.vtkhdf'   # here")
    tab = open_draw(written)
    tab.enter(SIZE, 12)
    tab.press("Write the case")
    assert (folder / "case.toml").read_text(encoding="utf-8") == written.replace("= 16", "= 12")
    load_case(folder / "case.toml")


def test_probes_are_written_beside_the_case_and_read_again(drawn: DrawnCase, folder: Path, jobs: Jobs) -> None:
    tab = Tab(partial(make_draw_page, drawn), jobs)
    tab.draw("probe: point", [(40.0, 40.0)])
    tab.press("Write the case")
    assert f"the case was written to {folder / 'case.toml'}" in tab.texts()
    assert (f"the probes (1) were written to {folder / 'case.probes.toml'}, for ddic probe and ddic view by "
            "--probes case.probes.toml") in tab.texts()
    assert "ready to run" in tab.texts()
    assert load_probes(folder / "case.probes.toml") == [PointProbe("point_1", (40.0, 40.0))]
    tab.press("Write the case")
    assert "the probes" not in tab.texts()
    # Comments stay, as they do in a case.
    written = "# by hand\n" + (folder / "case.probes.toml").read_text(encoding="utf-8")
    (folder / "case.probes.toml").write_text(written, encoding="utf-8")
    other = Tab(partial(make_draw_page, drawn), jobs)
    assert other.widget(PROBES).value == written
    tab.draw("probe: point", [(50.0, 50.0)])
    tab.press("Write the case")
    assert "case.probes.toml: was changed since this page was opened" in problems(tab)
    assert (folder / "case.probes.toml").read_text(encoding="utf-8") == written
    other.enter(PROBES, "[point.A")
    other.press("Write the case")
    assert "case.probes.toml: not valid TOML" in problems(other)


def test_ends_of_lines_stay(folder: Path, jobs: Jobs) -> None:
    written = case_text("# a comment").replace("\n", "\r\n").encode()
    (folder / "case.toml").write_bytes(written)
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "f.tif", folder / "case.toml")), jobs)
    tab.enter(SIZE, 12)
    tab.press("Write the case")
    assert (folder / "case.toml").read_bytes() == written.replace(b"= 16", b"= 12")
    tab.enter(SIZE, 13)
    tab.press("Write the case")
    assert (folder / "case.toml").read_bytes() == written.replace(b"= 16", b"= 13")


def test_what_others_have_written_is_not_written_over(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw(case_text())
    (folder / "case.toml").write_text("title = 'of somebody else'\n", encoding="utf-8")
    tab.enter(SIZE, 12)
    tab.press("Write the case")
    assert "was changed since this page was opened; reload the page" in problems(tab)
    assert (folder / "case.toml").read_text(encoding="utf-8") == "title = 'of somebody else'\n"
    (folder / "case.toml").unlink()
    tab.press("Write the case")
    assert not (folder / "case.toml").exists()


def test_a_new_case_is_not_written_over_one_that_has_come_since(open_draw: OpenDraw, folder: Path) -> None:
    tab = open_draw()
    (folder / "case.toml").write_text("title = 'of somebody else'\n", encoding="utf-8")
    tab.press("Write the case")
    assert "was changed since this page was opened" in problems(tab)
    assert (folder / "case.toml").read_text(encoding="utf-8") == "title = 'of somebody else'\n"


def test_a_page_that_is_reloaded_shows_what_was_written(drawn: DrawnCase, folder: Path, jobs: Jobs) -> None:
    tab = Tab(partial(make_draw_page, drawn), jobs)
    tab.enter(SIZE, 12)
    tab.press("Write the case")
    written = text_of(tab, folder)
    other = Tab(partial(make_draw_page, drawn), jobs)
    assert text_of(other, folder) == written
    other.enter(SIZE, 10)
    other.press("Write the case")
    assert "element_size = 10" in (folder / "case.toml").read_text(encoding="utf-8")
    # The first one knows another file.
    tab.press("Write the case")
    assert "was changed since this page was opened" in problems(tab)


def test_a_file_is_written_whole_or_not_at_all(
        open_draw: OpenDraw, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tab = open_draw(case_text())
    tab.enter(SIZE, 12)

    def fail(path: Path, *_: object, **__: object) -> None:
        with path.open("wb") as stream:
            stream.write(b"half of it")
        raise OSError(28, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", fail)
        tab.press("Write the case")
    assert "No space left on device" in problems(tab)
    assert (folder / "case.toml").read_text(encoding="utf-8") == case_text()
    assert sorted(path.name for path in folder.iterdir()) == ["case.toml", "f.tif", "g.tif"]
    tab.press("Write the case")
    assert "element_size = 12" in (folder / "case.toml").read_text(encoding="utf-8")


def test_a_folder_that_cannot_be_written_to_is_told(open_draw: OpenDraw, folder: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    tab = open_draw(case_text())
    tab.enter(SIZE, 12)
    folder.chmod(0o500)
    try:
        tab.press("Write the case")
        assert "does not exist or cannot be written to" in problems(tab)
    finally:
        folder.chmod(0o700)


@pytest.mark.parametrize(("arguments", "told"), [
    (("absent.tif", "case.toml"), "absent.tif: no such image file"),
    (("case.toml", "case.toml"), "case.toml"),
    (("g.tif", "case.toml"), "case.toml has another reference image"),
    (("f.tif", "new.txt"), "new.txt: the name of a case file ends in .toml"),
    (("f.tif", "absent/new.toml"), "its folder does not exist; create it"),
    (("f.tif", "case.toml", ["g.tif"]), "--deformed: "),
    (("f.tif", "bytes.toml"), "is not UTF-8 text"),
])
def test_what_cannot_be_opened(folder: Path, arguments: tuple[Any, ...], told: str) -> None:
    (folder / "case.toml").write_text(case_text(), encoding="utf-8")
    (folder / "bytes.toml").write_bytes(b"title = '\xff'")
    image, case, *deformed = arguments
    with pytest.raises(InputError, match=re.escape(told)):
        open_drawn_case(folder / image, folder / case, [folder / name for name in (deformed or [[]])[0]])


def test_the_image_may_be_named_by_a_link(folder: Path, jobs: Jobs) -> None:
    (folder / "case.toml").write_text(case_text(), encoding="utf-8")
    (folder / "link.tif").symlink_to(folder / "f.tif")
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "link.tif", folder / "case.toml")), jobs)
    assert problems(tab) == ""


def test_a_broken_case_is_opened_to_be_put_right(folder: Path, jobs: Jobs) -> None:
    (folder / "case.toml").write_text("[images\n", encoding="utf-8")
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "f.tif", folder / "case.toml")), jobs)
    assert "not valid TOML" in problems(tab)


def test_only_named_files_are_read(folder: Path, jobs: Jobs, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a folder with other images and cases, by everything that opens a file through Python or OpenCV."""
    write_images(folder)
    (folder / "case.toml").write_text(case_text(), encoding="utf-8")
    for name in ("other.tif", "other.toml", "case.vtkhdf"):
        (folder / name).write_bytes(b"secret")
    opened: set[str] = set()
    known = {"case.toml", "f.tif", "g.tif"}

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str | bytes | os.PathLike) and watching:
            path = Path(os.fsdecode(arguments[0]))
            if path.parent == folder:
                opened.add(path.name)

    watching = [True]
    sys.addaudithook(audit)
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "f.tif", folder / "case.toml")), jobs)
    tab.draw(HOLE, [(96.0, 96.0), (106.0, 96.0)])
    tab.press("Write the case")
    watching.clear()
    assert {name for name in opened if not name.startswith(".case.toml")} <= known
    assert "f.tif" in opened


def test_two_tabs_share_no_drawing(drawn: DrawnCase, folder: Path, jobs: Jobs) -> None:
    one, other = (Tab(partial(make_draw_page, drawn), jobs) for _ in range(2))
    before = text_of(other, folder)
    one.draw(HOLE, [(96.0, 96.0), (106.0, 96.0)])
    one.draw("probe: point", [(40.0, 40.0)])
    assert text_of(other, folder) == before
    assert other.widget("Drawn").options == [REGION]
    assert other.widget("Probes (a file for ddic probe --probes)").value == ""


def test_starter_texts_are_checked_where_images_are_not_named_yet(folder: Path, jobs: Jobs) -> None:
    """The mesh is drawn all the same."""
    tab = Tab(partial(make_draw_page, open_drawn_case(folder / "f.tif", folder / "new.toml")), jobs)
    assert "DEFORMED.tif" in problems(tab)
    rgba, _ = tab.shown()
    assert (rgba[..., 0] != rgba[..., 2]).any()
