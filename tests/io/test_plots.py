from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from bench.support.near_far_case import CellPanel, draw_cell_panels
from ddic.io.image_file import open_image
from ddic.io.result_reader import Result, read_result
from ddic.mesh.mesh import Mesh
from ddic.plots.canvas import PIXELS, make_triangulation
from ddic.plots.curves import draw_krylov
from ddic.plots.maps import (
    compute_difference,
    draw_deformed,
    draw_difference,
    draw_near_far,
    draw_residual,
    find_shared_view,
    read_preview,
)
from ddic.plots.partition import draw_partition

Write = Callable[..., Path]


@pytest.fixture
def result(tmp_path: Path, write_result: Write) -> Result:
    return read_result(write_result(tmp_path / "r.vtkhdf"))


def cells_drawn(axes: object) -> list[PolyCollection]:
    return [c for c in axes.collections if isinstance(c, PolyCollection)]


def test_partition_boxes_bound_the_subdomains_over_the_image(tmp_path: Path, result: Result) -> None:
    tifffile.imwrite(tmp_path / "f.tif", np.zeros((50, 60), np.uint8))
    axes = draw_partition(result, read_preview(open_image(tmp_path / "f.tif"))).axes[0]
    boxes = sorted(p.get_bbox().extents.tolist() for p in axes.patches if isinstance(p, Rectangle))
    # Two columns of 10 px squares on each side, from (5, 7).
    assert boxes == [[5, 7, 25, 37], [25, 7, 45, 37]]
    # The mesh and a tenth of its longer side (40 px) around it.
    assert axes.get_xlim() == (1, 49)
    assert axes.get_ylim() == (41, 3)
    assert axes.images[0].get_extent() == [-0.5, 59.5, 49.5, -0.5]
    colours = cells_drawn(axes)[0].get_facecolor()
    assert len(colours) == result.mesh.n_cells
    assert len(np.unique(colours, axis=0)) == 2


def test_deformed_cells_are_drawn_where_amplified_displacement_puts_them(result: Result) -> None:
    axes = draw_deformed(result, "x", 3.0).axes[0]
    moved = result.mesh.nodes + 3 * result.displacement
    first = cells_drawn(axes)[-1].get_paths()[0].vertices[:4]
    np.testing.assert_allclose(first, moved[result.mesh.cells[0]])
    assert axes.yaxis_inverted()


def test_chosen_amplification_has_one_digit_and_shows(result: Result) -> None:
    factor = find_shared_view([result], None, PIXELS).factor
    departure = np.abs(result.displacement - result.displacement.mean(axis=0)).max()
    # One digit is at most a third off the wanted 5 % of the longer side (40 px).
    assert 1.3 < factor * departure < 2.7


def test_residual_map_shows_the_absolute_residual_at_its_pixels(result: Result,
                                                                residual: NDArray[np.float32]) -> None:
    figure = draw_residual(result)
    picture = figure.axes[0].images[0]
    np.testing.assert_array_equal(picture.get_array().filled(np.nan), np.abs(residual))
    assert picture.get_extent() == [-0.5, 59.5, 49.5, -0.5]


def test_residual_by_cell_where_there_is_no_residual_image(tmp_path: Path, write_result: Write) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf", residual=False))
    cells = cells_drawn(draw_residual(result).axes[0])[0]
    np.testing.assert_array_equal(cells.get_array(), result.cell_data["residual_rms"])


def test_difference_with_itself_is_zero_and_with_a_flipped_file_too(tmp_path: Path, write_result: Write,
                                                                    result: Result) -> None:
    other = read_result(write_result(tmp_path / "up.vtkhdf", flip_y=True))
    axes = draw_difference(compute_difference(result, other)).axes[0]
    assert "RMS 0.00e+00 px" in axes.get_title()
    assert not axes.collections[0].get_array().any()


def test_krylov_curves_one_line_per_history(result: Result) -> None:
    axes = draw_krylov({"a": result.krylov, "b": [np.array([1.0, 0.0]), np.zeros(0)]}).axes[0]
    assert [line.get_label() for line in axes.lines] == [
        "a, Gauss-Newton 1", "a, Gauss-Newton 2", "b, Gauss-Newton 1"]
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [1.0, 0.1, 0.001])
    assert np.isnan(axes.lines[2].get_ydata()[1])
    assert axes.get_yscale() == "log"


def test_triangles_cover_the_mesh(mesh: Mesh) -> None:
    corners = mesh.nodes[make_triangulation(mesh, mesh.nodes).triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # 12 squares of 100 px^2; float64 products of small integers are exact.
    assert 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() == 1200


def test_previews_keep_every_step_th_pixel_across_bands(tmp_path: Path) -> None:
    pixels = np.arange(4100 * 5, dtype=np.uint16).reshape(4100, 5)
    tifffile.imwrite(tmp_path / "tall.tif", pixels)
    preview = read_preview(open_image(tmp_path / "tall.tif"))
    assert preview.step == 3
    np.testing.assert_array_equal(preview.pixels, pixels[::3, ::3])


@pytest.fixture
def near_far(result: Result) -> Result:
    """A result whose first column of squares (x from 5 to 15) was measured by a near camera."""
    camera = (result.mesh.centroids[:, 0] < 15).astype(np.int32)
    return replace(result, cell_data={**result.cell_data, "Camera": camera},
                   attributes={**result.attributes, "near_1": {"alpha_px": np.array([1.25, -0.5])}})


def test_near_fields_are_outlined_and_shown_in_their_own_colours(near_far: Result) -> None:
    far, near = draw_near_far(near_far, "x").axes[:2]
    for axes in (far, near):
        outline, = (c for c in axes.collections if isinstance(c, LineCollection))
        corners = np.concatenate(outline.get_segments())
        # One by three squares have eight sides on their outline.
        assert len(outline.get_segments()) == 8
        assert corners.min(axis=0).tolist() == [5, 7]
        assert corners.max(axis=0).tolist() == [15, 37]
    # The near field and 12 % of its longer side around it.
    assert near.get_xlim() == pytest.approx((5 - 3.6, 15 + 3.6))
    assert near.get_ylim() == pytest.approx((37 + 3.6, 7 - 3.6))
    assert "(1.250, -0.500) px" in near.get_title()
    x = near_far.mesh.nodes[:, 0]
    for axes, chosen in ((far, x > 0), (near, x < 18.6)):
        u = near_far.displacement[chosen, 0]
        assert axes.collections[0].get_clim() == tuple(np.percentile(u, [2, 98]))


def test_panels_share_the_colours_of_the_last_one(near_far: Result) -> None:
    mesh = near_far.mesh
    values = np.arange(mesh.n_cells, dtype=float)
    near = mesh.create_submesh(np.flatnonzero(near_far.cell_data["Camera"] == 1))[0]
    figure = draw_cell_panels([CellPanel("a", mesh, 100 * values), CellPanel("b", mesh, values)], [near],
                              (0, 0, 50, 50), "value")
    drawn = [cells_drawn(axes)[0] for axes in figure.axes[:2]]
    np.testing.assert_array_equal(drawn[0].get_array(), 100 * values)
    expected = np.percentile(values, [0.5, 99.5])
    for cells in drawn:
        np.testing.assert_allclose(cells.get_clim(), expected)
