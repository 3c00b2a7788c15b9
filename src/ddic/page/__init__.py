"""Pages in the browser, also within a notebook: cases are drawn, run and looked at (the extra ``ddic[page]``)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from importlib.util import find_spec
from pathlib import Path

from ddic.errors import InputError


def require_page() -> None:
    """Raise InputError where the packages that pages need are not installed."""
    missing = [name for name in ("bokeh", "tomlkit") if find_spec(name) is None]
    if missing:
        raise InputError(f"pages in the browser need {' and '.join(missing)}: {sys.executable} -m pip install "
                         f"{' '.join(missing)}, or make page where ddic was set up by make")


HEIGHT = 900
"""Of a page within a notebook, pixels of the screen."""


@dataclass(frozen=True)
class NotebookPage:
    """A page that is served; a notebook shows it.

    Attributes
    ----------
    address : str
        For a browser on this machine, or at the end of a tunnel with the same port.
    """

    address: str

    def _repr_html_(self) -> str:
        address = escape(self.address)
        return (f'<iframe src="{address}" width="100%" height="{HEIGHT}" style="border: none"></iframe>'
                f'<p><a href="{address}" target="_blank">in a tab of its own</a></p>')


def draw_case(image: Path | str, case: Path | str = "case.toml", deformed: Sequence[Path | str] = ()) -> NotebookPage:
    """Draw a case on its reference image, write it and run it, as ``ddic draw`` does.

    Parameters
    ----------
    image : Path or str
        The reference image.
    case : Path or str, optional
        The case file: opened where it is there, else written by the page.
    deformed : sequence of Path or str, optional
        Images after loading, named in a case that is new.

    Returns
    -------
    NotebookPage
        Shown by a notebook; ``address`` is for a browser.

    Raises
    ------
    InputError
        Where the image or the case cannot be read, or ``ddic[page]`` is not installed.
    """
    require_page()
    from ddic.page.draw import make_draw_page
    from ddic.page.drawn_case import open_drawn_case
    from ddic.page.server import start_in_thread

    # Read later too, wherever the program is by then.
    named = [Path(path).absolute() for path in deformed]
    drawn = open_drawn_case(Path(image).absolute(), Path(case).absolute(), named)
    return NotebookPage(start_in_thread(partial(make_draw_page, drawn)))


def view_results(*paths: Path | str) -> NotebookPage:
    """Look at result files, as ``ddic view`` does; ``Result.view`` and ``SeriesResult.view`` show one.

    Parameters
    ----------
    *paths : Path or str
        The files.

    Returns
    -------
    NotebookPage
        Shown by a notebook; ``address`` is for a browser.

    Raises
    ------
    InputError
        Where one cannot be read, or ``ddic[page]`` is not installed.
    """
    require_page()
    from ddic.page.server import start_in_thread
    from ddic.page.view import make_view_page, open_results

    if Path() in paths:
        raise InputError("result: is in memory only, and a page shows files; measure with output=\"result.vtkhdf\", "
                         "then view the result")
    files = [Path(path).absolute() for path in paths]
    open_results(files)
    return NotebookPage(start_in_thread(partial(make_view_page, files, [])))
