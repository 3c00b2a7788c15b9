"""Vectors of the plane."""

from __future__ import annotations

import numpy as np

from ddic.mesh.plane import compute_normals, multiply_across
from ddic.mesh.rotation import Rotation, build_rotation

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


def test_a_rotation_is_undone_by_its_inverse() -> None:
    vectors = np.random.default_rng(2).normal(size=(20, 2))
    rotation = Rotation(np.array([0.7]))
    np.testing.assert_array_equal(rotation.apply(vectors), vectors @ build_rotation(0.7).T)
    np.testing.assert_allclose(rotation.apply_inverse(rotation.apply(vectors)), vectors, atol=10 * ROUNDING)


def test_normals_are_turned_by_a_quarter() -> None:
    vectors = np.random.default_rng(3).normal(size=(20, 2))
    quarter = Rotation(np.array([np.pi / 2]))
    np.testing.assert_allclose(compute_normals(vectors), quarter.apply(vectors), atol=10 * ROUNDING)
