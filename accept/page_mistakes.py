"""Wrong inputs at the page on which a case is drawn: each is told beside the drawing, and the page goes on."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from accept.drawn_cases import ELEMENT_SIZE, POINTS, PROBES, draw_plate
from accept.support.browser import NotSeenError, Point, ServedPage, Tab, opened_browser, wait_until
from accept.table import Scale
from bench.support.rows import Row

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CASE = "mistaken.toml"

TEXT = """\
[images]
reference = "images/reference.tif"
deformed = "images/deformed.tif"

[mesh.structured]
region = [20, 20, 230, 230]
element_size = 12
circles = [{ center = [128, 128], radius = 36 }]

[output]
file = "mistaken.vtkhdf"
"""

READY = "ready to run"

WAVELENGTH = "Cut-off wavelength (px)"

TOLD_S = 15.0
"""Seconds in which what is wrong must be told."""


@dataclass(frozen=True)
class Mistake:
    """A wrong input.

    Attributes
    ----------
    name : str
        What is wrong.
    make : callable
        Makes it in a tab.
    key : str
        What is said names it.
    """

    name: str
    make: Callable[[Tab], None]
    key: str


def measure_wrong_inputs(scale: Scale) -> list[Row]:
    """Make mistakes one by one, each in a tab of its own on the same server."""
    folder = scale.folder("page_mistakes")
    folder.mkdir(parents=True, exist_ok=True)
    draw_plate(folder)
    mistakes = [*list_clicked(), *list_typed(), *list_texts()]
    if scale.smoke:
        mistakes = [mistake for mistake in mistakes if mistake.name in SMOKE]
    (folder / CASE).write_text(TEXT, encoding="utf-8")
    with opened_browser() as browser, ServedPage("draw", "images/reference.tif", CASE, folder=folder) as served:
        untold = [mistake.name for mistake in mistakes if not _is_told(browser, served, mistake)]
        unserved = [] if _is_served(browser, served) else ["after the last one no page was served"]
        boxes = (ELEMENT_SIZE,) if scale.smoke else (ELEMENT_SIZE, WAVELENGTH)
        taken = [box for box in boxes if _takes_letters(Tab(browser, served.address), box)]
        n_faults = served.read_errors().count("Traceback")
    faults = "; ".join(untold + unserved) or "none"
    return [Row(f"{len(mistakes)} wrong inputs at the page of ddic draw: shapes clicked, points, numbers, texts typed",
                "each told beside the drawing by its key, a new page served afterwards; no error of the server",
                f"{len(mistakes) - len(untold)} of {len(mistakes)}; not: {faults}; {n_faults} errors",
                not untold and not unserved and n_faults == 0),
            Row("letters keyed into the boxes of numbers", "neither box nor text takes them",
                f"taken by: {', '.join(taken) or 'none'}", not taken)]


def _is_served(browser: Browser, served: ServedPage) -> bool:
    """Whether a new tab shows the case with its image, ready to run."""
    try:
        tab = Tab(browser, served.address)
        tab.find_text(READY)
        tab.close()
    except NotSeenError:
        return False
    return True


def _is_told(browser: Browser, served: ServedPage, mistake: Mistake) -> bool:
    """Make a mistake in a new tab, which shows that those before have harmed nothing; whether it is told."""
    tab = Tab(browser, served.address)
    tab.find_text(READY)
    try:
        mistake.make(tab)
        wait_until(lambda: mistake.key in tab.read_problem(), mistake.name, TOLD_S)
    except NotSeenError:
        return False
    finally:
        tab.close()
    return True


def _takes_letters(tab: Tab, box: str) -> bool:
    """Whether letters change a box of a number, or the text."""
    tab.find_text(READY)
    before = tab.read(box)
    tab.type_keys(box, "twelve")
    time.sleep(1.0)
    takes = (tab.read(box), tab.read(CASE)) != (before, TEXT)
    tab.close()
    return takes


SMOKE = ("a line outside the region", "letters for points", "a bracket is not closed")


def list_clicked() -> list[Mistake]:
    """List shapes that cannot be as they are clicked."""
    return [
        Mistake("a line outside the region", partial(_click, "line: crack, shear band", ((2, 2), (10, 10))),
                "discontinuity"),
        Mistake("a line within a hole", partial(_click, "line: crack, shear band", ((120, 120), (136, 130))),
                "discontinuity"),
        Mistake("a hole outside the region", partial(_click, "hole: circle", ((8, 8), (12, 8))), "hole_1"),
        Mistake("a hole larger than the region", partial(_click, "hole: circle", ((128, 128), (250, 250))), "holes"),
        Mistake("a hole whose sides cross", partial(_click, "hole: polygon", ((40, 40), (80, 80), (80, 40), (40, 80))),
                "polygons"),
        Mistake("a mask whose sides cross", partial(_click, "mask: polygon", ((40, 40), (80, 80), (80, 40), (40, 80))),
                "images.masked[0]"),
        Mistake("a region whose sides cross",
                partial(_click, "region: polygon", ((30, 30), (220, 220), (220, 30), (30, 220))), "region"),
        Mistake("a near field's window without its section",
                partial(_click, "near field: window", ((40, 40), (80, 80))), "near field 1"),
        Mistake("an edge box without regularization",
                partial(_click, "edge not controlled: box", ((15, 15), (60, 30))), "regularization"),
    ]


def _click(kind: str, points: Sequence[Point], tab: Tab) -> None:
    tab.choose("Draw", kind)
    tab.click(points)
    if kind.startswith(("line", "hole: polygon", "mask: polygon", "region: polygon")):
        tab.press("Finish")


def list_typed() -> list[Mistake]:
    """List points and numbers that cannot be as they are typed."""
    return [
        Mistake("letters for points", partial(_type, POINTS, "a, b; c, d"), "a, b; c, d"),
        Mistake("no points", partial(_type, POINTS, ""), "points"),
        Mistake("one corner of a rectangle", partial(_type, POINTS, "20, 20"), "2 points"),
        Mistake("a corner that is nan", partial(_type, POINTS, "nan, 20; 230, 230"), "nan, 20"),
        Mistake("a region without width", partial(_type, POINTS, "20, 20; 20, 230"), "region"),
        Mistake("a region beyond the image", partial(_type, POINTS, "-50, -50; 200, 200"), "region"),
        Mistake("a circle without radius", partial(_type_circle, "128, 128; 128, 128"), "circles[0].radius"),
        Mistake("a huge element size", partial(_type, ELEMENT_SIZE, "1000000"), "element_size"),
        Mistake("a tiny element size", partial(_type, ELEMENT_SIZE, "0.001"), "element_size"),
        Mistake("a negative element size", partial(_type, ELEMENT_SIZE, "-5"), "element_size"),
        Mistake("no element size", partial(_type, ELEMENT_SIZE, ""), "element_size"),
        Mistake("a huge cut-off wavelength", partial(_type, WAVELENGTH, "1000000000"), "cut_off_wavelength"),
    ]


def _type(box: str, text: str, tab: Tab) -> None:
    tab.fill(box, text)


def _type_circle(text: str, tab: Tab) -> None:
    tab.choose("Drawn", "hole: circle 1")
    wait_until(lambda: tab.read(POINTS).startswith("128"), "the points of the circle")
    tab.fill(POINTS, text)


def list_texts() -> list[Mistake]:
    """List what cannot be as it is written in the text."""
    size = "element_size = 12\n"
    return [
        Mistake("no text", partial(_type, CASE, ""), "mesh: this section is missing"),
        Mistake("a bracket is not closed", partial(_replace, "230]\n", "230\n"), "line 7"),
        Mistake("letters for a number", partial(_replace, size, "element_size = twelve\n"), "line 7"),
        Mistake("an unknown key", partial(_replace, "element_size", "element_sizes"), "element_sizes"),
        Mistake("a text for a number", partial(_replace, size, 'element_size = "12"\n'), "element_size"),
        Mistake("an image that is not there", partial(_replace, "deformed.tif", "deformd.tif"), "deformd.tif"),
        Mistake("a result in no folder", partial(_replace, 'file = "', 'file = "nowhere/'), "output.file"),
        Mistake("more subdomains than cells", partial(_replace, "[output]", "[solver]\nsubdomains = 100000\n[output]"),
                "solver.subdomains"),
        Mistake("probes that are no TOML", partial(_type, PROBES, "[point.A"), "probes"),
    ]


def _replace(old: str, new: str, tab: Tab) -> None:
    tab.fill(CASE, TEXT.replace(old, new))
