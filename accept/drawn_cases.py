"""Cases drawn in the browser: written, checked, run and looked at; existing ones of which one number is changed."""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import ndiff
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from accept.support.browser import Point, ServedPage, Tab, opened_browser, wait_until
from accept.support.ended_job import DDIC
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import environment, images, real_data
from ddic.io.result_reader import read_result
from ddic.io.series_reader import read_series

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CASE, HAND, SERIES = "drawn.toml", "by_hand.toml", "series.toml"

PROBES, PROBES_FILE = "Probes (a file for ddic probe --probes)", "probes.toml"

ELEMENT_SIZE, POINTS = "Element size (px)", "Its points: x, y; x, y; ... (px)"

CLOSE_PX = 1e-12
"""Of a drawn case's field to that of the same case by hand."""

N_DIGITS = 9
"""Of numbers in a table of probes."""


@dataclass(frozen=True)
class Drawing:
    """What is drawn on an image, whole pixels.

    Attributes
    ----------
    reference, deformed : Path
        The images.
    region : two points
        Opposite corners of a rectangle.
    circle : two points
        Centre and rim of a hole.
    hole, mask, line : points
        Vertices of a polygon, of one that is masked, and of a discontinuity; empty for none.
    point, gauge, profile : points
        Of a point, of a gauge's length, of a line probe.
    looked_at : points
        Where the pointer goes on the result.
    """

    reference: Path
    deformed: Path
    region: tuple[Point, Point]
    circle: tuple[Point, Point] | None
    hole: tuple[Point, ...]
    mask: tuple[Point, ...]
    line: tuple[Point, ...]
    point: Point
    gauge: tuple[Point, Point]
    profile: tuple[Point, Point]
    looked_at: tuple[Point, ...]

    def describe(self, element_size: float) -> str:
        """Write the case by hand."""
        (x0, y0), (x1, y1) = self.region
        masked = [f"masked = [{{vertices = {_list(self.mask)}}}]"] if self.mask else []
        lines = ["[images]", f'reference = "{self.reference}"', f'deformed = "{self.deformed}"', *masked,
                 "[mesh.structured]", f"region = [{x0}, {y0}, {x1}, {y1}]", f"element_size = {element_size:g}"]
        if self.circle is not None:
            (x, y), rim = self.circle
            lines.append(f"circles = [{{center = [{x}, {y}], radius = {np.hypot(rim[0] - x, rim[1] - y):g}}}]")
        if self.hole:
            lines.append(f"polygons = [{{vertices = {_list(self.hole)}}}]")
        if self.line:
            lines += ["[[discontinuity]]", f"vertices = {_list(self.line)}"]
        return "\n".join([*lines, "[output]", f'file = "{Path(HAND).stem}.vtkhdf"', ""])

    def describe_clicks(self) -> str:
        """Say what is drawn."""
        return ", ".join(["a rectangle", *["a circle"] * (self.circle is not None), *["a polygon"] * bool(self.hole),
                          *["a mask"] * bool(self.mask), *["a line"] * bool(self.line)])

    def describe_probes(self) -> str:
        """Write a file of probes by hand; the gauge is as long as its clicks are apart, and in their direction."""
        start, end = np.array(self.gauge)
        along = end - start
        centre, angle = (start + end) / 2, np.degrees(np.arctan2(along[1], along[0]))
        return (f"[point.point_1]\npoint = {list(self.point)}\n"
                f"[gauge.gauge_1]\ncentre = {centre.tolist()}\nlength = {np.linalg.norm(along)}\nangle = {angle}\n"
                f"[line.line_1]\nstart = {list(self.profile[0])}\nend = {list(self.profile[1])}\n")


def _list(points: Sequence[Point]) -> str:
    return str([list(point) for point in points])


def draw_plate(folder: Path) -> Drawing:
    """Make a small plate with a hole, and what is drawn on it."""
    made = images("kirsch", "--size", "256x256", "--strain", "0.005", "--radius", "30", "--noise", "2", "--seed", "1",
                  folder=folder / "images")
    return Drawing(made / "reference.tif", made / "deformed.tif", ((20, 20), (230, 230)), ((128, 128), (168, 128)),
                   ((40, 40), (70, 42), (66, 74)), ((180, 60), (210, 64), (204, 110)), ((15, 200), (90, 205)),
                   (60, 160), ((60, 120), (60, 150)), ((190, 40), (190, 200)), ((100, 60), (205, 187), (128, 128)))


def draw_open_hole(folder: Path, *, with_line: bool) -> Drawing:
    """Say what is drawn on the open-hole specimen: its holes and a place that is left out, or a line."""
    del folder
    reference, deformed = (real_data() / "openhole" / f"zoom-{number:04d}_1.tif" for number in (53, 70))
    return Drawing(reference, deformed, ((560, 200), (840, 900)), ((696, 540), (756, 540)),
                   () if with_line else ((600, 760), (660, 750), (650, 820), (605, 815)),
                   ((770, 640), (830, 650), (820, 730), (780, 720)),
                   ((540, 300), (700, 310)) if with_line else (), (620, 400), ((620, 420), (620, 460)),
                   ((580, 700), (820, 700)), ((650, 250), (600.5, 545), (800, 640), (696, 540)))


FRAMES = (54, 58, 62, 66)
"""Of the open-hole test, frame 53 their reference."""

SERIES_ELEMENT = 16
"""Side of its elements, pixels."""


def measure_browser(scale: Scale) -> list[Row]:
    """Draw cases in the browser, run them there and read results; a series too."""
    folder = scale.folder("drawn_cases")
    folder.mkdir(parents=True, exist_ok=True)
    with opened_browser() as browser:
        if scale.smoke:
            return _draw_and_read(browser, draw_plate(folder), folder)
        rows = []
        for with_line in (False, True):
            rows += _draw_and_read(browser, draw_open_hole(folder, with_line=with_line), folder)
        return [*rows, _look_at_series(browser, folder)]


def _draw_and_read(browser: Browser, drawing: Drawing, folder: Path) -> list[Row]:
    """Draw a case, write and run it; read what was measured, on the page and by the command line."""
    _clear(folder)
    (folder / PROBES_FILE).write_text(drawing.describe_probes(), encoding="utf-8")
    with ServedPage("draw", str(drawing.reference), CASE, "--deformed", str(drawing.deformed), folder=folder) as served:
        tab = Tab(browser, served.address)
        _draw(tab, drawing)
        element_size = float(tab.read(ELEMENT_SIZE))
        tab.press("Write the case")
        wait_until((folder / CASE).is_file, "the case is written")
        is_ready = "ready to run" in _run_ddic(folder, "check", CASE)[1]
        tab.press("Run")
        tab.figure = "field"
        tab.wait_for_image()
        are_same = tomllib.loads(tab.read(PROBES)) == tomllib.loads(drawing.describe_probes())
        of_table, of_profile, of_pointer = _compare_readings(tab, drawing, folder)
        n_faults = len(tab.faults) + served.read_errors().count("Traceback")
        tab.close()
    (folder / HAND).write_text(drawing.describe(element_size), encoding="utf-8")
    _run_ddic(folder, "run", HAND)
    largest = _compare_fields(folder)
    image = drawing.reference
    where = (f"{drawing.describe_clicks()} and probes drawn on {image.parent.name}/{image.name}, "
             f"default settings, Q4 of {element_size:g} px as the page proposes")
    n_right, n_all = (sum(counts) for counts in zip(of_table, of_profile, of_pointer, strict=True))
    return [Row(f"{where}: ddic check, the field beside that of the case by hand, and the probes beside those by hand",
                f"ready to run; within {CLOSE_PX:g} px; the same; no error of the page or its server",
                f"{'ready to run' if is_ready else 'refused'}; {largest:.2g} px; {'' if are_same else 'not '}the same; "
                f"{n_faults} errors", is_ready and largest <= CLOSE_PX and are_same and n_faults == 0),
            Row(f"{where}: {of_table[1]} cells of the table, {of_profile[1]} numbers of the profile, {of_pointer[1]} "
                "under the pointer", "all as ddic probe gives them, in the digits shown", f"{n_right} of {n_all}",
                n_right == n_all > 0)]


def _clear(folder: Path) -> None:
    for path in folder.iterdir():
        if path.name != "images":
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _draw(tab: Tab, drawing: Drawing) -> None:
    """Click all shapes and probes."""
    tab.draw("region: rectangle", drawing.region, CASE)
    if drawing.circle is not None:
        tab.draw("hole: circle", drawing.circle, CASE)
    if drawing.hole:
        tab.draw("hole: polygon", drawing.hole, CASE, finish=True)
    if drawing.mask:
        tab.draw("mask: polygon", drawing.mask, CASE, finish=True)
    if drawing.line:
        tab.draw("line: crack, shear band", drawing.line, CASE, finish=True)
    tab.draw("probe: point", [drawing.point], PROBES)
    tab.draw("probe: gauge", drawing.gauge, PROBES)
    tab.draw("probe: line", drawing.profile, PROBES)


def _run_ddic(folder: Path, *arguments: str) -> tuple[int, str]:
    """Exit code and output of a command."""
    done = subprocess.run([*DDIC, *arguments], cwd=folder, env=environment(), text=True, capture_output=True,
                          check=False)
    return done.returncode, done.stdout + done.stderr


def _compare_fields(folder: Path) -> float:
    """Largest difference of the displacements of both cases, pixels; infinite where their meshes or gaps differ."""
    one, other = (read_result(folder / Path(name).with_suffix(".vtkhdf")) for name in (CASE, HAND))
    if not np.array_equal(one.mesh.nodes, other.mesh.nodes):
        return np.inf
    is_known = np.isfinite(one.displacement)
    if not np.array_equal(is_known, np.isfinite(other.displacement)):
        return np.inf
    return float(np.abs(one.displacement - other.displacement)[is_known].max())


# What is shown, beside what ``ddic probe`` prints: how many numbers are the same, of how many.

Count = tuple[int, int]

COLUMNS = (2, 3, 4, 5, 6, 7, 8, 9)
"""Of what ``ddic probe`` prints, after time and name: displacement and its noise, strain, along, and its noise."""

READ = (2, 3, 5, 6, 7)
"""Of these displacement and strain, without their noise."""

ALONG = 8


def _print_probes(folder: Path, result: str, *arguments: str) -> list[list[str]]:
    """Rows that ``ddic probe`` prints: time, probe, numbers."""
    code, printed = _run_ddic(folder, "probe", result, "--probes", PROBES_FILE, *arguments)
    if code:
        raise RuntimeError(f"ddic probe ended with {code}: {printed}")
    rows = [re.split(r"\s{2,}", line.strip()) for line in printed.splitlines() if re.match(r"\s+\d", line)]
    return [row for row in rows if len(row) > max(COLUMNS)]


def _count_equal(shown: Sequence[str], known: Sequence[str]) -> Count:
    return sum(one == other for one, other in zip(shown, known, strict=True)), len(known)


def _compare_readings(tab: Tab, drawing: Drawing, folder: Path) -> tuple[Count, Count, Count]:
    """Compare the table of probes, the profile, and what is shown under the pointer."""
    shown = tab.read_table("gauge_1\t")[1:]
    (distance, along), = tab.read_curves("profile")
    texts, points = [], []
    for point in drawing.looked_at:
        x, y = tab.point_at(point)
        texts.append(tab.find_text(f"x = {x:.2f}, y = {y:.2f} px"))
        points += ["--point", f"{x!r},{y!r}"]
    printed = _print_probes(folder, f"{Path(CASE).stem}.vtkhdf", *points, "--csv", "probes.csv")
    names = [cells[0] for cells in shown]
    named, here = [row for row in printed if row[1] in names], [row for row in printed if row[1] not in names]
    return (_compare_rows(shown, named), _compare_profile(distance, along, folder / "probes.csv"),
            _compare_texts(texts, here))


def _compare_rows(shown: Sequence[Sequence[str]], printed: Sequence[Sequence[str]]) -> Count:
    """Compare rows of the page's table, from the name on, with printed ones."""
    of_page = [cell for cells in shown for cell in cells[:1 + len(COLUMNS)]]
    return _count_equal(of_page, [row[column] for row in printed for column in (1, *COLUMNS)])


def _compare_profile(distance: Sequence[float], along: Sequence[float], table: Path) -> Count:
    """Compare the curve of the line probe with the table that ``ddic probe`` writes."""
    with table.open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["probe"] == "line_1"]
    shown = ["" if np.isnan(number) else f"{number:.{N_DIGITS}g}" for number in (*distance, *along)]
    return _count_equal(shown, [row[name] for name in ("distance [px]", "strain_along [1]") for row in rows])


def _compare_texts(texts: Sequence[str], printed: Sequence[Sequence[str]]) -> Count:
    """Compare what is shown under the pointer with point probes, which have no strain along."""
    shown, known = [], []
    for text, row in zip(texts, printed, strict=True):
        wanted = [row[column] for column in COLUMNS if column != ALONG]
        # After the place, numbers follow a sign.
        numbers = re.findall(r"[=±] ([^\s,;]+)", text.partition("px:")[2])
        if not numbers and {row[column] for column in READ} == {"-"}:
            # Outside the mesh nothing is read, and the page says so in place of numbers.
            numbers = wanted
        shown += numbers
        known += wanted
    return _count_equal(shown, known)


def _look_at_series(browser: Browser, folder: Path) -> Row:
    """Measure a series, look at its last frame, and read the curves of its probes."""
    drawing = draw_open_hole(folder, with_line=False)
    names = [str(drawing.reference.with_name(f"zoom-{number:04d}_1.tif")) for number in FRAMES]
    text = drawing.describe(SERIES_ELEMENT).replace(f'deformed = "{drawing.deformed}"', f"deformed = {names}")
    (folder / PROBES_FILE).write_text(drawing.describe_probes(), encoding="utf-8")
    (folder / SERIES).write_text(text.replace(Path(HAND).stem, Path(SERIES).stem), encoding="utf-8")
    _run_ddic(folder, "run", SERIES)
    result = f"{Path(SERIES).stem}.vtkhdf"
    n_frames = len(read_series(folder / result))
    with ServedPage("view", result, "--probes", "probes.toml", folder=folder) as served:
        tab = Tab(browser, served.address, "field")
        printed = _print_probes(folder, result)
        tab.find_text("gauge_1\t")
        of_curves = _compare_curves(tab, printed)
        tab.page.locator(".noUi-handle").first.focus()
        tab.page.keyboard.press("End")
        tab.find_text(f"frame {n_frames}, ")
        of_last = [row for row in printed if row[0] == printed[-1][0]]
        of_table = _compare_rows(tab.read_table("gauge_1\t")[1:], of_last)
        n_faults = len(tab.faults) + served.read_errors().count("Traceback")
        tab.close()
    n_right, n_all = (sum(counts) for counts in zip(of_curves, of_table, strict=True))
    return Row(f"openhole, frame 53 to {', '.join(map(str, FRAMES))} as a series, Q4 of {SERIES_ELEMENT} px, default "
               f"settings, in ddic view: {of_curves[1]} numbers of the curves over time, {of_table[1]} cells of the "
               "last frame's table", "all frames; all as ddic probe gives them, in the digits shown; no error",
               f"{n_frames} frames; {n_right} of {n_all}; {n_faults} errors",
               n_frames == len(FRAMES) and n_right == n_all > 0 and n_faults == 0)


def _compare_curves(tab: Tab, printed: Sequence[Sequence[str]]) -> Count:
    """Compare the curves over time, of strain along, with what is printed of each probe at each time."""
    names = list(dict.fromkeys(row[1] for row in printed))
    known = [row[column] for name in names for column in (0, ALONG) for row in printed if row[1] == name]
    shown = []
    for times, along in tab.read_curves("curves"):
        shown += [f"{time:g}" for time in times]
        shown += ["-" if np.isnan(strain) else f"{strain:.3e}" for strain in along]
    return _count_equal(shown, known)


EXISTING = """\
# The second specimen of the batch; measured again   with finer elements.
title = 'plate no. 2'

[images]   # both from the left camera
reference = "images/reference.tif"   # before loading
deformed  = 'images/deformed.tif'

[mesh.structured]
region = [ 20,20, 230, 230 ]   # by eye
element_size = 12.0            # px, as for the first specimen
circles = [
    { center = [128, 128], radius = 36 },   # the hole
    { center = [ 60,  60], radius = 14 },   # a scratch
]

# Tried without: too rough.
[regularization]
cut_off_wavelength = 60   # px

[output]
file = "edited.vtkhdf"
"""
"""A case as somebody wrote it, with blanks, quotes and comments of their own."""

BEGUN = "edited.toml"

EDITS = (
    ("the element size", "", ELEMENT_SIZE, "16", "element_size"),
    ("the cut-off wavelength", "", "Cut-off wavelength (px)", "72.5", "cut_off_wavelength"),
    ("a corner of the region, typed", "region: rectangle", POINTS, "24, 20; 230, 230",
     "region"),
    ("a circle's rim, typed", "hole: circle 2", POINTS, "60, 60; 76, 60", "radius = 1"),
)
"""What is changed: in words, the shape that is chosen, the box, what is typed, and what the changed line holds."""


def measure_edit(scale: Scale) -> list[Row]:
    """Open a case with comments, change one number of it, and write it."""
    folder = scale.folder("edited_case")
    folder.mkdir(parents=True, exist_ok=True)
    draw_plate(folder)
    edits = EDITS[1:3] if scale.smoke else EDITS
    (folder / BEGUN).write_text(EXISTING, encoding="utf-8")
    with opened_browser() as browser, ServedPage("draw", "images/reference.tif", BEGUN, folder=folder) as served:
        return [_edit(Tab(browser, served.address), folder / BEGUN, edit) for edit in edits]


def _edit(tab: Tab, case: Path, edit: tuple[str, str, str, str, str]) -> Row:
    """Make one change in a new tab, which begins with the file as it is; the file is as before afterwards."""
    what, shape, box, typed, key = edit
    if shape:
        tab.choose("Drawn", shape)
        # What is typed ends as the points of the shape do.
        wait_until(lambda: tab.read(box).endswith(typed.rpartition(",")[2]), "the points of the shape")
    tab.fill(box, typed)
    wait_until(lambda: tab.read(BEGUN) != EXISTING, "the change in the text")
    tab.press("Write the case")
    wait_until(lambda: case.read_text(encoding="utf-8") != EXISTING, "the case is written")
    tab.close()
    before, after = (text.splitlines() for text in (EXISTING, case.read_text(encoding="utf-8")))
    differing = [line for line in ndiff(before, after) if line.startswith(("-", "+"))]
    case.write_text(EXISTING, encoding="utf-8")
    holds = len(differing) == 2 and all(key in line for line in differing)
    return Row(f"a case of {len(before)} lines with comments, in which {what} is changed on the page: lines of the "
               "file that differ", "that line alone", " | ".join(" ".join(line.split()) for line in differing), holds)
