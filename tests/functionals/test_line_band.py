"""Pixels near a line do not count, whichever subdomain they are in."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.correlation import read_correlation
from ddic.functionals.line_band import BAND, find_band_pixels
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import is_inside_polygon, measure_distance
from ddic.mesh.raster import rasterize
from ddic.mesh.structured import build_structured_mesh
from ddic.synth.fields import Translation
from support.pictures import pair_of, source

MESH = build_structured_mesh((24, 24, 152, 152), 16)
LINE = np.array([[0.0, 60.3], [200.0, 100.2]])
CUT = cut_mesh(MESH, [LINE]).mesh


def _count_pixels_outside(mesh: Mesh, degree: int) -> np.ndarray:
    raster = rasterize(mesh)
    _, cells = find_band_pixels(mesh, raster, degree)
    return raster.pixel_counts - np.bincount(cells, minlength=mesh.n_cells)


@pytest.mark.parametrize("degree", [3, 5])
def test_band_is_as_wide_as_the_splines_taps_reach(degree: int) -> None:
    pixels, cells = find_band_pixels(CUT, rasterize(CUT), degree)
    y, x = np.mgrid[24:152, 24:152]
    everywhere = np.column_stack([x.ravel(), y.ravel()])
    expected = everywhere[measure_distance(everywhere.astype(float), LINE) <= BAND[degree]]
    assert {tuple(p) for p in pixels.tolist()} == {tuple(p) for p in expected.tolist()}
    counts = _count_pixels_outside(CUT, degree)
    assert counts.sum() == 128**2 - len(expected)
    assert len(cells) == len(expected)


def test_pixels_in_the_band_are_left_out_of_whole_cells_too() -> None:
    reference = source(pair_of(Translation((0.0, 0.0))).reference)
    whole = read_correlation(CUT, reference, 3)
    assert CUT.parts is not None
    counts = _count_pixels_outside(CUT, 3)
    assert whole.n_usable_pixels == counts.sum()
    beside = np.setdiff1d(np.flatnonzero(counts < rasterize(CUT).pixel_counts), CUT.parts.cells)
    # A subdomain of whole cells alone, which the line passes within 2 px.
    assert len(beside)
    part, _ = CUT.create_submesh(beside)
    assert read_correlation(part, reference, 3).n_usable_pixels == counts[beside].sum()


def test_mesh_without_lines_has_no_band() -> None:
    pixels, cells = find_band_pixels(MESH, rasterize(MESH), 3)
    assert len(pixels) == len(cells) == 0


def test_pixels_on_the_wrong_side_of_a_bend_are_left_out() -> None:
    """A polyline that turns back inside a cell, which is cut by the straight line between its ends."""
    bent = np.array([[0.0, 93.1], [95.4, 97.3], [0.0, 101.2]]) + np.array([0.0, 0.2])
    mesh = build_structured_mesh((24, 24, 152, 152), 32)
    cut = cut_mesh(mesh, [bent]).mesh
    assert cut.parts is not None
    (bend,) = cut.parts.lines.bends
    assert len(bend) == 3
    pixels, _ = find_band_pixels(cut, rasterize(cut), 3)
    found = {tuple(p) for p in pixels.tolist()}
    y, x = np.mgrid[24:152, 24:152]
    everywhere = np.column_stack([x.ravel(), y.ravel()])
    expected = (measure_distance(everywhere.astype(float), bent) <= 2.0) | is_inside_polygon(everywhere.astype(float),
                                                                                             bend)
    assert found == {tuple(p) for p in everywhere[expected].tolist()}
