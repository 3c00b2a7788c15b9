"""``ddic plot`` and ``ddic info`` of a series."""

from __future__ import annotations

import shutil
import stat
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image

from accept.report_page import find_clipped_texts
from ddic.cli.info import info
from ddic.cli.plot import plot
from ddic.cli.plot_figures import find_shared_scale
from ddic.cli.tables import crack, export, opening
from ddic.io.series_reader import gather_history, read_series
from ddic.plots.canvas import PIXELS, ColourScale, LengthUnit, draw_caption
from ddic.plots.figures import Look
from ddic.plots.maps import StrainChoice, draw_deformed, draw_strain
from ddic.plots.series import draw_time_curves
from support.series_files import STRAIN, FrameFile, write_series_file

FRAMES = [FrameFile(0.5), FrameFile(1.0, 0), FrameFile(2.0, 3), FrameFile(3.0)]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_series_file(tmp_path_factory.mktemp("series") / "s.vtkhdf", FRAMES, residual=True)


@pytest.fixture
def series(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path))


def run(command: object, *words: object) -> Result:
    return CliRunner().invoke(command, [str(word) for word in words])  # type: ignore[arg-type]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.suffix not in (".vtkhdf",))


def test_info_lists_the_frames(series: Path) -> None:
    outcome = run(info, series)
    assert outcome.exit_code == 0, outcome.output
    lines = outcome.output.splitlines()
    assert "frames                      4, 1 of them not measured" in lines
    assert "times                       0.5 to 3" in lines
    assert "displacement x              0.0500 to 1.5000 px in all frames" in lines
    head = next(k for k, line in enumerate(lines) if line.startswith("frame "))
    table = [line.split() for line in lines[head + 1:head + 5]]
    assert table[0] == ["1", "0.5", "frame_1.tif", "3", "1.100", "0.0040", "a", "search"]
    assert table[1][:5] == ["2", "1", "frame_2.tif", "not", "measured:"]
    assert table[3] == ["4", "3", "frame_4.tif", "6", "1.400", "0.0040", "the", "last", "frame"]
    # Columns of numbers end in one place.
    assert len({lines[head + k].index(word) + len(word) for k, word in ((1, "1.100"), (3, "1.300"), (4, "1.400"))}) == 1
    assert "of frame 1:" in lines
    assert any(line.split() == ["node", "field", "displacement"] for line in lines)


def test_info_of_a_frame_is_that_of_a_pair(series: Path) -> None:
    outcome = run(info, series, "--frame", 3)
    assert outcome.exit_code == 0, outcome.output
    assert "displacement x              0.2000 to 1.0000 px" in outcome.output
    assert "subdomains                  3" in outcome.output


def test_default_of_a_series_is_its_curves(series: Path, tmp_path: Path) -> None:
    for words in ((), ("--kind", "curves")):
        outcome = run(plot, series, "--output", tmp_path / "drawn", *words)
        assert outcome.exit_code == 0, outcome.output
        assert names(tmp_path / "drawn") == ["s.curves.png"]


def test_curves_hold_what_was_measured_and_mark_what_was_not(series: Path) -> None:
    history = gather_history(read_series(series))
    figure = draw_time_curves(history, "s.vtkhdf", LengthUnit(0.5, "mm"))
    assert find_clipped_texts(figure) == []
    displacement, strain, residual, _, iterations = figure.axes
    curves = {line.get_label(): line for line in displacement.lines}
    np.testing.assert_allclose(curves["$u_x$, mean"].get_ydata(), 0.5 * history.mean[:, 0])
    for axes in figure.axes:
        marks = [line for line in axes.lines if line.get_linestyle() == "--"]
        assert [list(mark.get_xdata()) for mark in marks] == [[1.0, 1.0]]
    np.testing.assert_allclose(strain.lines[0].get_ydata(), STRAIN * np.array([0.5, np.nan, 2.0, 3.0]))
    np.testing.assert_allclose(residual.lines[0].get_ydata(), [1.1, np.nan, 1.3, 1.4])
    assert residual.get_ylim()[1] > 1.4
    ticks = iterations.get_yticks()
    assert (ticks == ticks.round()).all()


@pytest.mark.parametrize("name", ["s.vtkhdf", "name_as_long_as_people_make_them_when_they_number_specimens_" * 3])
@pytest.mark.parametrize("frames", [[FrameFile(1.0)], [FrameFile(1e-6), FrameFile(2e5)]], ids=["one", "far apart"])
def test_no_text_of_the_curves_is_cut(tmp_path: Path, frames: list[FrameFile], name: str) -> None:
    history = gather_history(read_series(write_series_file(tmp_path / "s.vtkhdf", frames)))
    assert find_clipped_texts(draw_time_curves(history, name, PIXELS)) == []


def test_a_frame_is_drawn_as_a_pair_with_its_number_and_time(series: Path, tmp_path: Path) -> None:
    outcome = run(plot, series, "--frame", 3, "--output", tmp_path / "drawn")
    assert outcome.exit_code == 0, outcome.output
    kinds = ("deformed", "krylov", "partition", "residual", "strain")
    assert names(tmp_path / "drawn") == [f"s.frame_3.{kind}.png" for kind in kinds]
    figure = draw_strain(read_series(series)[1], StrainChoice())
    height = figure.get_size_inches()[1]
    draw_caption(figure, "frame 3, time 2")
    assert find_clipped_texts(figure) == []
    assert figure.get_size_inches()[1] > height


@pytest.mark.parametrize(("words", "line"), [
    (("--kind", "strain"), "choose one by --frame, or give --animate"),
    (("--animate",), "--animate: of one --kind of deformed, displacement, strain, residual, signed-residual, not all"),
    (("--animate", "--kind", "krylov"), "not krylov"),
    (("--animate", "--kind", "strain", "--frame", "1"), "--animate and --frame: give one of them"),
    (("--frame", "1", "--kind", "curves"), "--kind curves: of all frames; leave --frame out"),
    (("--frame", "2"), "frame 2 was not measured"),
    (("--format", "gif"), "without --animate a picture is one of png, pdf, svg"),
    (("--animate", "--kind", "strain", "--format", "pdf"), "an animation is one of gif, mp4"),
])
def test_what_cannot_be_drawn_is_refused_by_a_line(series: Path, words: tuple[str, ...], line: str) -> None:
    outcome = run(plot, series, *words)
    assert outcome.exit_code == 2
    assert line in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1
    assert names(series.parent) == []


@pytest.mark.parametrize("words", [("--animate", "--kind", "strain"), ("--kind", "curves"), ("--frame", "1")])
def test_a_pair_is_no_series(tmp_path: Path, write_result: Callable[..., Path], words: tuple[str, ...]) -> None:
    outcome = run(plot, write_result(tmp_path / "r.vtkhdf"), *words)
    assert outcome.exit_code == 2
    assert "is the result of a pair" in outcome.stderr
    assert names(tmp_path) == []


@pytest.mark.parametrize("kind", ["deformed", "displacement", "strain", "residual", "signed-residual"])
def test_animations_have_a_page_a_frame(series: Path, kind: str) -> None:
    outcome = run(plot, series, "--animate", "--kind", kind, "--fps", 4, "--dpi", 41)
    assert outcome.exit_code == 0, outcome.output
    with Image.open(series.with_name(f"s.{kind}.gif")) as pages:
        assert pages.n_frames == 3
        assert pages.info["duration"] == 250
        # White stays white in 256 colours, and what is on the pages differs.
        shown = []
        for k in range(3):
            pages.seek(k)
            shown.append(np.asarray(pages.convert("RGB")).astype(int))
        assert all((page[0, 0] == 255).all() for page in shown)
        assert all(np.abs(one - other).max() > 50 for one, other in pairwise(shown))


def test_colours_and_axes_of_an_animation_suit_all_frames(series: Path) -> None:
    look = Look("x", StrainChoice(), None, LengthUnit(0.5, "mm"), ColourScale(percentiles=(0.0, 100.0)))
    opened = read_series(series)
    scale = find_shared_scale(opened, "displacement", look)
    (of_panel,) = scale.scales
    np.testing.assert_allclose(of_panel.limits or (), (0.5 * 0.5 * STRAIN * 10, 0.5 * 3 * STRAIN * 50))
    panels = [of_panel.limits or () for of_panel in find_shared_scale(opened, "strain", look).scales]
    np.testing.assert_allclose(panels[0], (0.5 * STRAIN, 3 * STRAIN), rtol=1e-5)
    np.testing.assert_allclose(panels[1], (-1.5 * STRAIN, -0.25 * STRAIN), rtol=1e-5)
    # Colours of one value need a span: rounding's.
    np.testing.assert_allclose(panels[2], (0, 0), atol=1e-12)
    asked = find_shared_scale(opened, "strain", Look("x", scale=ColourScale((0.0, 1.0))))
    assert [of_panel.limits for of_panel in asked.scales] == [(0.0, 1.0)] * 3
    # Residuals are 1, 3 and 4 everywhere.
    assert find_shared_scale(opened, "residual", look).scales[0].limits == (0.0, 4.0)
    assert find_shared_scale(opened, "signed-residual", look).scales[0].limits == (-4.0, 4.0)
    # Of percentiles the bar says that they are, in every frame.
    (by_percentiles,) = find_shared_scale(opened, "displacement", Look("x")).scales
    assert by_percentiles.format_label("u") == "u\n2 to 98 % of the values"


@pytest.mark.parametrize("amplification", [None, 5.0, -5.0])
def test_deformed_meshes_of_an_animation_are_amplified_alike_and_stay_on_the_page(series: Path,
                                                                               amplification: float | None) -> None:
    opened = read_series(series)
    view = find_shared_scale(opened, "deformed", Look("x", StrainChoice(), amplification)).view
    assert view is not None
    titles = set()
    for result in opened:
        axes = draw_deformed(result, "x", amplification, shared=view).axes[0]
        titles.add(axes.get_title())
        assert (*axes.get_xlim(), *axes.get_ylim()[::-1]) == (view.bounds[0], view.bounds[2], view.bounds[1],
                                                              view.bounds[3])
        corners = np.concatenate([path.vertices for drawn in axes.collections for path in drawn.get_paths()])
        assert (corners >= view.bounds[:2]).all()
        assert (corners <= view.bounds[2:]).all()
    # One factor, that of the frame that moves most.
    assert len(titles) == 1


def test_mp4_needs_ffmpeg(series: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    outcome = run(plot, series, "--animate", "--kind", "strain", "--format", "mp4")
    assert outcome.exit_code == 2
    assert outcome.stderr == ("--format mp4: ffmpeg is not on the path; install it, or leave --format out (GIF)\n")
    assert names(series.parent) == []


def test_mp4_is_what_ffmpeg_makes_of_pages_of_one_even_size(series: Path, monkeypatch: pytest.MonkeyPatch,
                                                          tmp_path: Path) -> None:
    # In place of ffmpeg, which is not everywhere: it notes its words, and the bytes that it is given.
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text('#!/bin/sh\necho "$@" > "$(dirname "$0")/words"\nfor last; do :; done\ncat > "$last"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    outcome = run(plot, series, "--animate", "--kind", "residual", "--format", "mp4", "--dpi", 41, "--fps", 4)
    assert outcome.exit_code == 0, outcome.output
    words = (folder / "words").read_text().split()
    width, height = (int(size) for size in words[words.index("-s") + 1].split("x"))
    assert (width % 2, height % 2) == (0, 0)
    assert float(words[words.index("-framerate" if "-framerate" in words else "-r") + 1]) == 4
    assert series.with_name("s.residual.mp4").stat().st_size == 3 * 4 * width * height


def test_a_failure_of_ffmpeg_is_a_line(series: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text("#!/bin/sh\ncat > /dev/null\nexit 3\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    outcome = run(plot, series, "--animate", "--kind", "residual", "--format", "mp4", "--dpi", 41)
    assert outcome.exit_code == 2
    assert "ffmpeg failed" in outcome.stderr
    assert not series.with_name("s.residual.mp4").exists()


@pytest.mark.parametrize("command", [opening, crack])
def test_other_commands_ask_for_a_frame(series: Path, command: object) -> None:
    outcome = run(command, series)
    assert outcome.exit_code == 2
    assert "choose one by --frame" in outcome.stderr
    taken = run(command, series, "--frame", 1)
    # The frame is read; it has no line.
    assert "without discontinuities" in taken.stderr


def test_fields_of_a_frame_are_exported(series: Path) -> None:
    assert "choose one by --frame" in run(export, series).stderr
    outcome = run(export, series, "--frame", 3)
    assert outcome.exit_code == 0, outcome.output
    assert names(series.parent) == ["s.frame_3.cells.csv", "s.frame_3.nodes.csv"]
    rows = (series.parent / "s.frame_3.cells.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + 8
