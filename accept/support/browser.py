"""Pages of ddic in a browser without a window: the commands that serve them, what a user does there, and sees."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import psutil

from accept.support.ended_job import DDIC
from bench.support.runs import NotHereError, environment

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "chrome-headless-shell")
"""Of Chromium and its kin."""

LONGEST_S = 60.0
"""Seconds in which what is waited for must have come."""

POLL_S = 0.02

BETWEEN_CLICKS_S = 0.4
"""A second click that comes sooner is half of a double one."""

SCREEN = {"width": 1800, "height": 1500}

Point = tuple[float, float]


class NotSeenError(RuntimeError):
    """What was waited for has not come."""


def find_browser() -> str | None:
    """Find a browser that runs without a screen."""
    return next((path for name in NAMES if (path := shutil.which(name)) is not None), None)


def require_browser() -> str:
    """Find a browser; raises NotHereError where there is none."""
    browser = find_browser()
    if browser is None:
        raise NotHereError("no Chromium is installed (Debian: apt-get install --no-install-recommends chromium)")
    return browser


class ServedPage:
    """``ddic draw`` or ``ddic view`` in a process of its own, until it is ended; use it in a ``with`` statement.

    Parameters
    ----------
    *arguments : str
        Of ``ddic``.
    folder : Path
        Where it runs.
    """

    def __init__(self, *arguments: str, folder: Path) -> None:
        self._said: IO[str] = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115  # closed by __exit__
        self.process = psutil.Popen([*DDIC, *arguments, "--no-browser"], cwd=folder, env=environment(), text=True,
                                    stdout=subprocess.PIPE, stderr=self._said, start_new_session=True,
                                    preexec_fn=_heed_interrupts)
        first = self.process.stdout.readline().split()
        if len(first) < 2:
            raise RuntimeError(f"ddic {' '.join(arguments)} serves no page: {self.read_errors()}")
        self.address: str = first[1]

    @property
    def port(self) -> int:
        """Where it listens on this machine."""
        return int(re.findall(r":(\d+)/", self.address)[0])

    @property
    def token(self) -> str:
        """Of the address."""
        return self.address.partition("token=")[2]

    def read_errors(self) -> str:
        """Read what it has said on standard error."""
        size = os.fstat(self._said.fileno()).st_size
        return os.pread(self._said.fileno(), size, 0).decode(errors="replace")

    def __enter__(self) -> ServedPage:
        return self

    def __exit__(self, *error: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self._said.close()


def _heed_interrupts() -> None:
    """As a terminal starts a command; one that a job in the background starts inherits that Ctrl-C is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def opened_browser() -> Iterator[Browser]:
    """Start the browser of this machine, without a window; raises NotHereError where it cannot be driven."""
    program = require_browser()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise NotHereError("no playwright is installed, which drives the browser (pip install playwright)") from error
    with sync_playwright() as playwright:
        # The browser refuses to confine itself where it is root.
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


def wait_until(has_come: Callable[[], bool], what: str, longest: float = LONGEST_S) -> None:
    """Wait until something has come; raises NotSeenError where it does not."""
    end = time.monotonic() + longest
    while not has_come():
        if time.monotonic() > end:
            raise NotSeenError(f"{what}: not within {longest:g} s")
        time.sleep(POLL_S)


IS_DRAWN = """name => {
    const page = window.Bokeh && Bokeh.documents[0];
    const figure = page && page.get_model_by_name(name);
    if (!figure || !Bokeh.index.find_one(figure) || !page.is_idle) return false;
    return figure.renderers.some(drawn => (drawn.data_source.data.image || []).length > 0);
}"""
"""Whether a figure has its image."""

PLACE = """([name, x, y]) => {
    const view = Bokeh.index.find_one(Bokeh.documents[0].get_model_by_name(name));
    const box = view.canvas_view.el.getBoundingClientRect();
    return [box.left + view.frame.x_scale.compute(x), box.top + view.frame.y_scale.compute(y)];
}"""
"""Where on the screen a pixel of the image is."""

PIXEL = """([name, left, top]) => {
    const view = Bokeh.index.find_one(Bokeh.documents[0].get_model_by_name(name));
    const box = view.canvas_view.el.getBoundingClientRect();
    return [view.frame.x_scale.invert(left - box.left), view.frame.y_scale.invert(top - box.top)];
}"""
"""Which pixel of the image a place on the screen is."""

CURVES = """name => Bokeh.documents[0].get_model_by_name(name).renderers
    .filter(drawn => drawn.glyph.type == "Line")
    .map(drawn => [Array.from(drawn.data_source.data.x), Array.from(drawn.data_source.data.y)])"""
"""The lines of a figure."""

PROBLEM = "div[style*='b00020']"
"""What is wrong is red."""


class Tab:
    """A tab of the browser with a page of ddic: what a user does there, and sees.

    Parameters
    ----------
    browser : Browser
        The browser.
    address : str
        Of the page.
    figure : str
        Name of the figure that holds the image: image, or field for results.
    watch : str
        Script that runs before the page.
    """

    def __init__(self, browser: Browser, address: str, figure: str = "image", watch: str = "") -> None:
        self.page: Page = browser.new_page(viewport=SCREEN)
        self.page.add_init_script(watch)
        self.figure = figure
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.goto(address)
        self.wait_for_image()

    def close(self) -> None:
        """Close the tab."""
        self.page.close()

    def wait_for_image(self) -> None:
        """Wait until the figure has its image."""
        wait_until(lambda: bool(self.page.evaluate(IS_DRAWN, self.figure)), f"the image of {self.figure}")

    # What is done.

    def place(self, point: Point) -> Point:
        """Find where on the screen a pixel of the image is."""
        left, top = self.page.evaluate(PLACE, [self.figure, *point])
        return float(left), float(top)

    def click(self, points: Sequence[Point]) -> None:
        """Click pixels of the image, one after the other."""
        for point in points:
            self.page.mouse.click(*self.place(point))
            time.sleep(BETWEEN_CLICKS_S)

    def point_at(self, point: Point) -> Point:
        """Move the pointer to a pixel of the image; return where it is, to the last digit."""
        left, top = self.place(point)
        self.page.mouse.move(left, top)
        x, y = self.page.evaluate(PIXEL, [self.figure, left, top])
        return float(x), float(y)

    def choose(self, label: str, option: str) -> None:
        """Choose from a list."""
        self._find(label).select_option(option)

    def fill(self, label: str, text: str) -> None:
        """Write into a box, and leave it."""
        box = self._find(label)
        box.fill(text)
        box.blur()

    def type_keys(self, label: str, text: str) -> None:
        """Write into an emptied box key by key, some of which it may refuse, and leave it."""
        box = self._find(label)
        box.click()
        box.press("Control+a")
        box.press_sequentially(text)
        box.blur()

    def press(self, button: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=button, exact=True).locator("visible=true").first.click()

    def draw(self, kind: str, points: Sequence[Point], into: str, *, finish: bool = False) -> None:
        """Draw a shape or a probe; wait until the text that it is written into has changed."""
        before = self.read(into)
        self.choose("Draw", kind)
        self.click(points)
        if finish:
            self.press("Finish")
        wait_until(lambda: self.read(into) != before, f"{kind}: in the text")

    # What is seen.

    def read(self, label: str) -> str:
        """Read what a box holds."""
        return str(self._find(label).input_value())

    def read_problem(self) -> str:
        """Read what the page says is wrong; empty where it says nothing."""
        return "\n".join(self.page.locator(PROBLEM).all_inner_texts())

    def read_texts(self) -> list[str]:
        """Read what stands beside and below the figures."""
        return [str(text) for text in self.page.locator("div.bk-clearfix").locator("visible=true").all_inner_texts()]

    def find_text(self, part: str) -> str:
        """Wait for a text that holds a part."""
        def list_found() -> list[str]:
            return [text for text in self.read_texts() if part in text]

        wait_until(lambda: bool(list_found()), f"a text with {part!r}")
        return list_found()[0]

    def read_table(self, first: str) -> list[list[str]]:
        """Read the rows of a table that has a cell of its own."""
        return [line.split("\t") for line in self.find_text(first).splitlines()]

    def read_curves(self, figure: str) -> list[tuple[list[float], list[float]]]:
        """Read the lines of a figure, x and y."""
        return [(x, y) for x, y in self.page.evaluate(CURVES, figure)]

    def _find(self, label: str) -> Any:
        return self.page.get_by_label(label, exact=True).locator("visible=true").first
