"""Probes that are placed by clicks, as the text of a file of probes, which both pages show and ``ddic probe`` reads."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bokeh.models import ColumnDataSource, TextAreaInput

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.page.pane import ImagePane
from ddic.page.shapes import Point
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

FORMS = {
    "probe: point": (1, False, "click the point"),
    "probe: line": (2, False, "click both ends"),
    "probe: extensometer": (2, False, "click both ends"),
    "probe: gauge": (2, False, "click both ends of the gauge length: a square about its middle, which text can change"),
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
    """

    def __init__(self, probes: list[Probe], changed: Callable[[list[str]], None]) -> None:
        self.probes = probes
        self._changed = changed
        self.text = TextAreaInput(title="Probes (a file for ddic probe --probes)", rows=7, width=430,
                                  value="\n".join(map(format_probe, probes)))
        self.text.on_change("value", lambda attribute, old, new: self._read())
        self._drawn = ColumnDataSource({"xs": [], "ys": [], "x": [], "y": [], "name": []})
        self._draw()

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
        self.text.value = f"{self.text.value.rstrip()}\n\n{format_probe(_make_probe(kind, name, points))}".lstrip()

    def _read(self) -> None:
        try:
            self.probes = parse_probes(self.text.value, Path("probes"))
        except InputError as error:
            self._changed(list(error.problems))
            return
        self._draw()
        self._changed([])

    def _draw(self) -> None:
        outlines = [outline_probe(probe) for probe in self.probes]
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


def outline_probe(probe: Probe) -> Array:
    """Outline a probe as it is drawn, (n, 2), pixels: its point, its line, or the rectangle of a gauge."""
    if isinstance(probe, PointProbe):
        return np.array([probe.point])
    if not isinstance(probe, StrainGauge):
        return np.array([probe.start, probe.end])
    along = 0.5 * probe.length * probe.direction
    across = 0.5 * probe.across * np.array([-probe.direction[1], probe.direction[0]])
    corners = [along + across, along - across, -along - across, across - along, along + across]
    return np.asarray(probe.centre + np.array(corners))
