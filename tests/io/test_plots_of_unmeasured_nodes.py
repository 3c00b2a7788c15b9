"""Pictures of a result with nodes that were not measured: nothing is drawn on their cells, everything elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.cli.plot import plot
from ddic.errors import InputError
from ddic.io.result_reader import Result, read_result
from ddic.io.result_schema import CAMERA
from ddic.plots.canvas import OF_VALUES, PIXELS
from ddic.plots.maps import (
    Values,
    compute_difference,
    draw_deformed,
    draw_difference,
    draw_displacement,
    draw_near_far,
    draw_values,
    find_shared_view,
)

Write = Callable[..., Path]

UNMEASURED = (6,)
"""The node at (15, 17): none of the four squares from (5, 7) to (25, 27) has displacements at all corners."""

HOLLOW = ((7.0, 9.0), (23.0, 9.0), (7.0, 25.0), (23.0, 25.0), (24.3, 26.3))
FULL = ((27.0, 9.0), (35.0, 32.0), (7.0, 29.0), (25.7, 27.7))


@pytest.fixture
def part(tmp_path: Path, write_result: Write) -> Result:
    return read_result(write_result(tmp_path / "part.vtkhdf", unmeasured=UNMEASURED))


@pytest.fixture
def whole(tmp_path: Path, write_result: Write) -> Result:
    return read_result(write_result(tmp_path / "whole.vtkhdf"))


def _look(figure: Figure, points: tuple[tuple[float, float], ...], panel: int = 0) -> list[NDArray[np.uint8]]:
    """Colours of a drawn figure at points of an axes."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3]
    places = figure.axes[panel].transData.transform(points)
    return [picture[picture.shape[0] - 1 - int(y), int(x)] for x, y in places]


def _assert_is_hollow(figure: Figure, panel: int = 0, background: int = 255) -> None:
    # A faded triangle is neither white nor grey: colours of viridis differ between red, green and blue.
    assert all((colour == background).all() for colour in _look(figure, HOLLOW, panel))
    assert all(np.ptp(colour.astype(int)) > 20 for colour in _look(figure, FULL, panel))


def test_displacement_is_drawn_on_measured_cells_alone(part: Result, whole: Result) -> None:
    _assert_is_hollow(draw_displacement(part))
    assert all(np.ptp(colour.astype(int)) > 20 for colour in _look(draw_displacement(whole), HOLLOW))


def test_the_difference_is_drawn_where_both_were_measured(part: Result, whole: Result) -> None:
    moved = replace(whole, displacement=whole.displacement + np.array([0.3, 0.4]))
    for one, other in ((part, moved), (moved, part)):
        figure = draw_difference(compute_difference(one, other))
        _assert_is_hollow(figure)
        assert "RMS 5.00e-01 px" in figure.axes[0].get_title()


def test_the_deformed_mesh_is_that_of_measured_cells(part: Result) -> None:
    kept, node_ids = part.mesh.create_submesh(part.mesh.find_cells_among(part.measured_nodes))
    assert kept.n_cells == part.mesh.n_cells - 4
    alone = replace(part, mesh=kept, displacement=part.displacement[node_ids])
    assert find_shared_view([part], None, PIXELS).factor == find_shared_view([alone], None, PIXELS).factor
    for factor in (None, 1.0):
        axes = draw_deformed(part, amplification=factor).axes[0]
        at_rest, _, edges = axes.collections
        # All of the mesh lies in grey below.
        assert len(at_rest.get_paths()) == part.mesh.n_cells
        assert len(edges.get_paths()) == kept.n_cells
        assert np.isfinite(axes.dataLim.extents).all()
        assert "folded" not in axes.get_title()


def test_no_deformed_mesh_is_drawn_where_nothing_was_measured(part: Result) -> None:
    nothing = replace(part, displacement=np.full_like(part.displacement, np.nan))
    with pytest.raises(InputError, match=r"part\.vtkhdf: no cell was measured"):
        draw_deformed(nothing)
    # Others have a page without colours.
    blank = draw_values(part.mesh, [Values("none", "u", nothing.displacement[:, 0])], None, PIXELS, [OF_VALUES])
    assert all((colour == 255).all() for colour in _look(blank, (*HOLLOW, *FULL)))


def test_panels_of_near_fields_have_the_colours_of_what_was_measured(part: Result) -> None:
    cameras = (part.mesh.centroids[:, 0] < 15).astype(int)
    two = replace(part, cell_data={**part.cell_data, CAMERA: cameras},
                  attributes={**part.attributes, "near_1": {"alpha_px": np.zeros(2)}})
    figure = draw_near_far(two)
    # Fields lie on grey.
    _assert_is_hollow(figure, 0, background=153)
    limits = [axes.collections[0].get_clim() for axes in figure.axes[:2]]
    assert np.isfinite(limits).all()


def test_plot_draws_every_kind(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf", unmeasured=UNMEASURED)
    other = write_result(tmp_path / "o.vtkhdf")
    for kind in ("all", "displacement", "signed-residual"):
        outcome = CliRunner().invoke(plot, [str(path), "--kind", kind, "--other", str(other)])
        assert outcome.exit_code == 0, outcome.output
