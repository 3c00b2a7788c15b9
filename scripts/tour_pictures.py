"""All pictures of the documentation, in docs/pictures: make pictures draws them anew and names those that it replaced.

Usage: python scripts/tour_pictures.py. Three kinds, a table of each below: those of runs of the examples, which make
docs draws too; of the pages in the browser, which need a Chromium; and of checks of acceptance tables,
one of which needs real images. What cannot be drawn here is named and left as it is.
"""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from functools import cache, partial
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
PICTURES = ROOT / "docs" / "pictures"
TOUR = "demo"
"""The README's tour is this example."""

DRAWN = {
    TOUR: {f"pictures/result.{kind}.png": kind for kind in ("partition", "deformed", "strain", "residual", "krylov")},
    "series": {"pictures/series.curves.png": "series_curves"},
    "opened_crack": {"case.deformed_y.png": "crack_deformed", "case.opening.png": "crack_opening"},
    "near_far": {"result.near-far_y.png": "near_far_example"},
}
"""Of each example the pictures that are taken, and their names here."""

MEASURED = {
    "near_far": ("near_far.measure_noise", "near_far/near_far.png"),
    "failed_hole": ("cracks.measure_failed_hole", "failed_hole/result.deformed_y.png"),
    "sweep": ("choices.measure_example_sweep", "sweep/example/case.sweep.png"),
    "pgd_against_dual": ("pixel_elements.measure_against_dual", "pgd_against_dual/pgd_against_dual.png"),
}
"""Of pictures here the check in accept/ that draws them, and where among its data."""

SHARE, N_COLOURS, N_ROUNDS = 2 / 3, 256, 3
"""Of a picture's size that is kept, and of its colours, which are bettered in some rounds; larger values make larger
files, and clones."""

SAME_GREY = 0.5
"""Mean difference of pixels, grey levels, up to which a picture counts as the one that is there: another processor
rounds otherwise, and every other file would be a change to commit."""


@cache
def draw_examples(folder: Path | None = None) -> list[Path]:
    """Run the examples and bring their pictures up to date; once a process, however often a site is built.

    Parameters
    ----------
    folder : Path, optional
        For all files of the runs.

    Returns
    -------
    list of Path
        Pictures that were replaced.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as temporary:
            return draw_examples(Path(temporary))
    replaced = []
    for example, pictures in DRAWN.items():
        _run_example(example, folder / example)
        for drawn, name in pictures.items():
            replaced += keep_picture(folder / example / drawn, name)
    return replaced


def _run_example(name: str, folder: Path) -> None:
    """Run an example; its output is shown where it fails."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = ["bash", "-c", '. "$0" && exec bash "$1" "$2"', str(ROOT / "scripts" / "mpi_env.sh"),
               str(ROOT / "examples" / name / "run.sh"), str(folder)]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PATH": path}, text=True, capture_output=True,
                          check=False)
    if done.returncode:
        raise RuntimeError(f"examples/{name} does not run, so its pictures cannot be drawn:\n"
                           f"{done.stdout}{done.stderr}")


def keep_picture(drawn: Path, name: str) -> list[Path]:
    """Put a small copy of a picture into docs/pictures, unless it looks like the one that is there.

    Parameters
    ----------
    drawn : Path
        PNG file.
    name : str
        In docs/pictures.

    Returns
    -------
    list of Path
        The picture there if it was replaced.
    """
    kept = PICTURES / f"{name}.png"
    small = drawn.with_suffix(".small.png")
    shrink(drawn, small)
    if is_same(small, kept):
        return []
    shutil.copyfile(small, kept)
    return [kept]


def shrink(picture: Path, small: Path) -> None:
    """Write a picture as small as every clone of the repository should carry.

    Parameters
    ----------
    picture, small : Path
        PNG files.
    """
    with Image.open(picture) as whole:
        height = round(whole.height * SHARE)
        reduced = whole.convert("RGB").resize((round(whole.width * SHARE), height), Image.Resampling.LANCZOS)
        reduced.quantize(N_COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=N_ROUNDS, dither=Image.Dither.NONE).save(
            small, optimize=True)


def is_same(drawn: Path, kept: Path) -> bool:
    """Tell whether two pictures look the same.

    Parameters
    ----------
    drawn, kept : Path
        PNG files; the second may be missing.

    Returns
    -------
    bool
        Whether they have one size and differ by less than SAME_GREY on average.
    """
    one, other = cv2.imread(str(drawn)), cv2.imread(str(kept)) if kept.is_file() else None
    if other is None or one.shape != other.shape:
        return False
    return float(np.abs(one.astype(float) - other.astype(float)).mean()) < SAME_GREY


SCREEN = {"page_draw": (1720, 880), "page_view": (1500, 860)}
"""Width and height of the browser for each of the pages, pixels."""


def draw_pages(folder: Path) -> Iterator[Path]:
    """Open the pages of ddic draw and ddic view in a browser, and take pictures of them.

    Parameters
    ----------
    folder : Path
        With the files of the examples that were run there.

    Yields
    ------
    Path
        Pictures that were replaced.
    """
    from accept.support.browser import find_browser

    found = find_browser()
    if found is None:
        print(f"left as they are: {', '.join(SCREEN)}: no Chromium is installed")
        return
    from playwright.sync_api import Page, sync_playwright

    import ddic
    from ddic.page.server import start_in_thread
    from ddic.page.view import make_view_page
    from ddic.probes.probes import load_probes

    def show_strain(page: Page) -> None:
        page.get_by_label("Field", exact=True).select_option("strain xx")
        page.locator(".noUi-handle").press("End")

    series, probes = folder / "series" / "series.vtkhdf", load_probes(folder / "series" / "probes.toml")
    viewed = start_in_thread(partial(make_view_page, [series], probes))
    # The browser refuses to confine itself where it is root.
    launched = {"executable_path": found, "args": ["--no-sandbox"]}
    with chdir(folder / TOUR), sync_playwright() as playwright, playwright.chromium.launch(**launched) as browser:
        drawn = ddic.draw("images/reference.tif").address
        for name, address, prepare in (("page_draw", drawn, None), ("page_view", viewed, show_strain)):
            width, height = SCREEN[name]
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(address)
            page.wait_for_timeout(WAIT_MS)
            if prepare is not None:
                prepare(page)
                page.wait_for_timeout(WAIT_MS)
            page.screenshot(path=folder / f"{name}.png")
            yield from keep_picture(folder / f"{name}.png", name)


WAIT_MS = 4000
"""For a page to be drawn."""


def draw_measured() -> Iterator[Path]:
    """Run the checks that draw pictures.

    Yields
    ------
    Path
        Pictures that were replaced.
    """
    from accept.table import Scale
    from bench.support.runs import DATA, NotHereError

    for name, (place, drawn) in MEASURED.items():
        module, function = place.split(".")
        try:
            getattr(importlib.import_module(f"accept.{module}"), function)(Scale())
        except NotHereError as error:
            print(f"left as it is: {name}: {error}")
            continue
        yield from keep_picture(DATA / drawn, name)


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.exit(__doc__)
    # One name each time, for a page shows it.
    into = Path(tempfile.gettempdir()) / "ddic_pictures"
    shutil.rmtree(into, ignore_errors=True)
    for path in chain(draw_examples(into), draw_pages(into), draw_measured()):
        print(f"replaced: {path.stem}", flush=True)
    shutil.rmtree(into)
