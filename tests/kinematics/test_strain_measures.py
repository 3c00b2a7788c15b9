"""Strain tensors and the numbers made of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import logm, sqrtm

from ddic.kinematics.strain import (
    compute_green_lagrange,
    compute_hencky,
    compute_infinitesimal,
    compute_von_mises_strain,
    find_principal_strains,
)

GRADIENTS = np.random.default_rng(4).uniform(-0.3, 0.3, (20, 2, 2))


def tensors(components: np.ndarray) -> np.ndarray:
    return components[:, [0, 2, 2, 1]].reshape(-1, 2, 2)


def test_tensors_are_those_of_their_definitions() -> None:
    deformation = np.eye(2) + GRADIENTS
    right = deformation.transpose(0, 2, 1) @ deformation
    np.testing.assert_allclose(tensors(compute_infinitesimal(GRADIENTS)),
                               0.5 * (deformation + deformation.transpose(0, 2, 1)) - np.eye(2), atol=1e-15)
    large = compute_green_lagrange(GRADIENTS)
    np.testing.assert_allclose(tensors(large), 0.5 * (right - np.eye(2)), atol=1e-15)
    expected = [logm(sqrtm(c)) for c in right]
    # scipy's matrix functions are iterations, exact to some rounding.
    np.testing.assert_allclose(tensors(compute_hencky(large)), expected, atol=1e-13)


def test_small_strains_keep_their_digits() -> None:
    tiny = np.array([[1e-9, -2e-9, 5e-10]])
    # ln(1 + 2 E) / 2 = E - E^2: the second term is 1e-9 of the first.
    np.testing.assert_allclose(compute_hencky(tiny), tiny, rtol=1e-8)


def test_principal_values_are_eigenvalues_and_a_pulled_bar_has_its_strain() -> None:
    found = compute_infinitesimal(GRADIENTS)
    np.testing.assert_allclose(find_principal_strains(found)[:, ::-1], np.linalg.eigvalsh(tensors(found)), atol=1e-15)
    turned = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    bar = turned @ np.diag([0.02, -0.01]) @ turned.T
    components = np.array([[bar[0, 0], bar[1, 1], bar[0, 1]]])
    # Of constant volume, it thins by -0.01 both ways.
    assert compute_von_mises_strain(components)[0] == pytest.approx(0.02, rel=1e-12)


def test_a_length_that_vanishes_has_no_logarithm() -> None:
    assert np.isnan(compute_hencky(np.array([[-0.6, 0.0, 0.0]]))[0, 0])


@pytest.mark.parametrize("n_components", [3, 6])
def test_where_nothing_is_known_nothing_is_said_and_elsewhere_all(n_components: int) -> None:
    strains = np.random.default_rng(1).uniform(-0.1, 0.1, (5, n_components))
    strains[3, 1] = np.nan
    for measure in (compute_hencky, find_principal_strains, compute_von_mises_strain):
        found = measure(strains)
        assert np.isnan(found[3]).all()
        np.testing.assert_array_equal(np.delete(found, 3, axis=0), measure(np.delete(strains, 3, axis=0)))
