"""Probes on a page: placed by clicks, as the text that ``ddic probe`` reads; what they read along lines and in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from html import escape
from pathlib import Path

import numpy as np
from bokeh.document import Document
from bokeh.models import ColumnDataSource, Div, Legend, LegendItem, Select, TextAreaInput
from bokeh.plotting import figure

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.page.case_text import Point
from ddic.page.frames import Frames, format_digits
from ddic.page.image_pane import ImagePane
from ddic.probes.probes import (
    KINDS,
    Extensometer,
    LineProbe,
    PointProbe,
    Probe,
    StrainGauge,
    format_probe,
    parse_probes,
)
from ddic.probes.tables import ProbeRecord, average_along, measure_probes

BOTH_ENDS = "click both ends"

FORMS = {
    "probe: point": (1, False, "click the point"),
    "probe: line": (2, False, BOTH_ENDS),
    "probe: extensometer": (2, False, BOTH_ENDS),
    "probe: gauge": (2, False, f"{BOTH_ENDS} of its length, along the strain to be measured: it is a square, which the "
                               "text can change"),
}

LINE_SPACING = 1.0
"""Between places along a line, pixels."""


class ProbeBox:
    """The text of the probes, and what it draws on panes.

    Parameters
    ----------
    probes : list of Probe
        To begin with.
    changed : callable
        Told of every change, with what is wrong with the text.
    move : callable or None
        Moves points of the reference image, (n, 2), pixels, to where they are seen.
    """

    def __init__(self, probes: list[Probe], changed: Callable[[list[str]], None],
                 move: Callable[[Array], Array] | None = None) -> None:
        self.probes = probes
        self._changed, self._move = changed, move
        self.text = TextAreaInput(title="Probes (a file for ddic probe --probes)", rows=7, width=430,
                                  value="\n".join(map(format_probe, probes)))
        self.text.on_change("value", lambda attribute, old, new: self._read())
        self._drawn = ColumnDataSource({"xs": [], "ys": [], "x": [], "y": [], "name": []})

    def show_on(self, pane: ImagePane) -> None:
        """Draw the probes over an image."""
        pane.figure.multi_line("xs", "ys", source=self._drawn, color="#40e0ff", line_width=2)
        pane.figure.scatter("x", "y", source=self._drawn, color="#40e0ff", size=6)
        pane.figure.text("x", "y", "name", source=self._drawn, color="#40e0ff", x_offset=6, y_offset=-4,
                         text_font_size="12px")

    def add(self, kind: str, points: list[Point]) -> None:
        """Add the probe that was clicked, under a name that is free."""
        kind = kind.removeprefix("probe: ")
        taken = {probe.name for probe in self.probes}
        name = next(name for name in (f"{kind}_{number}" for number in range(1, len(taken) + 2)) if name not in taken)
        try:
            section = format_probe(_make_probe(kind, name, points))
        except InputError as error:
            self._changed(list(error.problems))
            return
        self.text.value = f"{self.text.value.rstrip()}\n\n{section}".lstrip()

    def _read(self) -> None:
        try:
            self.probes = parse_probes(self.text.value, Path("probes"))
        except InputError as error:
            self._changed(list(error.problems))
            return
        self.draw()
        self._changed([])

    def draw(self) -> None:
        """Draw the probes, anew where they are seen elsewhere."""
        outlines = [make_outline(probe) for probe in self.probes]
        outlines = outlines if self._move is None else [self._move(outline) for outline in outlines]
        self._drawn.data = {
            "xs": [outline[:, 0].tolist() for outline in outlines],
            "ys": [outline[:, 1].tolist() for outline in outlines],
            "x": [float(outline[0, 0]) for outline in outlines], "y": [float(outline[0, 1]) for outline in outlines],
            "name": [probe.name for probe in self.probes]}


def _make_probe(kind: str, name: str, points: list[Point]) -> Probe:
    """The probe of a kind that was clicked."""
    if kind == KINDS[PointProbe]:
        return PointProbe(name, points[0])
    start, end = points
    if kind == KINDS[LineProbe]:
        return LineProbe(name, start, end, LINE_SPACING)
    if kind == KINDS[Extensometer]:
        return Extensometer(name, start, end)
    centre = ((start[0] + end[0]) / 2.0, (start[1] + end[1]) / 2.0)
    angle = math.degrees(math.atan2(end[1] - start[1], end[0] - start[0]))
    return StrainGauge(name, centre, round(math.dist(start, end), 2), angle=round(angle, 2))


def make_outline(probe: Probe) -> Array:
    """Outline a probe as it is drawn, (n, 2), pixels: its point, its line, or the rectangle of a gauge."""
    if isinstance(probe, PointProbe):
        return np.array([probe.point])
    if not isinstance(probe, StrainGauge):
        return np.array([probe.start, probe.end])
    along, across = 0.5 * probe.length * probe.axes[0], 0.5 * probe.across * probe.axes[1]
    corners = [along + across, along - across, -along - across, across - along, along + across]
    return np.asarray(probe.centre + np.array(corners))


QUANTITIES: dict[str, Callable[[ProbeRecord], Array]] = {
    "strain along": lambda record: record.reading.along,
    "strain xx": lambda record: record.reading.strain[:, 0],
    "strain yy": lambda record: record.reading.strain[:, 1],
    "strain xy": lambda record: record.reading.strain[:, 2],
    "u_x": lambda record: record.unit.size * record.reading.displacement[:, 0],
    "u_y": lambda record: record.unit.size * record.reading.displacement[:, 1],
}

COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")

MOST_MARKED = 60
"""Places up to which each has a mark; more of them make curves thick."""

OF_TABLE = ("u_x", "u_y", "strain xx", "strain yy", "strain xy", "strain along")


class ProbeReadings:
    """Reads probes on all frames of a result, each once, beside the page; shows them when they are there.

    Parameters
    ----------
    document : Document
        The tab.
    """

    def __init__(self, document: Document) -> None:
        self._document = document
        self._worker = ThreadPoolExecutor(1)
        self._known: dict[tuple[Frames, Probe], list[ProbeRecord]] = {}
        self._asked: tuple[Frames, Sequence[Probe], int] | None = None
        self.quantity = Select(title="Curve of", options=list(QUANTITIES), value=next(iter(QUANTITIES)), width=150)
        self.table = Div(width=760, styles={"white-space": "nowrap"})
        self.profile, self.curves = (
            figure(width=440, height=260, toolbar_location=None, tools="hover", name=name, visible=False)
            for name in ("profile", "curves"))
        self.quantity.on_change("value", lambda attribute, old, new: self._show_known())
        document.on_session_destroyed(lambda context: self._worker.shutdown(wait=False, cancel_futures=True))

    def show(self, frames: Frames, probes: Sequence[Probe], number: int) -> None:
        """Show what probes read on a frame, from 0, and on all others."""
        self._asked = frames, probes, number
        missing = [probe for probe in probes if (frames, probe) not in self._known]
        if missing:
            self.table.text = "reading ..."
            self._worker.submit(self._read, frames, missing)
        else:
            self._show_known()

    def gather(self, frames: Frames, probes: Sequence[Probe]) -> list[ProbeRecord]:
        """Gather what probes read on all frames, in the order of their times."""
        missing = [probe for probe in probes if (frames, probe) not in self._known]
        self._known |= _read_frames(frames, missing)
        records = [record for probe in probes for record in self._known[frames, probe]]
        return sorted(records, key=lambda record: record.time)

    def _read(self, frames: Frames, probes: Sequence[Probe]) -> None:
        try:
            read = _read_frames(frames, probes)
        except InputError as error:
            self._document.add_next_tick_callback(partial(self.table.update, text=escape(str(error))))
            return
        self._document.add_next_tick_callback(partial(self._take, read))

    def _take(self, read: dict[tuple[Frames, Probe], list[ProbeRecord]]) -> None:
        self._known |= read
        if self._asked is not None:
            self.show(*self._asked)

    def _show_known(self) -> None:
        if self._asked is None:
            return
        frames, probes, number = self._asked
        known = [self._known[frames, probe] for probe in probes]
        records = [of_probe[min(number, len(of_probe) - 1)] for of_probe in known]
        self.table.text = _write_table(records)
        lines = [record for record in records if isinstance(record.reading.probe, LineProbe)]
        unit = records[0].unit.name if records else ""
        self._draw(self.profile, [(record.reading.probe.name, record.unit.size * record.reading.distance,
                                   self._pick(record)) for record in lines], f"distance [{unit}]", unit)
        over_time = [] if len(frames) < 2 else [
            (of_probe[0].reading.probe.name, np.array([record.time for record in of_probe]),
             np.array([average_along(self._pick(record)) for record in of_probe])) for of_probe in known]
        self._draw(self.curves, over_time, "time", unit)

    def _pick(self, record: ProbeRecord) -> Array:
        return QUANTITIES[self.quantity.value](record)

    def _draw(self, drawn: figure, curves: Sequence[tuple[str, Array, Array]], along: str, unit: str) -> None:
        """Draw curves (name, x, y) in the place of those before."""
        if not curves and not drawn.visible:
            return
        drawn.renderers = []
        drawn.right = []
        drawn.visible = bool(curves)
        items = []
        for place, (name, x, y) in enumerate(curves):
            colour = COLOURS[place % len(COLOURS)]
            shown = [drawn.line(x, y, color=colour, line_width=2)]
            if len(x) <= MOST_MARKED:
                shown.append(drawn.scatter(x, y, color=colour))
            items.append(LegendItem(label=name, renderers=shown))
        drawn.add_layout(Legend(items=items), "right")
        drawn.xaxis.axis_label = along
        drawn.yaxis.axis_label = f"{self.quantity.value} [{unit}]" if self.quantity.value.startswith("u") else (
            self.quantity.value)


def _read_frames(frames: Frames, probes: Sequence[Probe]) -> dict[tuple[Frames, Probe], list[ProbeRecord]]:
    """What probes read on all frames."""
    records = measure_probes(frames.read_all(), probes) if probes else []
    return {(frames, probe): [record for record in records if record.reading.probe == probe] for probe in probes}


def _write_table(records: Sequence[ProbeRecord]) -> str:
    """A row for each probe, numbers as ``ddic probe`` prints them; of lines, the means."""
    if not records:
        return ""
    head = ["probe", *OF_TABLE[:2], f"± σ [{records[0].unit.name}]", *OF_TABLE[2:], "± σ", ""]
    rows = ["".join(f"<th>{escape(name)}</th>" for name in head)]
    for record in records:
        known = record.metrology
        u_x, u_y, *strains = (average_along(QUANTITIES[name](record)) for name in OF_TABLE)
        cells = [record.reading.probe.name, format_digits(u_x, ".5g"), format_digits(u_y, ".5g"),
                 format_digits(record.unit.size * known.displacement_noise, ".2g"),
                 *(format_digits(strain, ".3e") for strain in strains), format_digits(known.strain_noise, ".1e"),
                 "; ".join(filter(None, (record.reading.note, known.note)))]
        rows.append("".join(f"<td>{escape(cell)}</td>" for cell in cells))
    return "<table cellpadding=4>" + "".join(f"<tr>{cells}</tr>" for cells in rows) + "</table>"
