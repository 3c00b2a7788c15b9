"""Vectors of the plane."""

from __future__ import annotations

import numpy as np

from ddic.mesh.plane import build_rotation, multiply_across

# Rounding of sine and cosine.
ROUNDING = 1e-15


def test_a_quarter_turn_takes_x_to_y() -> None:
    np.testing.assert_allclose(build_rotation(np.pi / 2) @ [1.0, 0.0], [0.0, 1.0], atol=ROUNDING)


def test_a_rotation_keeps_lengths_and_turns_by_its_angle() -> None:
    vectors = np.random.default_rng(1).normal(size=(20, 2))
    turned = vectors @ build_rotation(0.7).T
    lengths = (vectors**2).sum(axis=1)
    np.testing.assert_allclose((vectors * turned).sum(axis=1) / lengths, np.cos(0.7), rtol=10 * ROUNDING)
    np.testing.assert_allclose(multiply_across(vectors, turned) / lengths, np.sin(0.7), rtol=10 * ROUNDING)
