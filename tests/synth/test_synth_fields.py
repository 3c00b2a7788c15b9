import math

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.synth.fields import Affine, Bending, Kirsch, Sinusoidal, Sum, Translation

KIRSCH = Kirsch(center=(120.0, 90.0), radius=30.0, strain=0.02, poisson_ratio=0.25, translation=(0.4, -1.0))
FIELDS = [
    Translation((0.3, -2.0)),
    Affine(((0.01, 0.02), (-0.03, 0.005)), (1.0, 2.0), (100.0, 50.0)),
    Sinusoidal(),
    Sinusoidal((0.1, 0.2), (1.0, 2.0), (90.0, 150.0), (200.0, 70.0), (0.1, 0.9), (2.0, -3.0)),
    KIRSCH,
    Bending(2e-4, (110.0, 95.0), 0.3),
    Sum((Translation((1.0, 0.0)), Bending(1e-4), KIRSCH)),
]
WAVES_IN_SPACE = Sinusoidal((0.1, 0.2, 0.3), (1.0, 2.0, 1.5), (90.0, 150.0, 120.0), (200.0, 70.0, 80.0),
                            (0.1, 0.9, -0.4), (2.0, -3.0, 1.0), (110.0, 130.0, 75.0), (0.5, 1.5, 2.5))
IN_SPACE = [
    Translation((0.3, -2.0, 1.0)),
    Affine(((0.01, 0.02, 0.0), (-0.03, 0.005, 0.01), (0.02, 0.0, -0.01)), (1.0, 2.0, 3.0), (100.0, 50.0, 20.0)),
    WAVES_IN_SPACE,
    Sum((Translation((1.0, 0.0, -1.0)), WAVES_IN_SPACE)),
]


def points(n=400, d=2):
    return np.random.default_rng(3).uniform(0, 250, (n, d))


@pytest.mark.parametrize(("field", "d"), [(field, 2) for field in FIELDS] + [(field, 3) for field in IN_SPACE],
                         ids=lambda value: type(value).__name__)
def test_gradient_is_the_derivative_of_the_displacement(field, d):
    at, h = points(d=d), 1e-3
    assert field.displacement(at).shape == at.shape
    for j in range(d):
        step = h * np.eye(d)[j]
        difference = (field.displacement(at + step) - field.displacement(at - step)) / (2 * h)
        # The third derivative leaves h^2 / 6 x 6e-3 at most (near the hole), rounding 1e-11.
        np.testing.assert_allclose(field.gradient(at)[:, :, j], difference, rtol=0, atol=1e-9)


def test_reference_field_has_the_published_values():
    at = points()
    x, y = at.T
    u = 0.35 + 0.60 * np.sin(2 * np.pi * x / 1024 + 0.3) * np.cos(2 * np.pi * y / 1280 - 0.2)
    v = -0.25 + 0.50 * np.cos(2 * np.pi * x / 1280 - 0.7) * np.sin(2 * np.pi * y / 1024 + 0.5)
    # Rounding of angles of a few radians.
    np.testing.assert_allclose(Sinusoidal().displacement(at), np.column_stack([u, v]), rtol=0, atol=1e-14)


def test_waves_in_space_are_those_of_the_plane_with_a_cosine_along_z():
    at = points(d=3)
    x, y, z = 2 * np.pi * at.T
    u = 0.1 + np.sin(x / 90 + 0.1) * np.cos(y / 150 + 0.9) * np.cos(z / 120 - 0.4)
    v = 0.2 + 2.0 * np.cos(x / 200 + 2.0) * np.sin(y / 70 - 3.0) * np.cos(z / 80 + 1.0)
    w = 0.3 + 1.5 * np.cos(x / 110 + 0.5) * np.cos(y / 130 + 1.5) * np.sin(z / 75 + 2.5)
    # Rounding of angles of up to 25 radians.
    np.testing.assert_allclose(WAVES_IN_SPACE.displacement(at), np.column_stack([u, v, w]), rtol=0, atol=1e-13)


def test_affine_values():
    field = Affine(((0.1, 0.2), (0.3, 0.4)), (1.0, 2.0), (5.0, 7.0))
    np.testing.assert_allclose(field.displacement(np.array([[6.0, 9.0]])), [[1.5, 3.1]], rtol=1e-14)


def test_bending_strains_are_those_of_a_beam():
    field, at = Bending(2e-4, (110.0, 95.0), 0.3), points()
    gradient = field.gradient(at)
    depth = at[:, 1] - 95.0
    # Products of a few numbers: rounding only.
    np.testing.assert_allclose(gradient[:, 0, 0], -2e-4 * depth, rtol=1e-13)
    np.testing.assert_allclose(gradient[:, 1, 1], 0.3 * 2e-4 * depth, rtol=1e-13)
    np.testing.assert_allclose(gradient[:, 0, 1] + gradient[:, 1, 0], 0.0, atol=1e-16)


def test_sum_adds():
    at, parts = points(), FIELDS[:3]
    expected = sum(part.displacement(at) for part in parts)
    np.testing.assert_array_equal(Sum(tuple(parts)).displacement(at), expected)


def stress(field, at):
    """Plane stress with Young's modulus 1, shape (n, 2, 2)."""
    nu = field.poisson_ratio
    strain = 0.5 * (field.gradient(at) + np.swapaxes(field.gradient(at), 1, 2))
    trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
    return ((1 - nu) * strain + nu * trace * np.eye(2)) / (1 - nu**2)


def ring(radius, n=72):
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.array(KIRSCH.center) + radius * normal, normal


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.3, 2.0, 5.0])
def test_kirsch_is_in_equilibrium(factor):
    at, _ = ring(factor * KIRSCH.radius)
    h = 1e-2
    divergence = sum((stress(KIRSCH, at + h * e) - stress(KIRSCH, at - h * e))[:, :, j] / (2 * h)
                     for j, e in enumerate(np.eye(2)))
    # Stress gradients reach 1e-2 of strain / px; central differences leave h^2 / radius^2 = 1e-7 of them.
    assert np.abs(divergence).max() < 1e-6 * KIRSCH.strain


def test_kirsch_hole_is_free_of_traction():
    at, normal = ring(KIRSCH.radius)
    traction = np.einsum("nij,nj->ni", stress(KIRSCH, at), normal)
    assert np.abs(traction).max() < 1e-13  # rounding of stresses up to 0.06


def test_kirsch_concentrates_stress_three_times():
    across = np.array([[KIRSCH.center[0] + KIRSCH.radius, KIRSCH.center[1]]])
    along = np.array([[KIRSCH.center[0], KIRSCH.center[1] + KIRSCH.radius]])
    assert stress(KIRSCH, across)[0, 1, 1] == pytest.approx(3 * KIRSCH.strain, rel=1e-12)
    assert stress(KIRSCH, along)[0, 0, 0] == pytest.approx(-KIRSCH.strain, rel=1e-12)


def test_kirsch_is_uniaxial_tension_along_y_far_away():
    at, _ = ring(1e4 * KIRSCH.radius)
    expected = np.diag([-KIRSCH.poisson_ratio, 1.0]) * KIRSCH.strain
    # The hole's perturbation falls as (radius / r)^2 = 1e-8.
    np.testing.assert_allclose(KIRSCH.gradient(at), np.broadcast_to(expected, (len(at), 2, 2)),
                               rtol=0, atol=1e-7 * KIRSCH.strain)


def test_kirsch_centre_moves_with_the_translation():
    np.testing.assert_array_equal(KIRSCH.displacement(np.array([KIRSCH.center])), [KIRSCH.translation])


def test_kirsch_continuation_is_tame():
    x, y = np.meshgrid(np.linspace(-30, 30, 61), np.linspace(-30, 30, 61))
    inside = np.array(KIRSCH.center) + np.column_stack([x.ravel(), y.ravel()])
    # As documented; the largest gradient of the plate itself is 3 strain.
    assert np.abs(KIRSCH.gradient(inside)).max() < 6 * KIRSCH.strain


@pytest.mark.parametrize("part", ["displacement", "gradient"])
def test_kirsch_continuation_joins_smoothly(part):
    inner, _ = ring((0.9 - 1e-9) * KIRSCH.radius)
    outer, _ = ring((0.9 + 1e-9) * KIRSCH.radius)
    # Steps of 1e-9 radius: 1e-9 of 6 strain x 30 px, and 1e-9 of 40 strain for the gradient.
    np.testing.assert_allclose(getattr(KIRSCH, part)(inner), getattr(KIRSCH, part)(outer), rtol=0, atol=1e-8)


@pytest.mark.parametrize(("kind", "arguments", "key"), [
    (Translation, {"vector": (math.nan, 0.0)}, "vector"),
    (Affine, {"matrix": ((math.inf, 0.0), (0.0, 0.0))}, "matrix"),
    (Sinusoidal, {"wavelength_x": (0.0, 5.0)}, "wavelength_x"),
    (Sinusoidal, {"phase_y": (math.nan, 5.0)}, "phase_y"),
    (Sinusoidal, {"offset": (0.0, 0.0, 0.0)}, "offset, amplitude, .* three in all"),
    (Sinusoidal, {"wavelength_z": (9.0, 9.0)}, "wavelength_z, phase_z: give both"),
    (Translation, {"vector": (1.0,)}, "vector: must have a number for each axis"),
    (Affine, {"matrix": ((0.0,) * 3,) * 3}, "two in all or three in all"),
    (Affine, {"matrix": ((0.0,) * 3,) * 2}, "two in all or three in all"),
    (Kirsch, {"radius": 0.0}, "radius"),
    (Kirsch, {"poisson_ratio": 0.6}, "poisson_ratio"),
    (Bending, {"poisson_ratio": -1.0}, "poisson_ratio"),
    (Bending, {"curvature": math.nan}, "curvature"),
    (Sum, {"terms": ()}, "terms"),
])
def test_impossible_fields_are_refused(kind, arguments, key):
    with pytest.raises(InputError, match=key):
        kind(**arguments)
