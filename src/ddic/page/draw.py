"""The page of ``ddic draw``: a case drawn on its reference image, checked as it grows, written, and run."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from html import escape
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    CheckboxGroup,
    ColumnDataSource,
    Div,
    NumericInput,
    PointDrawTool,
    Select,
    TabPanel,
    Tabs,
    TextAreaInput,
    TextInput,
)
from tomlkit.exceptions import TOMLKitError

from ddic.case.loader import load_text_leniently
from ddic.errors import InputError
from ddic.io.result_schema import not_converged_path
from ddic.mesh.grid import GridLines
from ddic.page.case_run import RunBox
from ddic.page.case_text import (
    BY_GMSH,
    BY_NAME,
    CLICKS,
    DEFORMED,
    FEWEST,
    MESH,
    Kind,
    Point,
    Shape,
    find_keys,
    find_place,
    list_shapes,
    remove_shape,
    set_mesh,
    set_shape,
    set_value,
)
from ddic.page.clicks import AT_REST, ClickDrawer
from ddic.page.drawn_case import CaseFile, Checked, DrawnCase, check_text, find_mask_outline
from ddic.page.image_pane import ImagePane, Rgba, ScreenRaster
from ddic.page.layers import draw_dots, draw_edges, draw_field, find_cell_centres, find_nodes_in_sight
from ddic.page.probe_box import FORMS, ProbeBox
from ddic.page.view import show_results
from ddic.probes.probes import parse_probes

PROBES = ".probes.toml"
"""In place of the suffix of the case: the file of its probes."""

EDGES, TEXTURE, WEAK = "mesh", "texture by element", "nodes of weak texture"

STRENGTHS = (-2.0, 1.0)
"""Decimal logarithms of the texture that colours show, where 0 is that of most of the pattern."""

HANDLES = f"{AT_REST}; with the tool that moves points, above it, dragging moves the yellow corners"

OF_SIZE = "Of elements; the line 'pattern' below says what the image asks for."
OF_WAVELENGTH = "Empty: no regularization. 3 to 5 elements are usual; ddic sweep recommends one for a case."

WRONG, DOUBTFUL, DONE = "#b00020", "#8a5a00", "#1b6e20"
"""Colours of what is told."""


class _DrawPage:
    """One tab of ``ddic draw``.

    Parameters
    ----------
    drawn : DrawnCase
        What is drawn on, the same for all tabs.
    document : Document
        The tab.
    """

    def __init__(self, drawn: DrawnCase, document: Document) -> None:
        self._drawn, self._document = drawn, document
        self._checked = Checked(None, None, None, [])
        self._outline = np.zeros((0, 2))
        self._file, self._probes_file = CaseFile(drawn.path), CaseFile(drawn.path.with_suffix(PROBES))
        self._undone: list[tuple[TextAreaInput, str]] = []
        self._worker = ThreadPoolExecutor(1)
        # Checks, by number: of the text as it is, and the one that is shown.
        self._n_asked, self._n_shown = 0, 0
        self.pane = ImagePane(drawn.image, [self._draw])
        # What the text says, or said before it was broken.
        self._data: dict[str, Any] = {}
        self._shapes: dict[str, Shape] = {}
        self._make_controls()
        self.probes.text.value = self._probes_file.text or ""
        for area in (self.text, self.probes.text):
            area.on_change("value", partial(self._keep, area))
        # At once: the check of a large case takes seconds.
        self.pane.draw()
        self._follow_text()
        document.on_session_destroyed(lambda context: self._worker.shutdown(wait=False))

    def _make_controls(self) -> None:
        self._lines = ColumnDataSource({"xs": [], "ys": []})
        self.pane.figure.multi_line("xs", "ys", source=self._lines, color="#ffd040", line_width=2)
        self._handles = ColumnDataSource({"x": [], "y": []})
        handles = self.pane.figure.scatter("x", "y", source=self._handles, color="#ffd040", marker="square", size=9)
        self.pane.figure.add_tools(PointDrawTool(renderers=[handles], add=False, description="Move the points drawn"))
        self._handles.on_change("data", lambda attribute, old, new: self._move_points())
        self._wave = ColumnDataSource({"x": [], "y": [], "x1": [], "text": []})
        self.pane.figure.segment("x", "y", "x1", "y", source=self._wave, color="#40ff80", line_width=4)
        self.pane.figure.text("x", "y", "text", source=self._wave, color="#40ff80", y_offset=-6,
                              text_font_size="13px")
        self.probes = ProbeBox([], self._tell)
        self.probes.show_on(self.pane)
        forms = {kind.name: (FEWEST[kind.form], kind.form in ("polygon", "line"), CLICKS[kind.form])
                 for kind in BY_NAME.values()}
        self.drawer = ClickDrawer(self.pane, {**forms, **FORMS}, self._take, HANDLES, self._snap)
        begun = self._drawn.text if self._file.text is None else self._file.text
        self.text = TextAreaInput(title=str(self._drawn.path), value=begun, rows=22, width=430, max_length=None,
                                  stylesheets=["textarea { font-family: monospace; white-space: pre; }"])
        self.text.on_change("value", lambda attribute, old, new: self._follow_text())
        self.deformed = TextInput(title="Deformed images: one; a.tif, b.tif; or a pattern, zoom-*.tif", width=430)
        self.chosen = Select(title="Drawn", options=[], value="")
        self.numbers = TextInput(title="Its points: x, y; x, y; ... (px)", width=430)
        self.remove = Button(label="Remove")
        self.undo = Button(label="Undo")
        self.mesh = Select(title="Mesh", options=[(MESH[1], "regular"), (BY_GMSH[1], "by gmsh")], width=100)
        self.element_size = NumericInput(title="Element size (px)", mode="float", width=130, description=OF_SIZE)
        self.wavelength = NumericInput(title="Cut-off wavelength (px)", mode="float", width=150,
                                       description=OF_WAVELENGTH)
        self.shown = CheckboxGroup(labels=[EDGES, TEXTURE, WEAK], active=[0], inline=True)
        self.messages = Div(width=430)
        self.write = Button(label="Write the case", button_type="primary")
        self.running = RunBox(self._drawn.run, self._document, self._write_to_run, self._open_result, self._tell)
        self.deformed.on_change("value", lambda attribute, old, new: self._name_deformed(new))
        self.chosen.on_change("value", lambda attribute, old, new: self._show_numbers())
        self.numbers.on_change("value", lambda attribute, old, new: self._type_numbers(new))
        self.remove.on_click(self._remove)
        self.undo.on_click(self._undo)
        self.mesh.on_change("value", lambda attribute, old, new: self._choose_mesh(new))
        for box, keys in ((self.element_size, (*MESH, "element_size")),
                          (self.wavelength, ("regularization", "cut_off_wavelength"))):
            box.on_change("value", partial(self._set_number, keys))
        self.shown.on_change("active", lambda attribute, old, new: self.pane.draw())
        self.write.on_click(self._write)

    @property
    def layout(self) -> Tabs:
        """What the tab shows."""
        right = column(
            self.deformed,
            row(self.drawer.choice, column(self.drawer.finish, self.undo)), self.drawer.hint,
            row(self.chosen, self.remove), self.numbers,
            row(self.mesh, self.element_size, self.wavelength), self.shown,
            row(self.write, *self.running.controls), self.running.log, self.messages)
        # Texts go below the image where the screen is narrow.
        drawing = row(column(self.pane.figure), right, column(self.text, self.probes.text),
                      styles={"flex-wrap": "wrap"}, width_policy="max")
        self._tabs = Tabs(tabs=[TabPanel(title="Draw", child=drawing)], width_policy="max")
        return self._tabs

    # What is clicked or typed changes the text, and all else follows from that.

    def _keep(self, area: TextAreaInput, attribute: str, old: str, new: str) -> None:
        self._undone.append((area, old))

    def _undo(self) -> None:
        """Take back the last click of a shape that is not whole, or the last change of the case or the probes."""
        if self.drawer.take_back() or not self._undone:
            return
        area, before = self._undone.pop()
        area.value = before
        # The change itself is no step back.
        self._undone.pop()

    def _take(self, name: str, points: list[Point]) -> None:
        if name in FORMS:
            self.probes.add(name, points)
            return
        kind = BY_NAME[name]
        self._change(lambda text: set_shape(text, self._make_shape(kind, points, find_place(text, kind))))

    def _remove(self) -> None:
        shape = self._shapes.get(self.chosen.value)
        if shape is not None:
            self._change(lambda text: remove_shape(text, shape))

    def _type_numbers(self, typed: str) -> None:
        shape = self._shapes.get(self.chosen.value)
        if shape is None or typed == _write_points(shape):
            return
        try:
            points = _read_points(typed, FEWEST[shape.kind.form])
        except InputError as error:
            self._tell(error.problems)
            return
        self._change(lambda text: set_shape(text, replace(shape, vertices=points)))

    def _move_points(self) -> None:
        """Take over the points of the shape that were dragged."""
        shape = self._shapes.get(self.chosen.value)
        points = [(float(x), float(y)) for x, y in zip(*map(self._handles.data.get, "xy"), strict=True)]
        if shape is None or tuple(points) == shape.vertices:
            return
        if len(points) != len(shape.vertices):
            # One was taken out, which no text says.
            self._show_numbers()
            return
        moved = [point if point == before else self.drawer.round_point(point)
                 for point, before in zip(points, shape.vertices, strict=True)]
        changed = self._make_shape(shape.kind, moved, shape.place)
        if shape.kind.form == "circle" and moved[0] != shape.vertices[0]:
            # The rim goes with the centre.
            (x, y), (x0, y0), (x1, y1) = moved[0], *shape.vertices
            changed = replace(shape, vertices=((x, y), (x + x1 - x0, y + y1 - y0)))
        self._change(lambda text: set_shape(text, changed))

    def _make_shape(self, kind: Kind, points: Sequence[Point], place: int) -> Shape:
        """Make a shape of what was clicked; the radius of a circle has the digits of the screen, too."""
        if kind.form == "circle":
            (x, y), rim = points
            radius, _ = self.drawer.round_point((math.dist((x, y), rim), 0.0))
            points = [(x, y), (x + radius, y)]
        return Shape(kind, tuple(points), place)

    def _set_number(self, keys: tuple[str, ...], attribute: str, old: float | None, new: float | None) -> None:
        if new != _find_number(self._data, keys):
            self._change(lambda text: set_value(text, keys, new))

    def _name_deformed(self, typed: str) -> None:
        if typed != format_deformed(self._data):
            names = [name.strip() for name in typed.split(",") if name.strip()]
            self._change(lambda text: set_value(text, DEFORMED, names[0] if len(names) == 1 else names))

    def _choose_mesh(self, name: str) -> None:
        if name != find_mesh(self._data):
            self._change(lambda text: set_mesh(text, name))

    def _change(self, change: Callable[[str], str]) -> None:
        try:
            self.text.value = change(self.text.value)
        except (InputError, TOMLKitError) as error:
            self._show_keys()
            why = error if isinstance(error, InputError) else "not valid TOML; correct the text first"
            self._tell([f"{self._drawn.path}: {why}"])

    def _show_keys(self) -> None:
        """Show in the boxes what the text says."""
        self.deformed.value = format_deformed(self._data)
        self.mesh.value = find_mesh(self._data)
        self.element_size.value = _find_number(self._data, (*MESH, "element_size"))
        self.wavelength.value = _find_number(self._data, ("regularization", "cut_off_wavelength"))

    def _follow_text(self) -> None:
        """Draw what the text says, and have it checked; of texts that follow one another fast, the last one."""
        text = self.text.value
        with suppress(ValueError, RecursionError):
            self._data = tomllib.loads(text)
        self._shapes = {shape.name: shape for shape in list_shapes(self._data)}
        outlines = [shape.outline for shape in self._shapes.values()]
        self._lines.data = {"xs": [outline[:, 0].tolist() for outline in outlines],
                            "ys": [outline[:, 1].tolist() for outline in outlines]}
        self.chosen.options = list(self._shapes)
        if self.chosen.value not in self._shapes:
            self.chosen.value = next(iter(self._shapes), "")
        self._show_numbers()
        self._show_keys()
        self._n_asked += 1
        self._worker.submit(self._check, self._n_asked, text)

    def _check(self, number: int, text: str) -> None:
        """Check a text beside the page, unless another one was asked for since."""
        if number == self._n_asked:
            try:
                checked = check_text(text, self._drawn)
            except Exception as error:
                checked = Checked(None, None, None, [f"{type(error).__name__}: {error}"])
            self._document.add_next_tick_callback(partial(self._show_checked, number, checked))

    # What was found is shown.

    def _show_checked(self, number: int, checked: Checked) -> None:
        if number != self._n_asked:
            return
        self._n_shown, self._checked = number, checked
        self._outline = find_mask_outline(checked.loaded, self._drawn.image)
        self._show_wavelength()
        self.pane.draw()
        self._tell(checked.problems)

    def _tell(self, problems: Sequence[str], done: Sequence[str] = ()) -> None:
        """Say what is wrong, or what was done and what the check found."""
        problems = problems or self._checked.problems
        lines = [] if problems or self._checked.report is None else self._checked.report.list_lines()
        rows = "".join(f"<tr><td><b>{escape(name)}</b></td><td>{escape(value)}</td></tr>" for name, value in lines)
        told = {WRONG: problems, DONE: done, DOUBTFUL: self._checked.warnings}
        texts = [f'<div style="color: {colour}">{"<br>".join(map(escape, said))}</div>'
                 for colour, said in told.items() if said]
        self.messages.text = "".join(texts) + f"<table>{rows}</table>"

    def _show_wavelength(self) -> None:
        """The cut-off wavelength to scale, at the upper left corner of the mesh."""
        mesh, loaded = self._checked.mesh, self._checked.loaded
        section = None if loaded is None else loaded.case.regularization
        wavelength = None if section is None else section.cut_off_wavelength
        if mesh is None or wavelength is None:
            self._wave.data = {"x": [], "y": [], "x1": [], "text": []}
            return
        x, y = mesh.box[:2] if isinstance(mesh, GridLines) else mesh.nodes.min(axis=0).tolist()
        self._wave.data = {"x": [x], "y": [y], "x1": [x + wavelength], "text": [f"l_c = {wavelength:g} px"]}

    def _get_shown(self) -> list[str]:
        return [self.shown.labels[number] for number in self.shown.active]

    def _draw(self, rgba: Rgba, raster: ScreenRaster) -> None:
        mesh = self._checked.mesh
        if mesh is None or not mesh.n_cells:
            return
        pattern = self._drawn.pattern
        if TEXTURE in self._get_shown():
            strength = pattern.find_strength(find_cell_centres(mesh, raster))
            draw_field(rgba, np.log10(np.maximum(strength, 1e-12)), STRENGTHS, "RdYlGn")
        if EDGES in self._get_shown():
            draw_edges(rgba, raster, mesh, self._checked.outline, (90, 200, 255))
        if WEAK in self._get_shown():
            nodes = find_nodes_in_sight(mesh, raster)
            draw_dots(rgba, raster, nodes[pattern.find_bare(nodes)], (255, 48, 48))

    def _show_numbers(self) -> None:
        shape = self._shapes.get(self.chosen.value)
        self.numbers.value = "" if shape is None else _write_points(shape)
        x, y = ([], []) if shape is None else zip(*shape.vertices, strict=True)
        self._handles.data = {"x": list(x), "y": list(y)}

    def _snap(self, point: Point, within: float) -> Point:
        """Move a point onto the outline of the mesh's mask where that is near."""
        if not len(self._outline):
            return point
        distance = np.linalg.norm(self._outline - point, axis=1)
        nearest = int(distance.argmin())
        x, y = self._outline[nearest].tolist()
        return (x, y) if distance[nearest] <= within else point

    # The case is written and run.

    def _write(self) -> bool:
        """Write the file, and the probes beside it; return whether they hold the texts."""
        path, probes = self._file.path, self._probes_file.path
        done = [f"the case was written to {path.absolute()}"]
        try:
            n_probes = len(parse_probes(self.probes.text.value, probes))
            self._file.write(self.text.value)
            if self.probes.text.value != (self._probes_file.text or ""):
                self._probes_file.write(self.probes.text.value)
                done.append(f"the probes ({n_probes}) were written to {probes.absolute()}, for ddic probe and "
                            f"ddic view by --probes {probes.name}")
        except (InputError, OSError) as error:
            self._tell([str(error)])
            return False
        self._tell([], done)
        return True

    def _write_to_run(self) -> bool:
        """Write the files of a case in which nothing is known to be wrong; return whether they hold the texts."""
        if self._n_shown != self._n_asked:
            self._tell(["the case is being checked; run it in a moment"])
            return False
        return not self._checked.problems and self._write()

    def _open_result(self) -> None:
        """Show what was measured in a tab beside the drawing, also where it was stopped or did not converge."""
        loaded, _ = load_text_leniently(self._file.text or "", self._drawn.path)
        files = [] if loaded is None else [loaded.case.output.file, not_converged_path(loaded.case.output.file)]
        written = [file for file in files if file.exists() and file.stat().st_mtime >= self._drawn.run.start_time]
        if not written:
            return
        try:
            layout = show_results(written[:1], self.probes.probes, self._document)
        except InputError as error:
            self._tell(error.problems)
            return
        self._tabs.tabs = [self._tabs.tabs[0], TabPanel(title="Result", child=layout)]
        self._tabs.active = 1


def format_deformed(data: Mapping[str, Any]) -> str:
    """Format the deformed images of a case as they are typed."""
    given = _look_up(data, DEFORMED, "")
    return ", ".join(map(str, given)) if isinstance(given, list) else str(given)


def find_mesh(data: Mapping[str, Any]) -> str:
    """Name the section of the region that is meshed; empty where there is none."""
    keys = find_keys(MESH, data)
    return keys[1] if _look_up(data, keys, None) is not None else ""


def _find_number(data: Any, keys: tuple[str, ...]) -> float | None:
    """A number of a parsed case; None where there is none."""
    number = _look_up(data, find_keys(keys, data), None)
    try:
        return float(number) if isinstance(number, int | float) and not isinstance(number, bool) else None
    except OverflowError:
        return None


def _look_up(data: Any, keys: tuple[str, ...], nothing: Any) -> Any:
    """What a parsed case holds under a key; ``nothing`` where it has none."""
    for key in keys:
        data = data.get(key, nothing) if isinstance(data, Mapping) else nothing
    return data


def _write_points(shape: Shape) -> str:
    return "; ".join(f"{x:.12g}, {y:.12g}" for x, y in shape.vertices)


def _read_points(typed: str, fewest: int) -> tuple[Point, ...]:
    try:
        points = tuple((float(x), float(y)) for x, y in (pair.split(",") for pair in typed.split(";") if pair.strip()))
    except ValueError:
        points = ()
    if len(points) < fewest or not np.isfinite(points).all():
        raise InputError(f"{typed}: {fewest} points or more expected, as x, y; x, y; ...")
    return points


def make_draw_page(drawn: DrawnCase, document: Document) -> None:
    """Fill a tab of the browser with the page of ``ddic draw``."""
    page = _DrawPage(drawn, document)
    document.title = f"ddic draw {drawn.path.name}"
    document.add_root(page.layout)
