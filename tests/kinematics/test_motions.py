"""Affine maps through neighbours of which one may be wrong."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ddic.kinematics.motions import fit_robustly, interpolate_robustly


@given(seed=st.integers(0, 10**6), n_wrong=st.integers(0, 1))
def test_an_affine_map_is_found_beside_a_wrong_neighbour(seed: int, n_wrong: int) -> None:
    random = np.random.default_rng(seed)
    offsets = random.uniform(-20, 20, (5, 12, 2))
    value, gradient = random.normal(0, 10, 2), random.normal(0, 0.5, (2, 2))
    displacement = value + offsets @ gradient.T
    displacement[:, :n_wrong] += random.normal(0, 100, (5, n_wrong, 2))
    # Least sum of distances nearly ignores an outlier; the ridge moves a value by some 1e-6 of the gradient's part.
    tolerance = 1e-3 if n_wrong == 0 else 0.3
    np.testing.assert_allclose(fit_robustly(offsets, displacement), np.tile(value, (5, 1)), atol=tolerance)


def test_collinear_neighbours_give_a_value() -> None:
    offsets = np.zeros((1, 12, 2))
    offsets[0, :, 0] = np.linspace(-5, 6, 12)
    found = fit_robustly(offsets, 2.0 + offsets * 0.1)
    np.testing.assert_allclose(found, [[2.0, 2.0]], atol=1e-3)


def test_a_point_does_not_predict_itself() -> None:
    points = np.random.default_rng(0).uniform(0, 100, (13, 2))
    displacement = 0.1 * points
    displacement[0] = 50.0
    predicted = interpolate_robustly(points, displacement, points, skip=1)
    np.testing.assert_allclose(predicted[0], 0.1 * points[0], atol=1e-2)
