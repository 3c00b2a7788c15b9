"""The picture of a sweep shows what was found, and the recommendation."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ddic.plots.curves import SweptElements, draw_sweep

LENGTHS = np.array([0.0, 32.0, 64.0, 128.0])


def sweep_of(recommended: int | None) -> SweptElements:
    residuals, gaps = np.array([1.0, 1.1, 1.2, np.nan]), np.array([1e-3, 1e-4, 1e-5, np.nan])
    errors = np.array([0.02, 0.01, 0.03, np.nan])
    return SweptElements("8 px", LENGTHS, residuals, gaps, errors - 0.015, errors, recommended)


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_every_panel_has_the_points_and_one_ring() -> None:
    figure = draw_sweep([sweep_of(1), sweep_of(None)], "recommended: all of it")
    corner, residual, error = figure.axes
    for axes, x, y in ((corner, 1e-4, 1.1), (residual, 32.0, 1.1), (error, 32.0, 0.01)):
        rings = [line for line in axes.lines if line.get_markersize() > 10]
        assert len(rings) == 1
        assert (float(rings[0].get_xdata()[0]), float(rings[0].get_ydata()[0])) == (x, y)  # type: ignore[index]
    # None stands left of the shortest; the last was not measured.
    assert texts(figure) == ["64", "32", "none"]
    assert [label.get_text() for label in residual.get_xticklabels()] == ["none", "32", "64", "128"]
    dotted = next(line for line in error.lines if line.get_linestyle() == ":" and len(np.asarray(line.get_ydata())))
    # A prediction below zero is none.
    assert np.isfinite(np.asarray(dotted.get_ydata(), dtype=float)).tolist() == [True, False, True, False]


def test_sweep_of_which_nothing_was_measured_is_drawn() -> None:
    nothing = np.full(4, np.nan)
    figure = draw_sweep([SweptElements("8 px", LENGTHS, nothing, nothing, nothing, nothing, None)], "nothing")
    assert texts(figure) == []
