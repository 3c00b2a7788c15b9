"""Slices of volumes: what is sampled on them is the field there, what is read are the voxels there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.mesh.mesh import Mesh
from ddic.plots import slices as of_volumes
from ddic.plots.canvas import LengthUnit
from ddic.plots.slices import Slice, choose_slices, make_views
from support.volume_results import BOX, HOLE, SIZES, build_volume_mesh, displace, make_volume

MM = LengthUnit(0.5, "mm")


def points_of(one: Slice) -> NDArray[np.float64]:
    """Its points in space, (rows, columns, 3)."""
    points = np.full((*one.shape, 3), one.place)
    points[..., one.columns] = one.points
    return points


def is_in_hole(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    return ((points > HOLE[0]) & (points < HOLE[1])).all(axis=-1)


@pytest.fixture(params=["Hex8", "Tet4"])
def mesh(request: pytest.FixtureRequest) -> Mesh:
    return build_volume_mesh(request.param)


def test_what_is_sampled_is_the_field_and_nothing_in_a_hole(mesh: Mesh) -> None:
    asked = [("z", 20.0), ("x", 25.5), ("y", 20.0), ("z", 31.25)]
    for one in choose_slices(mesh, None, asked):
        points = points_of(one)
        sampled = one.sample(displace(mesh.nodes)[:, 2])
        expected = np.where(is_in_hole(points), np.nan, displace(points.reshape(-1, 3))[:, 2].reshape(one.shape))
        # A linear field is interpolated to rounding; its values are below 1.
        np.testing.assert_allclose(sampled, expected, rtol=0, atol=1e-13)
        assert np.isnan(sampled).any() == (one.place != 31.25)


def test_values_on_cells_are_those_of_the_cell_that_holds_the_point() -> None:
    mesh = build_volume_mesh()
    for one in choose_slices(mesh, None, [("x", 25.5), ("z", 20.0)]):
        points = points_of(one)
        in_cells = (points - BOX[:3]) / 8.0
        middles = (np.floor(in_cells) + 0.5) * 8.0 + BOX[:3]
        # Points on the edge of two cells are in either.
        is_inside = (np.abs(in_cells - np.rint(in_cells)) > 1e-9).all(axis=-1)
        assert is_inside.mean() > 0.99
        for k in range(3):
            sampled = one.sample(mesh.centroids[:, k], by_cell=True)
            expected = np.where(is_in_hole(points), np.nan, middles[..., k])
            np.testing.assert_allclose(sampled[is_inside], expected[is_inside], atol=1e-12)
        # An edge lies between two cells, a point wide: cells are wider than 60 points.
        assert 0.0 < one.edges.mean() < 2.0 / 60.0


def test_the_points_fill_the_mesh_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_volumes, "N_SAMPLES", 48)
    (one,) = choose_slices(build_volume_mesh(), None, [("x", 25.5)])
    # z across, y down, a point a voxel.
    assert one.shape == (32, 24)
    np.testing.assert_allclose(one.points[0, :, 0], np.arange(10.5, 34.0))
    np.testing.assert_allclose(one.points[:, 0, 1], np.arange(8.5, 40.0))


def test_planes_of_voxels_lie_as_they_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    grey, mesh = make_volume(), build_volume_mesh()
    volume = ArraySource(Path("f"), grey, 255.0)
    z, x, y = choose_slices(mesh, volume, [("z", 20.4), ("x", 7.0), ("y", 38.6)])
    assert z.grey is not None
    assert x.grey is not None
    assert y.grey is not None
    # x across and y down; z across and y down; x across and z down.
    np.testing.assert_array_equal(z.grey.pixels, grey[20])
    np.testing.assert_array_equal(x.grey.pixels, grey[:, :, 7].T)
    np.testing.assert_array_equal(y.grey.pixels, grey[:, 39])
    assert (x.grey.width, x.grey.height) == (SIZES[2], SIZES[1])
    # The mesh and 6 % of its longest side (48), but no more than there is of the volume.
    np.testing.assert_allclose(x.shown, (10 - 2.88, 8 - 2.88, 34 + 2.88, 40 + 2.88))
    np.testing.assert_allclose(y.shown, (6 - 2.88, 10 - 2.88, 54 + 2.88, 34 + 2.88))
    monkeypatch.setattr(of_volumes, "LARGEST_SIDE", 20)
    thinned = z.read(volume.read, volume.extent)
    assert thinned.step == 3
    np.testing.assert_array_equal(thinned.pixels, grey[20, ::3, ::3])


def test_slices_go_through_the_middle_of_cells_and_whole_voxels() -> None:
    chosen = choose_slices(build_volume_mesh(box=(6.25, 8.0, 10.0, 54.25, 40.0, 34.0)), None)
    # The middles of x and y, 30.25 and 24, lie between cells; the nearest middles of cells are 4 off.
    assert [one.describe(LengthUnit()) for one in chosen] == ["z = 22 px", "x = 26 px", "y = 20 px"]
    assert chosen[1].describe(MM) == "x = 13 mm"


@pytest.mark.parametrize("asked", [("x", 5.9), ("z", 34.1), ("y", -3.0)])
def test_a_slice_that_misses_the_mesh_is_refused(asked: tuple[str, float]) -> None:
    with pytest.raises(InputError, match=rf"--slice {asked[0]}={asked[1]:g}: the mesh lies between {asked[0]} = "):
        choose_slices(build_volume_mesh(), None, [asked])


def test_orthogonal_views_share_axes_and_scale() -> None:
    chosen = choose_slices(build_volume_mesh(), None, [("y", 21.0), ("z", 14.0), ("x", 44.0)])
    figure, (views, other) = make_views(chosen, ["one", "other"], MM)
    y, z, x = views.axes
    assert z.get_xlim() == y.get_xlim()
    assert z.get_ylim() == x.get_ylim()
    assert z.yaxis_inverted() and y.yaxis_inverted()  # noqa: PT018
    assert x.get_xlim() == y.get_ylim()[::-1]
    places = [axes.get_position() for axes in (z, x, y)]
    assert places[0].x0 == pytest.approx(places[2].x0)
    assert places[0].y0 == pytest.approx(places[1].y0)
    assert places[2].y1 < places[0].y0
    assert places[1].x0 > places[0].x1
    inches = figure.get_size_inches()
    scales = [place.size * inches / np.abs([np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())])
              for place, axes in zip(places, (z, x, y), strict=True)]
    np.testing.assert_allclose(scales, scales[0][0])
    # Lines where the others cut it, twice for their two colours.
    assert [line.get_xdata()[0] for line in z.lines if line.get_ydata()[0] == 0] == [22.0, 22.0]
    assert [line.get_ydata()[0] for line in z.lines if line.get_xdata()[0] == 0] == [10.5, 10.5]
    named = [axes.get_title(loc="left") or axes.get_title(loc="right") for axes in other.axes]
    assert named == ["y = 10.5 mm", "z = 7 mm", "x = 22 mm"]
    assert [host.get_title() for host in (*views.hosts, *other.hosts)] == ["one", "other"]


def test_other_slices_are_panels_of_their_own() -> None:
    chosen = choose_slices(build_volume_mesh(), None, [("z", 12.0), ("z", 30.0)])
    _, (views,) = make_views(chosen, ["field"])
    assert [axes.get_title() for axes in views.axes] == ["field, z = 12 px", "field, z = 30 px"]
    assert views.hosts == views.axes
    assert not views.axes[0].lines
