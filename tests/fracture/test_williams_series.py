"""Williams' series: textbook's first terms, free faces, and what a shift of the tip adds."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.fracture.crack_tip import evaluate_williams_series, find_kolosov_constant

KAPPA = find_kolosov_constant(0.3, "stress")
ORDERS = np.arange(-1, 8)


def _points(n: int = 200) -> np.ndarray:
    random = np.random.default_rng(0)
    r, theta = random.uniform(5, 50, n), random.uniform(-3.1, 3.1, n)
    return np.column_stack([r * np.cos(theta), r * np.sin(theta)])


def test_kolosov_constants() -> None:
    assert find_kolosov_constant(0.25, "stress") == pytest.approx(2.2)
    assert find_kolosov_constant(0.25, "strain") == pytest.approx(2.0)


def test_singular_terms_are_those_of_the_textbook() -> None:
    points = _points()
    r, half = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0]) / 2
    terms = evaluate_williams_series(points, np.array([1]), KAPPA)
    opening = np.sqrt(r)[:, None] * np.column_stack([
        np.cos(half) * (KAPPA - 1 + 2 * np.sin(half) ** 2), np.sin(half) * (KAPPA + 1 - 2 * np.cos(half) ** 2)])
    sliding = -np.sqrt(r)[:, None] * np.column_stack([
        np.sin(half) * (KAPPA + 1 + 2 * np.cos(half) ** 2), -np.cos(half) * (KAPPA - 1 - 2 * np.sin(half) ** 2)])
    np.testing.assert_allclose(terms[..., 0], opening, atol=1e-12)
    np.testing.assert_allclose(terms[..., 1], sliding, atol=1e-12)


def test_order_two_is_the_t_stress_and_a_rotation() -> None:
    points = _points()
    terms = evaluate_williams_series(points, np.array([2]), KAPPA)
    strain = terms[..., 0] / points
    np.testing.assert_allclose(strain, np.broadcast_to([KAPPA + 1, KAPPA - 3], points.shape), atol=1e-12)
    turned = (KAPPA + 1) * np.column_stack([-points[:, 1], points[:, 0]])
    np.testing.assert_allclose(terms[..., 1], turned, atol=1e-11)


def test_moving_the_tip_adds_half_of_the_term_before_the_singular_one() -> None:
    points, step = _points(), np.array([1e-4, 0.0])
    ahead, behind = (evaluate_williams_series(points + h, np.array([1]), KAPPA) for h in (step, -step))
    slope = (ahead - behind) / 2e-4
    before = evaluate_williams_series(points, np.array([-1]), KAPPA)
    # Central differences of a smooth function err by step^2.
    np.testing.assert_allclose(slope, before / 2, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_faces_bear_no_forces(side: float) -> None:
    """sigma_xy = sigma_yy = 0 at the faces, by differences of displacements; 2 mu u, hence 2 mu = 1."""
    x = -np.linspace(5, 50, 20)
    face = np.column_stack([x, np.full(20, side * 1e-3)])
    step = 1e-4

    def differ(direction: tuple[float, float]) -> np.ndarray:
        h = step * np.array(direction)
        return (evaluate_williams_series(face + h, ORDERS, KAPPA)
                - evaluate_williams_series(face - h, ORDERS, KAPPA)) / (2 * step)

    by_x, by_y = differ((1.0, 0.0)), differ((0.0, 1.0))
    exx, eyy, exy = by_x[:, 0], by_y[:, 1], (by_x[:, 1] + by_y[:, 0]) / 2
    # Plane stress or strain by kappa: lambda / (2 mu) = (3 - kappa) / (2 (kappa - 1)).
    syy = eyy + (3 - KAPPA) / (2 * (KAPPA - 1)) * (exx + eyy)
    # Of the slopes, which a rotation has too; a translation has none.
    scale = np.abs(by_x).max(axis=(0, 1)) + np.abs(by_y).max(axis=(0, 1)) + 1e-9
    # The points are 1e-3 off the face, of 5 at least.
    assert (np.abs(syy) / scale).max() < 2e-3
    assert (np.abs(exy) / scale).max() < 2e-3
