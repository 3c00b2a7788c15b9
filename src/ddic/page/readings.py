"""What the probes of a page read: a table of the frame at hand, profiles along lines, curves over the frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from html import escape

import numpy as np
from bokeh.document import Document
from bokeh.models import Div, Legend, LegendItem, Select
from bokeh.plotting import figure

from ddic.arrays import Array
from ddic.page.frames import Frames, write_number
from ddic.probes.probes import LineProbe, Probe
from ddic.probes.tables import ProbeRecord, average_along, measure_probes

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
        self.table = Div(width=760)
        self.profile, self.curves = (
            figure(width=440, height=260, toolbar_location=None, tools="hover", name=name, visible=False)
            for name in ("profile", "curves"))
        self.quantity.on_change("value", lambda attribute, old, new: self._show())
        document.on_session_destroyed(lambda context: self._worker.shutdown(wait=False, cancel_futures=True))

    def ask(self, frames: Frames, probes: Sequence[Probe], number: int) -> None:
        """Show what probes read on a frame, from 0, and on all others."""
        self._asked = frames, probes, number
        missing = [probe for probe in probes if (frames, probe) not in self._known]
        if missing:
            self.table.text = "reading ..."
            self._worker.submit(self._read, frames, missing)
        else:
            self._show()

    def gather(self, frames: Frames, probes: Sequence[Probe]) -> list[ProbeRecord]:
        """Gather what probes read on all frames, in the order of their times."""
        missing = [probe for probe in probes if (frames, probe) not in self._known]
        self._known |= _read_frames(frames, missing)
        records = [record for probe in probes for record in self._known[frames, probe]]
        return sorted(records, key=lambda record: record.time)

    def _read(self, frames: Frames, probes: Sequence[Probe]) -> None:
        read = _read_frames(frames, probes)
        self._document.add_next_tick_callback(partial(self._take, read))

    def _take(self, read: dict[tuple[Frames, Probe], list[ProbeRecord]]) -> None:
        self._known |= read
        if self._asked is not None:
            self.ask(*self._asked)

    def _show(self) -> None:
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
    head = ["probe", *OF_TABLE[:2], f"± [{records[0].unit.name}]", *OF_TABLE[2:], "±", ""]
    rows = ["".join(f"<th>{escape(name)}</th>" for name in head)]
    for record in records:
        known = record.metrology
        u_x, u_y, *strains = (average_along(QUANTITIES[name](record)) for name in OF_TABLE)
        cells = [record.reading.probe.name, write_number(u_x, ".5g"), write_number(u_y, ".5g"),
                 write_number(record.unit.size * known.displacement_noise, ".2g"),
                 *(write_number(strain, ".3e") for strain in strains), write_number(known.strain_noise, ".1e"),
                 "; ".join(filter(None, (record.reading.note, known.note)))]
        rows.append("".join(f"<td>{escape(cell)}</td>" for cell in cells))
    return "<table cellpadding=4>" + "".join(f"<tr>{cells}</tr>" for cells in rows) + "</table>"
