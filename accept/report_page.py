"""The report on the open-hole test as a headless browser shows it, and what it asks the net for."""

from __future__ import annotations

import base64
import io
import json
import re
import subprocess
import tempfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox, BboxBase
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import uniform_filter

from accept.real_images import case_text
from accept.support.browser import require_browser
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ddic, ddic_run, images
from ddic.io.result_reader import read_result
from ddic.plots.canvas import POINTS_AN_INCH
from ddic.report.items import find_worst_places, gather_all
from ddic.report.page import DPI, draw_report_figures

SECONDS = 120
"""Within which the browser has to be done."""

WIDTH = 1440
"""Of the window, pixels."""

THIN = 3
"""Dots over which pictures are averaged before they are compared; a larger number sees less of letters."""

OPTIONS = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-background-networking",
           "--disable-component-update", "--disable-sync", "--no-first-run", "--disable-extensions",
           "--force-device-scale-factor=1")
"""As root, without a screen, and without what a browser asks the net for by itself."""

PROBE = """<script>
window.addEventListener("load", () => {
  const boxes = [...document.images].map(image => {
    const box = image.getBoundingClientRect();
    return {name: image.alt, natural: [image.naturalWidth, image.naturalHeight],
            box: [box.left, box.top + window.scrollY, box.width, box.height]};
  });
  const wide = [...document.querySelectorAll("main *")].filter(part => part.scrollWidth > part.clientWidth + 1
    && getComputedStyle(part).display !== "inline").map(part => part.tagName);
  const seen = {height: document.documentElement.scrollHeight, width: document.documentElement.scrollWidth,
                images: boxes, wide: wide};
  document.body.innerHTML = "";
  document.body.textContent = "SEEN" + btoa(unescape(encodeURIComponent(JSON.stringify(seen)))) + "END";
});
</script>"""
"""Put into a copy of a page: it writes what the browser made of it."""


@dataclass(frozen=True)
class ShownPicture:
    """A picture in a page.

    Attributes
    ----------
    name : str
        Its alternative text.
    scale : float
        Dots on the screen per dot of the picture; 0 where it is not shown.
    likeness : float
        Correlation of what the screenshot shows there with the picture; nan where it is not shown.
    """

    name: str
    scale: float
    likeness: float


@dataclass(frozen=True)
class ShownPage:
    """A page as a browser shows it.

    Attributes
    ----------
    pictures : list of ShownPicture
        In the order of the page.
    overflowing : list of str
        Tags of elements whose content is wider than they are, and ``html`` where the page is wider than the window.
    requests : list of str
        Addresses beside the page's own file that were asked for; data in the page are none.
    screenshot : Path
        Of the whole page.
    """

    pictures: list[ShownPicture]
    overflowing: list[str]
    requests: list[str]
    screenshot: Path


def show_page(browser: str, page: Path, screenshot: Path) -> ShownPage:
    """Open a page in a browser, and look at it."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        seen, requests = probe_page(browser, page, Path(folder))
        _run(browser, Path(folder), f"--screenshot={screenshot}", f"--window-size={WIDTH},{seen['height']}",
             page.resolve().as_uri())
    shown = np.asarray(Image.open(screenshot).convert("L"), np.float64)
    pictures = re.findall(r'<img alt="([^"]*)" src="data:image/png;base64,([^"]*)"', page.read_text(encoding="utf-8"))
    compared = [_compare(shown, box, base64.b64decode(data))
                for box, (_, data) in zip(seen["images"], pictures, strict=True)]
    overflowing = [*seen["wide"], *(["html"] if seen["width"] > WIDTH else [])]
    return ShownPage(compared, overflowing, requests, screenshot)


def _list_requests(log: Path) -> list[str]:
    """Addresses that a page asked for, answered or not, from the browser's log of the net.

    What the browser wants for itself has no page as its initiator, and does not count.
    """
    found = set()
    for line in log.read_text(encoding="utf-8", errors="replace").splitlines():
        initiator, url = (re.search(f'"{key}":"([^"]*)"', line) for key in ("initiator", "url"))
        if initiator is not None and url is not None and initiator[1] != "not an origin":
            found.add(url[1])
    return sorted(found)


def probe_page(browser: str, page: Path, folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Open a copy of a page that says what the browser makes of it.

    The copy has no policy that would keep it from asking the net. Nothing outside answers: what is asked for is in the
    browser's log all the same.
    """
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text(encoding="utf-8"))
    copy = folder / "copy.html"
    copy.write_text(text.replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    log = folder / "net.json"
    printed = _run(browser, folder, f"--window-size={WIDTH},900", f"--log-net-log={log}",
                   "--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom", copy.as_uri())
    found = re.search(r"SEEN([A-Za-z0-9+/=]*)END", printed.split("<body", maxsplit=1)[1])
    assert found is not None, "the browser did not run the page"
    seen: dict[str, Any] = json.loads(base64.b64decode(found[1]))
    return seen, _list_requests(log)


def _run(browser: str, folder: Path, *arguments: str) -> str:
    command = [browser, *OPTIONS, f"--user-data-dir={folder / 'profile'}", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=True).stdout


def _compare(shown: NDArray[np.float64], seen: dict[str, Any], data: bytes) -> ShownPicture:
    """Compare what a screenshot shows in a box with the picture that belongs there."""
    x, y, width, height = (round(number) for number in seen["box"])
    patch = shown[y:y + height, x:x + width]
    if not seen["natural"][0] or patch.size == 0 or patch.shape != (height, width):
        return ShownPicture(seen["name"], 0.0, float("nan"))
    picture = Image.open(io.BytesIO(data)).convert("L").resize((width, height), Image.Resampling.LANCZOS)
    # Boxes begin and end between pixels: thin lines may lie one pixel beside, and are compared as wide as three.
    grey = uniform_filter(np.asarray(picture, np.float64), THIN)[1:-1, 1:-1]
    patch = uniform_filter(patch, THIN)
    patches = [patch[j:height - 2 + j, i:width - 2 + i] for j, i in product(range(3), repeat=2)]
    likeness = max(float(np.corrcoef(grey.ravel(), moved.ravel())[0, 1]) for moved in patches)
    return ShownPicture(seen["name"], width / seen["natural"][0], likeness)


ROUNDING_DOTS = 1.0
"""Dots by which a text may reach beyond the page: its box is rounded outwards."""

EXPECTED = ("displacement x", "displacement y", "strain xx", "strain yy", "strain xy", "deformed mesh", "residual",
            "iterations", "Krylov iterations", "residual histogram", "grey-level histogram")
"""Pictures of a measurement by the dual method whose images are there."""

LEAST_LIKENESS = 0.95
"""Correlation of the screenshot with each picture: 1 but for how the browser makes it smaller."""

LEAST_TYPE = 7.0
"""Dots on the screen of the smallest type's size."""

TINY = """
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [12, 12, 228, 228]
element_size = 9
circles = [{{ center = [119.5, 119.5], radius = 30 }}]
[regularization]
cut_off_wavelength = 40
[solver]
method = "dual"
subdomains = 4
"""


def measure_report(scale: Scale) -> list[Row]:
    """Write the report on a measurement, open it in a headless browser, and look at what it shows."""
    browser = require_browser()
    folder = scale.folder("practice") / "report"
    folder.mkdir(parents=True, exist_ok=True)
    ddic_run(_write_case(scale, folder), folder, 2, "measured")
    page, screenshot = folder / "measured.report.html", folder / "measured.report.png"
    ddic("report", str(folder / "measured.vtkhdf"), "--output", str(page))
    shown = show_page(browser, page.resolve(), screenshot.resolve())
    of_what = "report on a tiny plate" if scale.smoke else "report on openhole 53 -> 70"
    return [_judge_pictures(of_what, shown), _judge_texts(of_what, folder / "measured.vtkhdf", shown),
            Row(f"{of_what}: addresses that the page asks the net for", "none", ", ".join(shown.requests) or "none",
                not shown.requests)]


def _write_case(scale: Scale, folder: Path) -> str:
    if not scale.smoke:
        return case_text("subdomains = 8", '[regularization]\ncut_off_wavelength = 80\n')
    pair = images("kirsch", "--size", "240x240", "--strain", "0.005", "--radius", "30", "--noise", "2",
                  folder=folder / "images")
    return TINY.format(folder=pair.resolve())


def _judge_pictures(of_what: str, shown: ShownPage) -> Row:
    missing = sorted(set(EXPECTED) - {picture.name for picture in shown.pictures})
    least = min((picture.likeness for picture in shown.pictures), default=0.0)
    is_shown = not missing and least >= LEAST_LIKENESS and not shown.overflowing
    return Row(f"{of_what}, screenshot of the whole page: pictures missing; least correlation of what it shows with "
               "the picture; contents wider than their place", f"none; >= {LEAST_LIKENESS}; none",
               f"{', '.join(missing) or 'none'} of {len(shown.pictures)}; {least:.3f}; "
               f"{', '.join(shown.overflowing) or 'none'} ({shown.screenshot})", is_shown)


def _judge_texts(of_what: str, path: Path, shown: ShownPage) -> Row:
    """Texts on the pictures: cut by an edge, or too small on the screen."""
    result = read_result(path)
    drawn = [of_one for section in draw_report_figures(gather_all(result), find_worst_places(result)).values()
             for of_one in section]
    scales = {picture.name: picture.scale for picture in shown.pictures}
    clipped = [f"{name}: {text}" for name, _, figure in drawn for text in find_clipped_texts(figure)]
    smallest = min(scales.get(name, 0.0) * find_smallest_type(figure) * DPI / POINTS_AN_INCH
                   for name, _, figure in drawn)
    return Row(f"{of_what}: texts on pictures that an edge cuts; smallest type on a screen {WIDTH} px wide",
               f"none; >= {LEAST_TYPE:g} px", f"{'; '.join(clipped) or 'none'}; {smallest:.1f} px",
               not clipped and smallest >= LEAST_TYPE)


def find_smallest_type(figure: Figure) -> float:
    """Find the smallest type on a page."""
    return float(min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text().strip()))


def find_clipped_texts(figure: Figure) -> list[str]:
    """Find the texts that the edge of the page cuts: titles, labels, numbers at ticks and of legends."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    axes_of_ticks = [axis for axes in figure.findobj(Axes) for axis in (axes.xaxis, axes.yaxis) if axes.axison]
    # Numbers of ticks beyond the limits are made but not drawn: an axis knows which ones are.
    of_ticks = {id(label) for axis in axes_of_ticks for label in axis.get_ticklabels(which="both")}
    boxes: list[tuple[str, Bbox | None]]
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in figure.findobj(Text)
             if text.get_visible() and text.get_text().strip() and id(text) not in of_ticks]
    boxes += [(f"axis {axis.get_label_text()}", axis.get_tightbbox(renderer)) for axis in axes_of_ticks]
    return [text for text, box in boxes if box is not None and not _holds(figure.bbox, box)]


def _holds(page: BboxBase, box: BboxBase) -> bool:
    """Whether a box lies on the page."""
    return bool(box.x0 >= page.x0 - ROUNDING_DOTS and box.y0 >= page.y0 - ROUNDING_DOTS
                and box.x1 <= page.x1 + ROUNDING_DOTS and box.y1 <= page.y1 + ROUNDING_DOTS)
