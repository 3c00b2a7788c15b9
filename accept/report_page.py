"""The report on the open-hole test, as a browser shows it."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.text import Text

from accept.openhole import case_text
from accept.support.browser import WIDTH, ShownPage, find_browser, show_page
from accept.support.clipped_texts import find_clipped_texts
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import NotHereError, ddic, ddic_run, images
from ddic.io.result_reader import read_result
from ddic.plots.canvas import POINTS_AN_INCH
from ddic.report.items import find_worst_places
from ddic.report.page import DPI, draw_report_figures
from ddic.report.statement import gather_all

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
    """Write the report on a measurement, open it in a headless browser, and look at what it shows.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a tiny plate with a hole instead of the test's images.

    Returns
    -------
    list of Row
        Pictures, their texts, requests.

    Raises
    ------
    NotHereError
        Where there is no browser.
    """
    browser = find_browser()
    if browser is None:
        raise NotHereError("no Chromium is installed (Debian: apt-get install --no-install-recommends chromium)")
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
    """Find the smallest type on a page.

    Parameters
    ----------
    figure : Figure
        The page.

    Returns
    -------
    float
        Its size, points.
    """
    return float(min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text().strip()))
