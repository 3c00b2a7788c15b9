"""One-dimensional elements: pixels, values, sums and integrals."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.mesh.raster import rasterize
from ddic.mesh.structured import build_structured_mesh
from ddic.separated.field import LineElements
from support.separated import dense

IRREGULAR = LineElements(np.array([2.3, 4.0, 7.5, 12.0, 12.9]))


@pytest.mark.parametrize("region", [(10.0, 10.0, 20.0, 20.0), (9.5, 9.5, 19.5, 21.5), (10.2, 10.7, 19.7, 31.1)])
def test_elements_have_the_pixels_of_q4_on_the_same_lines(region: tuple[float, float, float, float]) -> None:
    mesh = build_structured_mesh(region, 3.0)
    x, y = (LineElements(np.unique(mesh.nodes[:, axis])) for axis in range(2))
    counts = rasterize(mesh).pixel_counts.reshape(y.n_nodes - 1, x.n_nodes - 1)
    assert np.array_equal(np.outer(y.count_pixels(), x.count_pixels()), counts)


def test_values_at_pixels_interpolate_between_nodes() -> None:
    values = np.random.default_rng(0).normal(size=(3, IRREGULAR.n_nodes))
    at = np.arange(IRREGULAR.pixels.start, IRREGULAR.pixels.stop)
    expected = np.stack([np.interp(at, IRREGULAR.nodes, row) for row in values])
    # One multiplication and two additions apart.
    assert np.allclose(IRREGULAR.evaluate_at_pixels(values), expected, rtol=0, atol=1e-14)
    assert np.allclose(IRREGULAR.evaluate(values, at.astype(float)), expected, rtol=0, atol=1e-14)
    assert np.array_equal(IRREGULAR.evaluate(values, np.array([-5.0, 50.0])), values[:, [0, -1]])


def test_sums_against_shape_functions_are_those_of_the_table_of_values() -> None:
    weights = np.random.default_rng(1).uniform(size=len(IRREGULAR.pixels))
    table = IRREGULAR.evaluate_at_pixels(np.eye(IRREGULAR.n_nodes)).T
    assert np.allclose(IRREGULAR.sum_at_nodes(weights), table.T @ weights, rtol=0, atol=1e-14)
    assert np.allclose(dense(IRREGULAR.assemble(weights)), table.T @ (weights[:, None] * table), rtol=0, atol=1e-14)


def test_integrals_are_exact_for_linear_functions() -> None:
    x = IRREGULAR.nodes
    one, cube = np.ones_like(x), (x[-1]**3 - x[0]**3) / 3
    mass, stiffness, mixed = (dense(matrix) for matrix in (IRREGULAR.mass, IRREGULAR.stiffness, IRREGULAR.mixed))
    # Rounding of sums of a few terms of size 1e3.
    assert x @ mass @ x == pytest.approx(cube, rel=1e-14)
    assert one @ mass @ one == pytest.approx(IRREGULAR.length, rel=1e-14)
    assert x @ stiffness @ x == pytest.approx(IRREGULAR.length, rel=1e-14)
    assert np.abs(stiffness @ one).max() <= 1e-14
    assert x @ mixed @ x == pytest.approx((x[-1]**2 - x[0]**2) / 2, rel=1e-14)
