"""Shapes by clicks: what is chosen is clicked point by point, and told when it is whole."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

from bokeh.events import DoubleTap, Tap
from bokeh.models import Button, ColumnDataSource, Div, Select

from ddic.page.case_text import Point
from ddic.page.image_pane import ImagePane

NOTHING = "(nothing)"
"""The first choice of a list."""

AT_REST = "the wheel zooms, dragging moves the image"
"""What to do where nothing is drawn."""

SAME_CLICK = 4.0
"""Pixels of the screen within which a click repeats the one before it, as both of a double click do."""

DOUBLE_CLICK_S = 0.5
"""Seconds from one click that ends a shape to another at its place, within which they are both of a double one."""

Snap = Callable[[Point, float], Point]
"""Moves a point, pixels, to something within a distance of it."""


class ClickDrawer:
    """Collects the clicks of one shape after the other.

    Parameters
    ----------
    pane : ImagePane
        Where they are made.
    forms : dict of (int, bool, str)
        Of each thing that can be drawn: the least number of clicks, whether more may follow, and what to do.
    done : callable
        Told the name of a thing and its points, pixels rounded to what the screen shows.
    at_rest : str
        What to do where nothing is drawn.
    snap : callable or None
        Moves a point to what lies near.
    """

    def __init__(self, pane: ImagePane, forms: Mapping[str, tuple[int, bool, str]],
                 done: Callable[[str, list[Point]], None], at_rest: str, snap: Snap | None = None) -> None:
        self._pane, self._forms, self._done, self._at_rest, self._snap = pane, forms, done, at_rest, snap
        self._points: list[Point] = []
        self._last: Point | None = None
        self._end_time = 0.0
        self.choice = Select(title="Draw", value=NOTHING, options=[NOTHING, *forms])
        self.finish = Button(label="Finish", disabled=True)
        self.hint = Div(text=at_rest, width=430)
        self._pending = ColumnDataSource({"x": [], "y": []})
        pane.figure.line("x", "y", source=self._pending, color="#ff3030", line_width=2)
        pane.figure.scatter("x", "y", source=self._pending, color="#ff3030", size=7)
        self.choice.on_change("value", lambda attribute, old, new: self._begin())
        self.finish.on_click(self._end)
        pane.figure.on_event(Tap, self._click)
        pane.figure.on_event(DoubleTap, self._click_twice)

    def _begin(self) -> None:
        self._set_points([])
        self.hint.text = self._forms[self.choice.value][2] if self.choice.value in self._forms else self._at_rest

    def take_back(self) -> bool:
        """Take back the last click of a shape that is not whole yet; tell whether there was one."""
        had_one = bool(self._points)
        self._set_points(self._points[:-1])
        return had_one

    def _click_twice(self, event: DoubleTap) -> None:
        """The end of a shape, or a fast click at another place, which the browser tells as the second of a double."""
        if self._last is None or math.dist((event.x, event.y), self._last) < SAME_CLICK * self._pane.pitch:
            self._end()
        else:
            self._click(event)

    def _click(self, event: Tap | DoubleTap) -> None:
        if self.choice.value not in self._forms:
            return
        pitch = self._pane.pitch
        point, last = (float(event.x), float(event.y)), self._last
        # Not the point that came of it, which may have snapped to something.
        self._last = point
        is_recent = bool(self._points) or time.monotonic() - self._end_time < DOUBLE_CLICK_S
        if last is not None and is_recent and math.dist(point, last) < SAME_CLICK * pitch:
            return
        if self._snap is not None:
            point = self._snap(point, 2.0 * SAME_CLICK * pitch)
        self._set_points([*self._points, self.round_point(point)])
        fewest, may_have_more, _ = self._forms[self.choice.value]
        if len(self._points) == fewest and not may_have_more:
            self._end()

    def round_point(self, point: Point) -> Point:
        """Round a point to the digits that the screen shows, pixels."""
        digits = max(math.ceil(-math.log10(self._pane.pitch)), 0)
        return round(point[0], digits), round(point[1], digits)

    def _end(self) -> None:
        """Tell of the shape, if it is whole; the next one of its kind begins."""
        name, points = self.choice.value, self._points
        if name in self._forms and len(points) >= self._forms[name][0]:
            self._set_points([])
            self._done(name, points)
            self._end_time = time.monotonic()

    def _set_points(self, points: list[Point]) -> None:
        self._points = points
        self._pending.data = {"x": [x for x, _ in points], "y": [y for _, y in points]}
        is_whole = self.choice.value in self._forms and len(points) >= self._forms[self.choice.value][0]
        self.finish.disabled = not is_whole
