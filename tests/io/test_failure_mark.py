"""Pictures of fields that did not converge say so, whatever they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from accept.report_page import find_clipped_texts
from ddic.cli.plot import plot
from ddic.fracture.opening import Opening
from ddic.io.result_reader import Result, read_result
from ddic.io.result_schema import CAMERA, FAILURE, STATUS
from ddic.plots.canvas import WORDS, draw_failures
from ddic.plots.curves import draw_corrections, draw_krylov, draw_modes, draw_opening
from ddic.plots.maps import (
    StrainChoice,
    compute_difference,
    draw_deformed,
    draw_difference,
    draw_displacement,
    draw_near_far,
    draw_residual,
    draw_strain,
)
from ddic.plots.partition import draw_partition
from ddic.separated.field import SeparatedField
from support.separated import lines

Write = Callable[..., Path]
pytestmark = pytest.mark.filterwarnings("ignore:.*did not converge:UserWarning")

OPENING = Opening(np.arange(5.0), np.zeros((5, 2)), np.ones(5), np.ones(5), np.zeros(5, np.uint8), np.zeros(5, bool))
TABLE = {name: np.arange(1.0, 4.0) for name in ("correction", "fluctuation_x", "fluctuation_y", "relative_x",
                                               "relative_y", "relative", "gain", "noise_gain",
                                               "residual_std_grey")}


def _modes() -> SeparatedField:
    along_x, along_y = lines((0.0, 0.0, 40.0, 30.0), 10.0)
    return SeparatedField(along_x, along_y, np.ones((1, 2)), np.ones((1, 2, 5)), np.ones((1, 2, 4)))


def _two_cameras(result: Result) -> Result:
    camera = (result.mesh.centroids[:, 0] < 15).astype(np.int32)
    return replace(result, cell_data={**result.cell_data, CAMERA: camera},
                   attributes={**result.attributes, "near_1": {"alpha_px": np.zeros(2)}})


DRAWN: dict[str, Callable[[Result], Figure]] = {
    "partition": draw_partition, "deformed": draw_deformed, "displacement": draw_displacement,
    "strain": lambda result: draw_strain(result, StrainChoice(by_cell=True)), "residual": draw_residual,
    "signed-residual": lambda result: draw_residual(result, signed=True),
    "difference": lambda result: draw_difference(compute_difference(result, result)),
    "krylov": lambda result: draw_krylov({"": result.krylov}), "opening": lambda _: draw_opening({"line 1": OPENING}),
    "near-far": lambda result: draw_near_far(_two_cameras(result)), "modes": lambda _: draw_modes(_modes()),
    "corrections": lambda _: draw_corrections(TABLE)}


@pytest.fixture
def result(tmp_path: Path, write_result: Write) -> Result:
    return read_result(write_result(tmp_path / "r.vtkhdf"))


def _sizes(figure: Figure) -> list[list[float]]:
    """Inches of all axes."""
    return [(axes.get_position().size * figure.get_size_inches()).tolist() for axes in figure.axes]


def _find_marks(figure: Figure) -> list[Text]:
    return [text for text in figure.texts if WORDS in " ".join(text.get_text().split())]


@pytest.mark.parametrize("kind", DRAWN)
def test_the_mark_stands_above_all_that_a_page_shows(result: Result, kind: str) -> None:
    figure = DRAWN[kind](result)
    FigureCanvasAgg(figure).draw()
    before, height = _sizes(figure), figure.get_size_inches()[1]
    draw_failures(figure, [replace(result, failure="did not converge in 1 iterations")])
    (mark,) = _find_marks(figure)
    assert find_clipped_texts(figure) == []
    canvas = FigureCanvasAgg(figure)
    renderer = canvas.get_renderer()
    below = mark.get_window_extent(renderer).y0
    others = [axes.get_tightbbox(renderer).y1 for axes in figure.axes]
    if figure.get_suptitle():
        (title,) = [text for text in figure.findobj(Text) if text.get_text() == figure.get_suptitle()]
        others.append(title.get_window_extent(renderer).y1)
    # A dot for rounding.
    assert below >= max(others) - 1.0
    # A line and its margin: what is drawn keeps its size, to a tenth of an inch where a layout packs it.
    assert figure.get_size_inches()[1] - height == pytest.approx(0.34)
    np.testing.assert_allclose(_sizes(figure), before, atol=1e-9 if figure.get_layout_engine() is None else 0.1)


@pytest.mark.parametrize("kind", DRAWN)
def test_a_result_that_converged_has_none(result: Result, kind: str) -> None:
    figure = DRAWN[kind](result)
    size = figure.get_size_inches().tolist()
    draw_failures(figure, [result, result])
    assert not _find_marks(figure)
    assert figure.get_size_inches().tolist() == size


def test_of_two_results_the_mark_names_the_one(result: Result) -> None:
    figure = draw_difference(compute_difference(result, result))
    name = "a_long_name_of_a_frame_of_a_long_series_of_images.not_converged.vtkhdf"
    draw_failures(figure, [result, replace(result, path=Path(name), failure="did not")])
    (mark,) = _find_marks(figure)
    # A name without a blank is broken where the line ends.
    assert name in mark.get_text().replace("\n", "")
    assert "r.vtkhdf" not in mark.get_text()
    assert find_clipped_texts(figure) == []


def _plot(arguments: Sequence[str]) -> None:
    # Texts as texts, which can be looked for.
    with rc_context({"svg.fonttype": "none"}):
        outcome = CliRunner().invoke(plot, [*arguments, "--format", "svg"])
    assert outcome.exit_code == 0, outcome.output


def test_every_picture_of_ddic_plot_has_the_mark(tmp_path: Path, write_result: Write) -> None:
    failed, good = write_result(tmp_path / "r.not_converged.vtkhdf"), write_result(tmp_path / "good.vtkhdf")
    with h5py.File(failed, "r+") as file:
        file.attrs[STATUS], file.attrs[FAILURE] = "not converged", "did not converge in 1 iterations"
    for kind in ("all", "displacement", "signed-residual"):
        _plot([str(failed), "--kind", kind, "--other", str(good)])
        _plot([str(good), "--kind", kind, "--other", str(failed)])
    pictures = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.glob("*.svg")}
    of_failed = {"r.not_converged." + kind for kind in ("partition", "deformed", "residual", "difference", "krylov",
                                                        "displacement", "signed-residual")}
    marked = {name.removesuffix(".svg") for name, text in pictures.items() if f">{WORDS}<" in text
              or f"r.not_converged.vtkhdf: {WORDS}" in text}
    # Of the other result, what shows both.
    assert marked == of_failed | {"good.difference", "good.krylov"}
    assert len(pictures) == 2 * len(of_failed)
