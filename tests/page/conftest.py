from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from ddic.page.draw import make_draw_page
from ddic.page.drawn_case import DrawnCase, open_drawn_case
from support.cases import write_images
from support.page_tab import Jobs, Tab, hold_jobs

OpenDraw = Callable[..., Tab]


@pytest.fixture(scope="session")
def image_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """f.tif and g.tif, 192 x 192 px, and their displacement is WAVES."""
    folder = tmp_path_factory.mktemp("images")
    write_images(folder)
    return folder


@pytest.fixture
def folder(image_folder: Path, tmp_path: Path) -> Path:
    """A folder of the test's own with both images."""
    for name in ("f.tif", "g.tif"):
        shutil.copy(image_folder / name, tmp_path / name)
    return tmp_path


@pytest.fixture
def jobs(monkeypatch: pytest.MonkeyPatch) -> Jobs:
    return hold_jobs(monkeypatch)


@pytest.fixture
def drawn(folder: Path) -> DrawnCase:
    """What ``ddic draw f.tif --deformed g.tif`` draws on."""
    return open_drawn_case(folder / "f.tif", folder / "case.toml", [folder / "g.tif"])


@pytest.fixture
def open_draw(folder: Path, jobs: Jobs) -> OpenDraw:
    """Open a tab of ``ddic draw`` on a text, or on the case that it starts from."""
    def open_tab(text: str | None = None) -> Tab:
        if text is not None:
            (folder / "case.toml").write_text(text, encoding="utf-8")
        case = open_drawn_case(folder / "f.tif", folder / "case.toml", [folder / "g.tif"] if text is None else [])
        return Tab(partial(make_draw_page, case), jobs)

    return open_tab
