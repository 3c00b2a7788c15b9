"""Displacement on a regular grid."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ddic.images.rigid import GridField, build_uniform_field, fill_absent


@given(seed=st.integers(0, 2**32 - 1))
def test_bilinear_functions_are_reproduced(seed: int) -> None:
    rng = np.random.default_rng(seed)
    c = rng.uniform(-1, 1, (2, 4))

    def field(points: np.ndarray) -> np.ndarray:
        x, y = points.T / 50
        return np.stack([a + b * x + d * y + e * x * y for a, b, d, e in c], axis=1)

    origin, spacing = (12.5, -3.0), (4.0, 7.5)
    x, y = np.meshgrid(origin[0] + spacing[0] * np.arange(9), origin[1] + spacing[1] * np.arange(6))
    values = field(np.column_stack([x.ravel(), y.ravel()])).reshape(6, 9, 2)
    points = rng.uniform((12.5, -3.0), (12.5 + 32, -3.0 + 37.5), (40, 2))
    # Rounding of float64.
    np.testing.assert_allclose(GridField(origin, spacing, values).at(points), field(points), atol=1e-12)


def test_field_is_constant_beyond_the_grid() -> None:
    values = np.arange(12.0).reshape(2, 3, 2)
    field = GridField((10.0, 20.0), (5.0, 5.0), values)
    points = np.array([[-100.0, -100.0], [100.0, 100.0], [15.0, 1000.0]])
    np.testing.assert_array_equal(field.at(points), [values[0, 0], values[1, 2], values[1, 1]])


def test_uniform_field_is_the_shift_everywhere() -> None:
    points = np.array([[0.0, 0.0], [1e4, -3.5], [-7.25, 12.0]])
    np.testing.assert_array_equal(build_uniform_field((1.5, -2.25)).at(points), [[1.5, -2.25]] * 3)


def test_absent_nodes_take_the_nearest_value() -> None:
    values = np.full((3, 4, 2), np.nan)
    values[0, 0], values[2, 3] = (1.0, 2.0), (3.0, 4.0)
    filled = fill_absent(values)
    assert filled[0, 1].tolist() == [1.0, 2.0]
    assert filled[1, 0].tolist() == [1.0, 2.0]
    assert filled[2, 2].tolist() == [3.0, 4.0]
    assert filled[1, 3].tolist() == [3.0, 4.0]
    assert np.isfinite(filled).all()


def test_full_grid_is_left_as_it_is() -> None:
    values = np.random.default_rng(0).normal(size=(3, 4, 2))
    assert fill_absent(values) is values
