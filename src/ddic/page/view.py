"""The page of ``ddic view``: fields over their images, values under the pointer, profiles and curves, exports."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from functools import partial
from html import escape
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    CheckboxGroup,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    Div,
    LayoutDOM,
    LinearColorMapper,
    NumericInput,
    PrintfTickFormatter,
    Select,
    Slider,
)
from bokeh.plotting import figure

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.io.image_file import open_image
from ddic.io.result_reader import Result
from ddic.mesh.interpolation import CellSearch
from ddic.mesh.mesh import Mesh
from ddic.page.case_text import Point
from ddic.page.clicks import AT_REST, NOTHING, ClickDrawer
from ddic.page.frames import (
    BY_NAME,
    FIELDS,
    FieldChoice,
    Frames,
    describe_place,
    find_hatched,
    find_image_size,
    measure_difference,
    move_back,
    move_mesh,
)
from ddic.page.image_pane import ImagePane, Rgba, ScreenImage, ScreenRaster
from ddic.page.layers import Overlay, draw_field, draw_hatching, list_colours
from ddic.page.probe_box import FORMS, ProbeBox, ProbeReadings
from ddic.plots import canvas, figures, maps
from ddic.probes.probes import Probe
from ddic.probes.tables import write_probe_table

DIFFERENCE = "difference"
MOVED, HATCHED = "over the deformed image", "hatch excluded and doubtful cells"
PALETTES = ("viridis", "cividis", "magma", "turbo", "RdBu_r", "gray")
FORMATS = ("png", "svg", "pdf")

EXCLUDED_COLOUR, DOUBTFUL_COLOUR = (0, 0, 0), (255, 255, 255)
"""Of the hatching."""

SIDE_OF_ONE, SIDE_OF_TWO = 700, 560
"""Of an image by itself, and of two side by side, pixels of the screen."""

MOST_IMAGES = 4
"""Images that are kept: each takes a few megabytes, or all of itself where its file cannot be read by windows."""

DOWNLOAD = """
const [name, base64] = file.tags;
const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const link = document.createElement("a");
link.href = URL.createObjectURL(new Blob([bytes]));
link.download = name;
link.click();
"""
"""Has the browser save what the tags of a model hold."""


class _FieldPane:
    """One result, or the difference of two, in colour over an image.

    Parameters
    ----------
    page : _ViewPage
        Whose field, frame and colours it shows.
    image : ScreenImage
        Beneath.
    side : int
        The longer one, pixels of the screen.
    name : str
        Of the figure in the browser's document.
    """

    def __init__(self, page: _ViewPage, image: ScreenImage, side: int, name: str) -> None:
        self._page = page
        self.frames: Frames | None = None
        self.subtracted: Frames | None = None
        self._raster: ScreenRaster | None = None
        self._overlay: Overlay | None = None
        self._search: CellSearch | None = None
        self._searched: tuple[Result, bool] | None = None
        self.pane = ImagePane(image, [self._draw], side, name)
        self._colours = LinearColorMapper(palette=["#000000"], low=0.0, high=1.0, name="")
        # Numbers padded with blanks: room for those that come later.
        self._bar = ColorBar(color_mapper=self._colours, title="", width=12,
                             formatter=PrintfTickFormatter(format="%-9.3g"))
        self.pane.figure.add_layout(self._bar, "right")
        self.pane.send_pointer(lambda x, y: page.tell_of_pointer(self, (x, y)))

    def _find_search(self, result: Result) -> CellSearch:
        """The cells where they are seen, sorted; they stay so over frames of one mesh."""
        asked = result, self._page.is_moved
        if self._search is None or self._searched != asked:
            mesh = move_mesh(result) if self._page.is_moved else result.mesh
            if self._search is None or not _is_same(self._search.mesh, mesh):
                self._search, self._overlay = CellSearch(mesh), None
            self._searched = asked
        return self._search

    def _find_overlay(self, result: Result, raster: ScreenRaster) -> Overlay:
        """Where the screen's pixels lie in a mesh; kept as long as neither changes."""
        search = self._find_search(result)
        if self._overlay is None or self._raster is not raster:
            self._raster, self._overlay = raster, Overlay.find(search, raster)
        return self._overlay

    def _draw(self, rgba: Rgba, raster: ScreenRaster) -> None:
        page = self._page
        if self.frames is None:
            return
        result = self.frames[page.number]
        values = page.field.find_values(result)
        if values is not None and self.subtracted is not None:
            values = measure_difference(values, result.mesh, page.field, self.subtracted[page.number])
        if values is None:
            self._bar.title = f"{page.field.name}: not in this result"
            return
        overlay = self._find_overlay(result, raster)
        limits = page.scale.find_limits(values.values)
        draw_field(rgba, overlay.interpolate(values.values, by_cell=values.by_cell), limits, page.palette)
        if page.hatches:
            excluded, doubtful = find_hatched(result)
            draw_hatching(rgba, overlay.find_pixels(excluded), EXCLUDED_COLOUR)
            draw_hatching(rgba, overlay.find_pixels(doubtful), DOUBTFUL_COLOUR)
        if self._colours.name != page.palette:
            # 256 texts, sent once.
            palette = ["#{:02x}{:02x}{:02x}".format(*colour) for colour in list_colours(page.palette)]
            self._colours.update(palette=palette, name=page.palette)
        self._colours.update(low=limits[0], high=limits[1])
        self._bar.title = _write_plainly(page.scale.format_label(values.label))

    def describe(self, place: Point) -> str:
        """Say what the result measured that is seen at a place."""
        if self.frames is None:
            return ""
        result = self.frames[self._page.number]
        return describe_place(result, self._find_search(result), place, is_moved=self._page.is_moved)

    def show(self, frames: Frames | None, subtracted: Frames | None = None) -> None:
        """Have another result shown, or one less another."""
        self.frames, self.subtracted = frames, subtracted
        self.pane.figure.visible = frames is not None


def _is_same(one: Mesh, other: Mesh) -> bool:
    return one is other or (np.array_equal(one.nodes, other.nodes) and np.array_equal(one.types, other.types)
                            and np.array_equal(one.connectivity, other.connectivity))


def _write_plainly(label: str) -> str:
    """A label of matplotlib without its TeX, which the browser does not set."""
    for tex, plain in ((r"\varepsilon", "ε"), (r"\sigma", "σ"), (r"\Vert", "|"), (r"\|", "|"), ("$", ""), ("{", ""),
                       ("}", ""), ("\\", "")):
        label = label.replace(tex, plain)
    return label


class _ViewPage:
    """One tab of ``ddic view``.

    Parameters
    ----------
    results : sequence of Frames
        Of images of one size.
    probes : list of Probe
        To begin with.
    document : Document
        The tab.
    """

    def __init__(self, results: Sequence[Frames], probes: list[Probe], document: Document) -> None:
        self._results = {_name(frames, results): frames for frames in results}
        self._names = list(self._results)
        first = results[0]
        self._images: dict[Path, ScreenImage] = {}
        self.number = 0
        self._make_controls(first)
        self._make_readings(probes, document)
        self._make_exports()
        side = SIDE_OF_TWO if len(results) > 1 else SIDE_OF_ONE
        blank = self._find_background(first)
        self._left = _FieldPane(self, blank, side, "field")
        self._panes = [self._left]
        if len(results) > 1:
            right = _FieldPane(self, blank, side, "beside")
            right.pane.share_view(self._left.pane)
            self._panes.append(right)
        for shown in self._panes:
            self.probes.show_on(shown.pane)
        self.drawer = ClickDrawer(self._left.pane, FORMS, self._take, AT_REST)
        self._choose_results()

    def _make_controls(self, first: Frames) -> None:
        names = self._names
        self.left = Select(title="Result", options=names, value=names[0], width=260)
        self.right = Select(title="Beside it", options=[NOTHING, *names, DIFFERENCE], width=260,
                            value=names[1] if len(names) > 1 else NOTHING, visible=len(names) > 1)
        self.choice = Select(title="Field", options=first.list_fields(), value=FIELDS[0].name)
        self.colours = Select(title="Colours", options=list(PALETTES), value=PALETTES[0], width=110)
        self.low = NumericInput(title="from (empty: percentile)", mode="float", width=145)
        self.high = NumericInput(title="to", mode="float", width=105)
        self.low_share = NumericInput(title="percentiles", mode="float", value=canvas.PERCENTILES[0], width=75)
        self.high_share = NumericInput(title="and", mode="float", value=canvas.PERCENTILES[1], width=75)
        self.shown = CheckboxGroup(labels=[MOVED, HATCHED], active=[1])
        n_frames = max(len(frames) for frames in self._results.values())
        self.slider = Slider(title="Frame", start=1, end=max(n_frames, 2), value=1, step=1, width=430,
                             visible=n_frames > 1)
        for control in (self.left, self.right):
            control.on_change("value", lambda attribute, old, new: self._choose_results())
        for control in (self.choice, self.colours, self.low, self.high, self.low_share, self.high_share):
            control.on_change("value", lambda attribute, old, new: self._draw())
        self.shown.on_change("active", lambda attribute, old, new: self._show_images())
        self.slider.on_change("value", lambda attribute, old, new: self._change_frame(new))

    def _make_readings(self, probes: list[Probe], document: Document) -> None:
        self.told = Div(width=900)
        self.values = Div(width=900, styles={"font-family": "monospace"})
        self.probes = ProbeBox(probes, self._tell_of, self._move_probes)
        self.readings = ProbeReadings(document)
        self.convergence = figure(width=380, height=260, y_axis_type="log", toolbar_location=None,
                                  x_axis_label="iteration of Gauss-Newton", y_axis_label="correction [px]")
        self._steps = ColumnDataSource({"x": [], "y": []})
        self.convergence.line("x", "y", source=self._steps)
        self.convergence.scatter("x", "y", source=self._steps)

    def _make_exports(self) -> None:
        self._file = Div(visible=False)
        self._file.js_on_change("tags", CustomJS(args={"file": self._file}, code=DOWNLOAD))
        self.exports = [Button(label=ending.upper(), width=60) for ending in FORMATS]
        for button, ending in zip(self.exports, FORMATS, strict=True):
            button.on_click(partial(self._export_figure, ending))
        self.table = Button(label="CSV of the probes", width=140)
        self.table.on_click(self._export_table)

    @property
    def layout(self) -> LayoutDOM:
        """What the tab shows."""
        right = column(
            row(self.left, self.right), row(self.choice, self.colours),
            row(self.low, self.high, self.low_share, self.high_share), self.shown, self.slider,
            row(self.drawer.choice, self.readings.quantity), self.drawer.hint, self.probes.text,
            row(*self.exports, self.table, self._file))
        panes = row(*(shown.pane.figure for shown in self._panes))
        # Curves have all of the width: beside the controls they would push these off a narrow screen.
        below = row(self.readings.profile, self.readings.curves, self.convergence, styles={"flex-wrap": "wrap"},
                    width_policy="max")
        return column(self.told, row(column(panes, self.values, self.readings.table), right), below, width_policy="max")

    # What the controls say.

    @property
    def field(self) -> FieldChoice:
        """The field that is looked at."""
        return BY_NAME[self.choice.value]

    @property
    def palette(self) -> str:
        """Name of its colours."""
        return str(self.colours.value)

    @property
    def is_moved(self) -> bool:
        """Whether it lies over the deformed image."""
        return 0 in self.shown.active

    @property
    def hatches(self) -> bool:
        """Whether cells that say little are hatched."""
        return 1 in self.shown.active

    @property
    def scale(self) -> canvas.ColourScale:
        """Where its colours begin and end: where both limits are given there, else at percentiles."""
        low, high = self.low.value, self.high.value
        limits = (low, high) if low is not None and high is not None and low < high else None
        shares = self.low_share.value, self.high_share.value
        is_interval = None not in shares and 0.0 <= shares[0] < shares[1] <= 100.0
        return canvas.ColourScale(limits, shares if is_interval else canvas.PERCENTILES, self.palette)

    # What changes.

    def _choose_results(self) -> None:
        left = self._results[self.left.value]
        self._left.show(left)
        fields = left.list_fields()
        self.choice.options = fields
        if self.choice.value not in fields:
            self.choice.value = fields[0]
        if len(self._panes) > 1 and self.right.value == DIFFERENCE:
            # From the first of the others.
            other = next(frames for frames in self._results.values() if frames is not left)
            self._panes[1].show(left, other)
        elif len(self._panes) > 1:
            self._panes[1].show(self._results.get(self.right.value))
        self._show_images()
        self._tell()

    def _change_frame(self, number: int) -> None:
        self.number = number - 1
        self._show_images()
        self._tell()

    def _show_images(self) -> None:
        """Show the image of each pane's frame, and its field."""
        self.probes.draw()
        for shown in self._panes:
            if shown.frames is not None:
                shown.pane.show_image(self._find_background(shown.frames))

    def _find_background(self, frames: Frames) -> ScreenImage:
        """The image that a frame's field lies over; a grey one where that cannot be read any more."""
        result = frames[self.number]
        path = figures.find_image(result, "deformed" if self.is_moved else "reference") or Path()
        if path not in self._images:
            try:
                self._images[path] = ScreenImage.open(path)
            except InputError:
                self._images[path] = ScreenImage.make_blank(*find_image_size(result))
            # Of a long series the images last looked at.
            for other in list(self._images)[:-MOST_IMAGES]:
                del self._images[other]
        return self._images[path]

    def _draw(self) -> None:
        for shown in self._panes:
            shown.pane.draw()

    def _tell(self) -> None:
        """Name what is shown, with its verdict; its convergence and what the probes read."""
        frames = self._results[self.left.value]
        self.told.text = f"<b>{escape(frames.describe_frame(self.number))}</b>"
        self._read_probes()
        corrections = frames[self.number].gauss_newton.get("rms_correction_px", np.zeros(0))
        self._steps.data = {"x": np.arange(1, len(corrections) + 1), "y": corrections}

    def tell_of_pointer(self, shown: _FieldPane, place: Point) -> None:
        """Say what was measured under the pointer, and of which result where there are several."""
        name = f"{shown.frames.path.name}: " if shown.frames is not None and len(self._panes) > 1 else ""
        self.values.text = escape(f"{name}{shown.describe(place)}")

    @property
    def _result(self) -> Result:
        return self._results[self.left.value][self.number]

    def _move_probes(self, points: Array) -> Array:
        """Where points of the reference image are seen; where that is not known, where they were."""
        moved = points + self._result.at(points) if self.is_moved else points
        return np.where(np.isfinite(moved), moved, points)

    def _take(self, name: str, points: list[Point]) -> None:
        try:
            places = move_back(self._result, points) if self.is_moved else points
        except InputError as error:
            self._tell_of(list(error.problems))
            return
        self.probes.add(name, [self.drawer.round_point(place) for place in places])

    def _tell_of(self, problems: list[str]) -> None:
        if problems:
            self.values.text = escape("; ".join(problems))
        else:
            self._read_probes()

    def _read_probes(self) -> None:
        self.readings.show(self._results[self.left.value], self.probes.probes, self.number)

    # What leaves the page.

    def _export_figure(self, ending: str) -> None:
        """The field as ``ddic plot`` draws it, with the limits and colours of the page."""
        frames, result, field = self._results[self.left.value], self._result, self.field
        path = figures.find_image(result)
        try:
            preview = None if path is None else maps.read_preview(open_image(path))
        except InputError as error:
            self._tell_of(list(error.problems))
            return
        look = figures.Look(field.component, maps.StrainChoice(number=field.number),
                            unit=canvas.find_length_unit(result), scale=self.scale)
        drawn = figures.draw(field.kind, figures.Drawing(result, None, look, preview))
        stream = BytesIO()
        drawn.savefig(stream, format=ending, dpi=canvas.DPI)
        name = f"{frames.path.stem}{frames.format_frame(self.number, '.frame_')}.{field.name.replace(' ', '_')}"
        self._send(f"{name}.{ending}", stream.getvalue())

    def _export_table(self) -> None:
        with TemporaryDirectory() as folder:
            table = Path(folder) / "probes.csv"
            frames = self._results[self.left.value]
            write_probe_table(table, self.readings.gather(frames, self.probes.probes))
            self._send(f"{frames.path.stem}.probes.csv", table.read_bytes())

    def _send(self, name: str, content: bytes) -> None:
        """Have the browser save a file."""
        self._file.tags = [name, b64encode(content).decode("ascii")]


def _name(frames: Frames, among: Sequence[Frames]) -> str:
    """A result's file, with its folder where several have the same name."""
    is_alone = [other.path.name for other in among].count(frames.path.name) == 1
    return frames.path.name if is_alone else str(frames.path)


def open_results(paths: Sequence[Path]) -> list[Frames]:
    """Open results to be looked at; raises InputError where one cannot be read, or their images differ in size."""
    opened = [Frames(path) for path in dict.fromkeys(paths)]
    of_volumes = [path for path, frames in zip(dict.fromkeys(paths), opened, strict=True) if frames[0].mesh.dim == 3]
    if of_volumes:
        raise InputError(f"{of_volumes[0]}: of a volume: look at it by ddic plot, or in ParaView")
    sizes = sorted({find_image_size(frames[0]) for frames in opened})
    if len(sizes) > 1:
        raise InputError(f"{paths[0]}, ...: of images of {' and '.join(f'{x} x {y}' for x, y in sizes)} px, which "
                         "cannot be looked at side by side; give results of one size")
    return opened


def show_results(paths: Sequence[Path], probes: list[Probe], document: Document) -> LayoutDOM:
    """Lay out a view of results; raises InputError as ``open_results`` does."""
    return _ViewPage(open_results(paths), probes, document).layout


def make_view_page(paths: Sequence[Path], probes: list[Probe], document: Document) -> None:
    """Fill a tab of the browser with the page of ``ddic view``."""
    document.title = f"ddic view {paths[0].name}"
    document.add_root(show_results(paths, probes, document))
