"""F^-T grad f as the gradient of the deformed image: M is then minus the derivative of b, by whatever it turns."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.correlation import (
    Correlation,
    compute_inverse_deformations,
    find_large_gradients,
    map_hessians,
    map_moments,
    measure_deformation,
    read_correlation,
)
from ddic.images.sub_image import DeformedSubImage
from ddic.mesh.structured import build_structured_mesh
from ddic.synth.speckle import SpeckleTexture
from support.pictures import source

SIDE = 160
MIDDLE = np.array([SIDE / 2, SIDE / 2])
MESH = build_structured_mesh((50, 50, 110, 110), 10)
Motion = np.ndarray


def _motion(degrees: float, stretch: float = 1.0) -> Motion:
    angle = np.deg2rad(degrees)
    return stretch * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _pair(motion: Motion) -> tuple[Correlation, DeformedSubImage]:
    y, x = np.mgrid[0:SIDE, 0:SIDE].astype(float)
    texture = SpeckleTexture(3, 1.5)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    origins = MIDDLE + (pixels - MIDDLE) @ np.linalg.inv(motion).T
    f, g = (255 * texture.grey(*points.T).reshape(SIDE, SIDE) for points in (pixels, origins))
    return read_correlation(MESH, source(f.astype(np.float32)), 3), DeformedSubImage(source(g.astype(np.float32)), 3)


def _displace(motion: Motion) -> np.ndarray:
    return np.asarray((MIDDLE + (MESH.nodes - MIDDLE) @ motion.T - MESH.nodes).ravel())


@pytest.mark.parametrize(("degrees", "stretch"), [(0.0, 1.3), (60.0, 1.0), (180.0, 1.0)])
def test_m_is_minus_the_derivative_of_b(degrees: float, stretch: float) -> None:
    motion = _motion(degrees, stretch)
    reference, deformed = _pair(motion)
    u = _displace(motion)
    moved = reference.with_moved_gradient(u)
    direction = np.random.default_rng(0).standard_normal(u.shape)

    def right_hand_side(of: Correlation, step: float) -> np.ndarray:
        return of.assemble_right_hand_side(of.compute_residual(deformed, u + step * direction))

    step = 1e-3
    derivative = (right_hand_side(moved, step) - right_hand_side(moved, -step)) / (2 * step)
    product = moved.assemble_hessian() @ direction
    # The residual is zero up to interpolation, so that M is the derivative up to its 1 %.
    assert np.linalg.norm(derivative + product) < 0.02 * np.linalg.norm(product)
    if degrees:
        product = reference.assemble_hessian() @ direction
        derivative = (right_hand_side(reference, step) - right_hand_side(reference, -step)) / (2 * step)
        assert np.linalg.norm(derivative + product) > 0.3 * np.linalg.norm(product)


def test_sums_are_mapped_as_their_vectors_are() -> None:
    random = np.random.default_rng(1)
    vectors, shapes, weights = random.normal(size=(3, 2)), random.normal(size=(3, 4)), random.normal(size=3)
    inverse = random.normal(size=(1, 2, 2))
    mapped = vectors @ inverse[0]

    def sum_moments(gradients: np.ndarray) -> np.ndarray:
        return np.einsum("p,pi,pm->im", weights, gradients, shapes)[None, None]

    def sum_hessians(gradients: np.ndarray) -> np.ndarray:
        rows = np.einsum("pa,pi->pai", shapes, gradients).reshape(3, 8)
        return (rows.T @ rows)[None]

    np.testing.assert_allclose(map_moments(inverse, sum_moments(vectors)), sum_moments(mapped), atol=1e-12)
    np.testing.assert_allclose(map_hessians(inverse, sum_hessians(vectors)), sum_hessians(mapped), atol=1e-12)


def test_deformation_is_measured_since_then() -> None:
    stretched, turned = _motion(0.0, 1.2), _motion(30.0)
    before, now = (compute_inverse_deformations(MESH, _displace(motion)) for motion in (stretched, turned @ stretched))
    np.testing.assert_allclose(now, np.tile(np.linalg.inv(turned @ stretched), (MESH.n_cells, 1, 1)), atol=1e-12)
    assert measure_deformation(None, None) == 0.0
    np.testing.assert_allclose(measure_deformation(None, before), np.sqrt(2) * 0.2, rtol=1e-12)
    np.testing.assert_allclose(measure_deformation(before, now), np.linalg.norm(turned - np.eye(2)), rtol=1e-12)
    assert measure_deformation(now, None) > 0.1
    assert find_large_gradients(MESH, _displace(stretched)).all()
    assert not find_large_gradients(MESH, _displace(_motion(0.0, 1.05))).any()


def test_folded_cells_keep_the_gradient_of_the_reference() -> None:
    u = np.zeros(MESH.nodes.shape)
    u[MESH.cells[0, 0]] = (30.0, 30.0)
    inverse = compute_inverse_deformations(MESH, u.ravel())
    np.testing.assert_array_equal(inverse[0], np.eye(2))
    # Nor does such a cell say that anything is large.
    u[:] = 0.0
    u[MESH.cells[0, 0]] = (300.0, 300.0)
    assert not find_large_gradients(MESH, u.ravel()).any()
