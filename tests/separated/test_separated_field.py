"""Sums of products: values, norms, orthogonal modes."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.separated.field import factorize_grid
from support.separated import build_zero_field, dense, lines, random_field

ALONG_X, ALONG_Y = lines((3.0, 5.0, 43.0, 29.0), 4.0)
POINTS = np.random.default_rng(0).uniform((3.0, 5.0), (43.0, 29.0), (50, 2))


def test_grid_and_points_agree() -> None:
    field = random_field(ALONG_X, ALONG_Y, 4)
    x, y = np.linspace(3, 43, 7), np.linspace(5, 29, 5)
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    assert np.allclose(field.evaluate_on_grid(x, y).reshape(-1, 2), field.at(at), rtol=0, atol=1e-14)
    assert np.isnan(field.at(np.array([[2.9, 10.0], [10.0, 29.1]]))).all()


def test_norms_are_those_of_the_bilinear_field() -> None:
    field = random_field(ALONG_X, ALONG_Y, 3)
    nodal = field.evaluate_on_grid(ALONG_X.nodes, ALONG_Y.nodes)
    area = ALONG_X.length * ALONG_Y.length
    mass = np.kron(dense(ALONG_Y.mass), dense(ALONG_X.mass)) / area
    for c in range(2):
        values = nodal[..., c].ravel()
        square, mean = values @ mass @ values, mass.sum(axis=0) @ values
        # Sums of 77 terms.
        assert field.measure_rms()[c] == pytest.approx(np.sqrt(square), rel=1e-13)
        assert field.measure_rms(without_mean=True)[c] == pytest.approx(np.sqrt(square - mean**2), rel=1e-12)


def test_amplitudes_are_the_modes_rms() -> None:
    field = random_field(ALONG_X, ALONG_Y, 1)
    assert np.allclose(field.measure_rms(), field.amplitudes[0], rtol=1e-14, atol=0)


def test_orthogonal_modes_are_the_same_field() -> None:
    field = random_field(ALONG_X, ALONG_Y, 3)
    doubled = field.add(field)
    reduced = doubled.reduce_modes(1e-12)
    assert reduced.n_modes == 3
    # Two factorisations of numbers of size 1.
    assert np.allclose(reduced.at(POINTS), 2 * field.at(POINTS), rtol=0, atol=1e-13)
    assert (np.diff(reduced.amplitudes, axis=0) <= 0).all()
    mass = dense(ALONG_X.mass) / ALONG_X.length
    for c in range(2):
        products = reduced.x[:, c] @ mass @ reduced.x[:, c].T
        assert np.allclose(products, np.eye(3), rtol=0, atol=1e-12)


def test_reduction_loses_what_it_may() -> None:
    field = random_field(ALONG_X, ALONG_Y, 6)
    sizes = field.reduce_modes(0.0).amplitudes
    allowed = 1.1 * float(sizes[-1].max())
    reduced = field.reduce_modes(allowed)
    assert reduced.n_modes < 6
    negative = random_field(ALONG_X, ALONG_Y, 6, size=-0.3)
    lost = reduced.add(negative).measure_rms()
    assert (lost <= allowed * (1 + 1e-9)).all()
    assert lost.max() > 0.1 * allowed


def test_difference_is_measured_however_small() -> None:
    field = random_field(ALONG_X, ALONG_Y, 3)
    change = random_field(ALONG_X, ALONG_Y, 1, seed=1, size=1e-9)
    # Rounding of numbers of size 1.
    assert np.allclose(field.add(change).measure_difference(field), change.measure_rms(), rtol=0, atol=1e-14)


def test_grid_is_factorised_exactly() -> None:
    values = random_field(ALONG_X, ALONG_Y, 4).evaluate_on_grid(ALONG_X.nodes, ALONG_Y.nodes)
    found = factorize_grid(ALONG_X, ALONG_Y, values, 1e-12)
    assert found.n_modes == 4
    assert np.allclose(found.evaluate_on_grid(ALONG_X.nodes, ALONG_Y.nodes), values, rtol=0, atol=1e-13)


def test_zero_field_is_zero() -> None:
    zero = build_zero_field(ALONG_X, ALONG_Y)
    assert not zero.at(POINTS).any()
    assert not zero.measure_rms().any()
    assert zero.reduce_modes(1.0) is zero
