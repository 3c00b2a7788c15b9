"""A page in a tab, without a browser and without a server: what a user does, and what the server would call."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.events import ButtonClick, DoubleTap, Event, Tap
from bokeh.models import Button, Div, Model, Plot, Widget
from bokeh.server.callbacks import NextTickCallback, PeriodicCallback, TimeoutCallback
from numpy.typing import NDArray

Jobs = list[Callable[[], None]]


class Tab:
    """A document with a page; work beside the page waits in ``jobs`` until ``settle``, one job after the other.

    Widgets are found by their kind and title, as a user finds them.
    """

    def __init__(self, make_page: Callable[[Document], None], jobs: Jobs) -> None:
        self.document = Document()
        self._jobs = jobs
        make_page(self.document)
        self.settle()

    def settle(self) -> None:
        """Do all work that waits beside the page, and show what came of it."""
        while self._jobs or self._waiting(NextTickCallback):
            if self._jobs:
                self._jobs.pop(0)()
            for callback in self._waiting(NextTickCallback):
                callback.callback()

    def rest(self) -> None:
        """Let the time pass after which a pane is read anew."""
        for callback in self._waiting(TimeoutCallback):
            callback.callback()

    def poll(self) -> None:
        """Call once what the server calls every now and then."""
        for callback in self._waiting(PeriodicCallback):
            callback.callback()

    def _waiting(self, kind: type) -> list[Any]:
        return [callback for callback in self.document.session_callbacks if isinstance(callback, kind)]

    def find(self, kind: type[Model], **attributes: Any) -> Any:
        """The only model of a kind with these attributes."""
        found = [model for model in self.document.models if isinstance(model, kind)
                 and all(getattr(model, name) == value for name, value in attributes.items())]
        assert len(found) == 1, f"{len(found)} of {kind.__name__} {attributes}"
        return found[0]

    def widget(self, title: str) -> Any:
        """The widget of a title."""
        found = [model for model in self.document.models if isinstance(model, Widget) and hasattr(model, "title")
                 and model.title == title]
        assert len(found) == 1, f"{len(found)} of {title}"
        return found[0]

    def enter(self, title: str, value: Any) -> None:
        """Type into a widget, or choose in it."""
        self.widget(title).value = value
        self.settle()

    def press(self, label: str) -> None:
        button = self.find(Button, label=label)
        assert not button.disabled
        button._trigger_event(ButtonClick(button))
        self.settle()

    def click(self, x: float, y: float, pane: str = "image") -> None:
        self.send(pane, Tap, x, y)

    def double_click(self, x: float, y: float, pane: str = "image") -> None:
        """As a browser tells of it: both clicks, then that they were two."""
        for event in (Tap, Tap, DoubleTap):
            self.send(pane, event, x, y)

    def send(self, pane: str, event: type[Event], x: float, y: float) -> None:
        plot = self.find(Plot, name=pane)
        plot._trigger_event(event(plot, x=x, y=y))
        self.settle()

    def draw(self, what: str, points: Iterable[tuple[float, float]], finish: bool = False) -> None:
        """Draw a shape, or place a probe."""
        self.widget("Draw").value = what
        for x, y in points:
            self.click(x, y)
        if finish:
            self.press("Finish")

    def texts(self) -> str:
        """All that is written on the page beside the widgets."""
        return "\n".join(model.text for model in self.document.models if isinstance(model, Div))

    def shown(self, pane: str = "image") -> tuple[NDArray[np.uint8], tuple[float, float, float, float]]:
        """What a pane shows: (height, width, 4), and the box of its outer edges x0, y0, x1, y1, pixels."""
        plot = self.find(Plot, name=pane)
        source = next(renderer.data_source for renderer in plot.renderers
                      if type(renderer.glyph).__name__ == "ImageRGBA")
        data = source.data
        packed = np.ascontiguousarray(data["image"][0])
        x, y = data["x"][0], data["y"][0]
        return (packed.view(np.uint8).reshape(*packed.shape, 4),
                (x, y, x + data["dw"][0], y + data["dh"][0]))

    def saved(self) -> tuple[str, bytes]:
        """The file that the browser was last told to save: its name, and what it holds."""
        (tags,) = [model.tags for model in self.document.models if isinstance(model, Div) and model.tags]
        return tags[0], b64decode(tags[1])


class _Waiting:
    """In place of a pool of threads: jobs wait until a tab settles."""

    def __init__(self, jobs: Jobs) -> None:
        self._jobs = jobs

    def submit(self, function: Callable[..., None], *arguments: Any) -> None:
        self._jobs.append(partial(function, *arguments))


def hold_jobs(monkeypatch: pytest.MonkeyPatch) -> Jobs:
    """Have pages put their work into a list, in the place of threads."""
    jobs: Jobs = []

    def make(n_threads: int) -> _Waiting:
        assert n_threads == 1
        return _Waiting(jobs)

    for module in ("draw", "probe_box"):
        monkeypatch.setattr(f"ddic.page.{module}.{ThreadPoolExecutor.__name__}", make)
    return jobs
