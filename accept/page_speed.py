"""How soon a page shows what it is asked for: large images, their windows, and the frames of a series."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from accept.drawn_cases import draw_plate
from accept.series_runs import ELEMENT, FAST
from accept.support.browser import IS_DRAWN, Point, ServedPage, Tab, opened_browser
from accept.support.deformed_pair import describe_case, write_frames
from accept.table import Scale
from bench.big import FULL
from bench.support.paper_case import HEIGHT, WIDTH, full
from bench.support.rows import Row, append_result
from bench.support.runs import DATA, ddic_run, images
from ddic.io.series_reader import read_series

if TYPE_CHECKING:
    from playwright.sync_api import Browser

RUNS = "page_speed"

N_OPENED = 5

MOST_MEMORY_GIB = 0.5

FIRST = f"""(() => {{
    const isDrawn = {IS_DRAWN};
    const look = () => requestAnimationFrame(() => {{
        if (isDrawn("FIGURE")) requestAnimationFrame(() => {{ window.ddicFirst = performance.now(); }});
        else look();
    }});
    look();
}})()"""
"""Notes when the first image was drawn, milliseconds after the address was opened."""

NEXT = """([name, kind]) => {
    const figure = Bokeh.documents[0].get_model_by_name(name);
    const source = figure.renderers.find(drawn => "image" in drawn.data_source.data).data_source;
    const [across, down] = [figure.x_range, figure.y_range];
    window.ddicBegun = window.ddicDrawn = null;
    const begin = () => { window.ddicBegun = performance.now(); };
    window.addEventListener(kind, begin, {capture: true});
    const isSharp = () => {
        const {x, y, dw, dh} = source.data, width = across.end - across.start;
        return x[0] <= Math.max(across.start, 0) && dw[0] <= 1.1 * width + 64
            && x[0] + dw[0] >= across.end - 64 && y[0] <= Math.max(down.end, 0);
    };
    let number = 0;
    const look = () => {
        const own = ++number;
        window.ddicDrawn = null;
        if (!isSharp()) return;
        requestAnimationFrame(() => requestAnimationFrame(() => {
            if (own == number) window.ddicDrawn = performance.now();
        }));
    };
    const unsettle = () => { number += 1; window.ddicDrawn = null; };
    source.properties.data.change.connect(look);
    for (const range of [across, down]) range.change.connect(unsettle);
    window.ddicForget = () => {
        source.properties.data.change.disconnect(look);
        for (const range of [across, down]) range.change.disconnect(unsettle);
        window.removeEventListener(kind, begin, {capture: true});
    };
}"""
"""Notes when the window in sight has been drawn, after the last event of a kind and the last change of the window."""

SETTLED_S = 0.1
"""After an event in which the browser has changed what is in sight."""


def time_next(tab: Tab, event: str, act: Callable[[], None]) -> float:
    """Measure the seconds from the last of some events, of a kind of the browser's, to the image drawn after it."""
    tab.page.evaluate(NEXT, [tab.figure, event])
    act()
    time.sleep(SETTLED_S)
    tab.page.wait_for_function("window.ddicDrawn !== null", timeout=60_000)
    tab.page.evaluate("window.ddicForget()")
    return float(tab.page.evaluate("window.ddicDrawn - window.ddicBegun")) / 1000.0


@dataclass(frozen=True)
class LargeImage:
    """A large pair, and in which time it must be shown.

    Attributes
    ----------
    width, height : int
        Pixels.
    make : callable
        Gives the folder of its images.
    first, window : float
        Most seconds to the first image, and to a sharp window.
    """

    width: int
    height: int
    make: Callable[[], Path]
    first: float
    window: float


LARGE = (
    LargeImage(WIDTH, HEIGHT, lambda: full(8).folder, 2.0, 0.5),
    LargeImage(FULL, FULL, lambda: images("sinusoidal", "--size", f"{FULL}x{FULL}", folder=DATA / f"big_{FULL}"), 4.0,
               1.0),
)


@dataclass(frozen=True)
class Shown:
    """What showing an image took.

    Attributes
    ----------
    served : float
        Seconds from the command to its address.
    first, windows : list of float
        Seconds to the first image of each tab, and to each window, one after the other further in.
    memory : float
        Largest memory of the server, GiB.
    """

    served: float
    first: list[float]
    windows: list[float]
    memory: float


def measure_large(scale: Scale) -> list[Row]:
    """Open large images, and zoom in."""
    if scale.smoke:
        return []
    folder = scale.folder("page_speed")
    folder.mkdir(parents=True, exist_ok=True)
    plate = draw_plate(folder)
    with opened_browser() as browser:
        small = _show(browser, folder, plate.reference.parent, (256, 256))
        shown = [_show(browser, folder, image.make(), (image.width, image.height)) for image in LARGE]
    append_result(RUNS, {"small": vars(small), "large": [vars(one) for one in shown]})
    return [_judge_large(image, one, small) for image, one in zip(LARGE, shown, strict=True)]


def _judge_large(image: LargeImage, shown: Shown, small: Shown) -> Row:
    first, window, memory = median(shown.first), median(shown.windows), shown.memory - small.memory
    return Row(f"{image.width} x {image.height} px, 8 bit, with the case that ddic draw begins with: address opened to "
               f"first image; last turn of the wheel to sharp window, {len(shown.windows)} times further in; largest "
               "memory of the server beyond that of a 256 px image",
               f"medians of {N_OPENED} at most {image.first:g} and {image.window:g} s; at most {MOST_MEMORY_GIB:g} GiB",
               f"{first:.2f} s ({_span(shown.first)}); {window:.2f} s ({_span(shown.windows)}); {memory:.2f} GiB; the "
               f"address was printed after {shown.served:.1f} s",
               first <= image.first and window <= image.window and memory <= MOST_MEMORY_GIB, judged_small=False)


def _span(seconds: Sequence[float]) -> str:
    return f"{min(seconds):.2f} to {max(seconds):.2f}"


def _show(browser: Browser, folder: Path, pair: Path, size: Point) -> Shown:
    """Open an image several times, and zoom in on a place of it in the last tab."""
    (folder / "large.toml").unlink(missing_ok=True)
    began = time.perf_counter()
    with ServedPage("draw", str(pair / "reference.tif"), "large.toml", "--deformed", str(pair / "deformed.tif"),
                    folder=folder) as served:
        seconds = time.perf_counter() - began
        first = []
        for number in range(N_OPENED):
            tab = Tab(browser, served.address, watch=FIRST.replace("FIGURE", "image"))
            tab.page.wait_for_function("window.ddicFirst > 0")
            first.append(float(tab.page.evaluate("window.ddicFirst")) / 1000.0)
            tab.find_text("verdict")
            if number < N_OPENED - 1:
                tab.close()
        windows = [time_next(tab, "wheel", lambda: _turn_wheel(tab, size)) for _ in range(N_OPENED)]
        memory = _read_peak(served.process.pid)
        tab.close()
    return Shown(seconds, first, windows, memory)


def _turn_wheel(tab: Tab, size: Point) -> None:
    """Zoom in, by about two, on a place beside the middle."""
    tab.page.mouse.move(*tab.place((0.6 * size[0], 0.45 * size[1])))
    for _ in range(4):
        tab.page.mouse.wheel(0, -100)
        time.sleep(0.03)


def _read_peak(pid: int) -> float:
    """Largest memory that a process has had, GiB."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 2**20


MOST_FRAME_S = 0.3

N_MOVES, STRIDE = 20, 0.382
"""Moves of the slider, and its way from one to the next, as a share of its length, when it does not go by one."""

GLIDE_S = 0.4
"""After a click in which the slider's handle glides to its place, and takes no other click."""


def measure_slider(scale: Scale) -> list[Row]:
    """Move the slider of a long series by a frame and farther, over the reference and the deformed images."""
    if scale.smoke:
        return []
    folder = scale.folder("series_rate")
    write_frames(FAST, folder)
    if not (folder / "slider.vtkhdf").is_file():
        # What a run that was ended has left would be gone on with.
        shutil.rmtree(folder / "slider.frames", ignore_errors=True)
        ddic_run(describe_case(FAST, ELEMENT), folder, 2, "slider")
    series = read_series(folder / "slider.vtkhdf")
    n_cells = series[0].mesh.n_cells
    rows = []
    with opened_browser() as browser, ServedPage("view", "slider.vtkhdf", folder=folder) as served:
        for over in ("reference", "deformed"):
            tab = Tab(browser, served.address, "field")
            if over == "deformed":
                tab.page.get_by_label("over the deformed image").check()
                time.sleep(2.0)
            seconds = {"by one": _step(tab), "far": _jump(tab)}
            tab.close()
            append_result(RUNS, {"over": over, **seconds})
            told = "; ".join(f"{how} {median(all_):.2f} s ({_span(all_)})" for how, all_ in seconds.items())
            rows.append(Row(f"series of {len(series)} frames, {n_cells} cells, displacement over the {over} image: "
                            f"slider moved to picture drawn, {N_MOVES} times by one frame and {N_MOVES} times far",
                            f"medians at most {MOST_FRAME_S:g} s", told,
                            all(median(all_) <= MOST_FRAME_S for all_ in seconds.values()), judged_small=False))
    return rows


def _step(tab: Tab) -> list[float]:
    """Seconds of moves by one frame."""
    tab.page.locator(".noUi-handle").first.focus()
    return [time_next(tab, "keydown", lambda: tab.page.keyboard.press("ArrowRight")) for _ in range(N_MOVES)]


def _jump(tab: Tab) -> list[float]:
    """Seconds of moves far from where the slider is."""
    box = tab.page.locator(".noUi-base").first.bounding_box()
    assert box is not None
    middle = box["y"] + box["height"] / 2
    shares = [0.05 + 0.9 * (number * STRIDE % 1.0) for number in range(1, N_MOVES + 1)]
    places = [box["x"] + box["width"] * share for share in shares]

    def click(place: float) -> float:
        time.sleep(GLIDE_S)
        return time_next(tab, "pointerdown", lambda: tab.page.mouse.click(place, middle))

    return [click(place) for place in places]
