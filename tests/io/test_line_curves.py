"""Curves along a line, and their bands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ddic
from ddic.errors import InputError
from ddic.plots.curves import BAND, draw_line
from support.small_pair import SIZE, move


@pytest.fixture(scope="module")
def result() -> ddic.Result:
    pair = ddic.make_synthetic_pair(move, SIZE)
    return ddic.measure(pair, ddic.structured_mesh((10, 10, 150, 130), 20), output={"uncertainty": True})


def test_the_band_is_two_standard_deviations_wide(result: ddic.Result) -> None:
    figure = draw_line(result, (10.0, 70.0, 150.0, 70.0))
    above, below = figure.axes
    assert [len(axes.collections) for axes in (above, below)] == [2, 3]
    # At the line's end lies a node.
    node = int(np.flatnonzero((result.mesh.nodes == [10.0, 70.0]).all(axis=1))[0])
    vertices = above.collections[0].get_paths()[0].vertices
    at_begin = vertices[np.isclose(vertices[:, 0], 0.0), 1]
    sigma = result.point_data["sigma_u"][node]
    # The same numbers, added and subtracted.
    assert np.ptp(at_begin) == pytest.approx(2 * BAND * sigma, rel=1e-9)
    assert at_begin.mean() == pytest.approx(result.displacement[node, 0], abs=BAND * sigma)


def test_the_band_of_a_regularized_displacement_counts_its_bias(result: ddic.Result) -> None:
    bias = np.zeros((result.mesh.n_nodes, 3))
    bias[:, 0] = 0.3
    biased = replace(result, point_data={**result.point_data, "regularization_bias": bias})
    above, below = draw_line(biased, (10.0, 70.0, 150.0, 70.0)).axes
    node = int(np.flatnonzero((result.mesh.nodes == [10.0, 70.0]).all(axis=1))[0])
    widths = []
    for axes, k in ((above, 0), (above, 1), (below, 0)):
        vertices = axes.collections[k].get_paths()[0].vertices
        widths.append(np.ptp(vertices[np.isclose(vertices[:, 0], 0.0), 1]) / (2 * BAND))
    # Strains are told without it.
    expected = [np.hypot(result.point_data["sigma_u"][node], 0.3), result.point_data["sigma_v"][node],
                result.point_data["sigma_exx"][node]]
    np.testing.assert_allclose(widths, expected, rtol=1e-9)


def test_there_is_no_band_without_standard_deviations(result: ddic.Result) -> None:
    without = replace(result, point_data={name: values for name, values in result.point_data.items()
                                          if not name.startswith("sigma")})
    assert not [axes for axes in draw_line(without, (10.0, 70.0, 150.0, 70.0)).axes if len(axes.collections)]


def test_a_line_beside_the_mesh_is_refused(result: ddic.Result) -> None:
    with pytest.raises(InputError, match=r"--line 0 0 5 5: no point of it lies in the measured mesh"):
        draw_line(result, (0.0, 0.0, 5.0, 5.0))
