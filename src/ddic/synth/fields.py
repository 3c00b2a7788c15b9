"""Analytic displacement fields, each with its exact gradient, and the hole of Kirsch's plate as a picture shows it."""

import math
from dataclasses import dataclass
from functools import reduce
from operator import mul
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ddic.arrays import Array
from ddic.errors import InputError

Pair = tuple[float, float]
Vector = tuple[float, ...]
"""A number for each axis, x, y and, in space, z."""


class DisplacementField(Protocol):
    """A displacement known at every point of the plane, d = 2, or of space, d = 3, in the reference configuration."""

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u, (n, d), at points (n, d), both in pixels."""

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dx_j, (n, d, d), no unit, at points (n, d), pixels."""


def require_finite(field: str, **values: float | tuple[float, ...]) -> None:
    """Check that parameters are finite numbers; raises InputError, naming field and parameter, where one is not."""
    for key, value in values.items():
        if not np.isfinite(value).all():
            raise InputError(f"{field}: {key} = {value}: must be finite")


def _require_vectors(field: str, **values: tuple[Any, ...]) -> None:
    """Check that parameters are finite, and all have a number for each of two or three axes; else raises InputError."""
    require_finite(field, **values)
    sizes = {len(value) for value in values.values()}
    if sizes not in ({2}, {3}):
        raise InputError(f"{field}: {', '.join(values)}: must have a number for each axis, two in all or three in all")


def _require_poisson_ratio(field: str, value: float) -> None:
    """Check that a Poisson ratio lies in -1 < nu <= 0.5; raises InputError, naming its owner, where it does not."""
    if not -1.0 < value <= 0.5:
        raise InputError(f"{field}: poisson_ratio = {value}: must be above -1 and at most 0.5")


@dataclass(frozen=True)
class Translation:
    """Uniform displacement.

    Attributes
    ----------
    vector : tuple of float
        (u_x, u_y), in space (u_x, u_y, u_z), pixels.
    """

    vector: Vector = (0.0, 0.0)

    def __post_init__(self) -> None:
        _require_vectors("translation", vector=self.vector)

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u."""
        return np.broadcast_to(np.array(self.vector, dtype=np.float64), points.shape).copy()

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dx_j."""
        return np.zeros((*points.shape, len(self.vector)))


@dataclass(frozen=True)
class Affine:
    """Uniform gradient: u = vector + matrix (x - center).

    Attributes
    ----------
    matrix : tuple of tuple of float
        Rows of du_i/dx_j, ((du_x/dx, du_x/dy), (du_y/dx, du_y/dy)), in space three of three, no unit.
    vector : tuple of float
        Displacement of the centre, pixels.
    center : tuple of float
        Pixels.
    """

    matrix: tuple[Vector, ...] = ((0.0, 0.0), (0.0, 0.0))
    vector: Vector = (0.0, 0.0)
    center: Vector = (0.0, 0.0)

    def __post_init__(self) -> None:
        rows = {f"matrix[{k}]": row for k, row in enumerate(self.matrix)}
        _require_vectors("affine", matrix=self.matrix, vector=self.vector, center=self.center, **rows)

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u."""
        return np.asarray((points - np.array(self.center)) @ np.array(self.matrix).T + np.array(self.vector))

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dx_j."""
        return np.broadcast_to(np.array(self.matrix, dtype=np.float64), (*points.shape, len(self.matrix))).copy()


@dataclass(frozen=True)
class Sinusoidal:
    """Waves along all axes; the default values are the field that all accuracy figures in the plane are measured with.

    u_x = offset_x + amplitude_x sin(2 pi x / wavelength_x[0] + phase_x[0])
                                 cos(2 pi y / wavelength_x[1] + phase_x[1])
    u_y = offset_y + amplitude_y cos(2 pi x / wavelength_y[0] + phase_y[0])
                                 sin(2 pi y / wavelength_y[1] + phase_y[1])

    In space each component has a third factor, a cosine along z, and u_z its sine there and two cosines.

    Attributes
    ----------
    offset, amplitude : tuple of float
        Of each component, pixels.
    wavelength_x, wavelength_y, wavelength_z : tuple of float
        Of each component, along each axis, pixels; of u_z in space alone.
    phase_x, phase_y, phase_z : tuple of float
        Likewise, radians.
    """

    offset: Vector = (0.35, -0.25)
    amplitude: Vector = (0.60, 0.50)
    wavelength_x: Vector = (1024.0, 1280.0)
    wavelength_y: Vector = (1280.0, 1024.0)
    phase_x: Vector = (0.3, -0.2)
    phase_y: Vector = (-0.7, 0.5)
    wavelength_z: Vector | None = None
    phase_z: Vector | None = None

    def __post_init__(self) -> None:
        given = {key: value for key, value in vars(self).items() if value is not None}
        _require_vectors("sinusoidal", **given)
        if len(given) != 2 + 2 * len(self.offset):
            raise InputError("sinusoidal: wavelength_z, phase_z: give both where there are three axes, and neither "
                             "where there are two")
        for key, value in given.items():
            if key.startswith("wavelength") and min(value) <= 0:
                raise InputError(f"sinusoidal: {key} = {value}: must be positive")

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u."""
        u = np.empty_like(points)
        for i, (offset, amplitude) in enumerate(zip(self.offset, self.amplitude, strict=True)):
            waves = (np.sin(angle) if j == i else np.cos(angle) for j, angle in enumerate(self._angles(points, i)))
            u[:, i] = offset + reduce(mul, waves, amplitude)
        return u

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dx_j."""
        grad = np.empty((*points.shape, len(self.offset)))
        for i, amplitude in enumerate(self.amplitude):
            angles = self._angles(points, i)
            for j, wavelength in enumerate(self._of(i, "wavelength")):
                # Along j sine and cosine have changed places, and the slope of a cosine is negative.
                factors = (np.sin(angle) if (k == i) != (k == j) else np.cos(angle) for k, angle in enumerate(angles))
                sign = 1 if j == i else -1
                grad[:, i, j] = reduce(mul, factors, sign * 2 * np.pi * amplitude / wavelength)
        return grad

    def _of(self, i: int, key: str) -> Vector:
        """Wavelengths or phases of component ``i`` along each axis."""
        values: Vector = getattr(self, f"{key}_{'xyz'[i]}")
        return values

    def _angles(self, points: Array, i: int) -> list[Array]:
        """Arguments of the waves of component ``i`` along each axis at points (n, d), each (n,), radians."""
        return [x * (2 * np.pi / wavelength) + phase for x, wavelength, phase in zip(
            points.T, self._of(i, "wavelength"), self._of(i, "phase"), strict=True)]


@dataclass(frozen=True)
class Bending:
    """Pure bending of a beam along x, in plane stress: what four-point bending does between inner rollers.

    u_x = -curvature X Y, u_y = curvature (X^2 + nu Y^2) / 2, with (X, Y) = (x, y) - center.

    Source: exact plane-stress solution with the strains (-curvature Y, nu curvature Y, 0).

    Attributes
    ----------
    curvature : float
        Of the neutral axis y = center[1], 1/px.
    center : (float, float)
        Pixels.
    poisson_ratio : float
        No unit.
    """

    curvature: float = 1e-5
    center: Pair = (0.0, 0.0)
    poisson_ratio: float = 0.3

    def __post_init__(self) -> None:
        require_finite("bending", curvature=self.curvature, center=self.center)
        _require_poisson_ratio("bending", self.poisson_ratio)

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u."""
        x, y = (points - np.array(self.center)).T
        return self.curvature * np.column_stack([-x * y, 0.5 * (x**2 + self.poisson_ratio * y**2)])

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dx_j."""
        x, y = (points - np.array(self.center)).T
        # Entries (i, j) of du_i/dx_j over the curvature, points last.
        rows = np.array([[-y, -x], [x, self.poisson_ratio * y]])
        return self.curvature * np.moveaxis(rows, 2, 0)


@dataclass(frozen=True)
class Sum:
    """Sum of displacement fields.

    Attributes
    ----------
    terms : tuple of DisplacementField
        At least one.
    """

    terms: tuple[DisplacementField, ...]

    def __post_init__(self) -> None:
        if not self.terms:
            raise InputError("sum: terms: give at least one displacement field")

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u."""
        return np.asarray(sum(term.displacement(points) for term in self.terms))

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dx_j."""
        return np.asarray(sum(term.gradient(points) for term in self.terms))


# Nearer the centre than this fraction of the radius, where there is no matter, the negative powers of r give
# way to polynomials, so that the motion is one-to-one there too.
_CONTINUED_BELOW = 0.9


@dataclass(frozen=True)
class Kirsch:
    """Infinite plate with a circular hole, in plane stress, pulled along y.

    Exact for r >= 0.9 radius; nearer the centre a continuation with a continuous gradient, at most 6 strain.

    Source: Kirsch's solution; Cartesian displacements as in Timoshenko & Goodier, Theory of Elasticity.

    Attributes
    ----------
    center, radius : (float, float) and float
        Of the hole, pixels.
    strain : float
        Far-field stress over Young's modulus, no unit.
    poisson_ratio : float
        No unit.
    translation : (float, float)
        Rigid displacement added, pixels.
    """

    center: Pair = (0.0, 0.0)
    radius: float = 100.0
    strain: float = 0.005
    poisson_ratio: float = 0.3
    translation: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("kirsch", center=self.center, strain=self.strain, translation=self.translation)
        _require_poisson_ratio("kirsch", self.poisson_ratio)
        if not (self.radius > 0 and math.isfinite(self.radius)):
            raise InputError(f"kirsch: radius = {self.radius}: must be positive")

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u."""
        across, along = (points - np.array(self.center)).T / self.radius
        h, _, w, _ = _decaying_terms(across**2 + along**2)
        kappa, scale = self._constants()
        p, q = _cubics(along, across)
        # The plate without hole, what decays like 1 / r, and what decays like 1 / r - 1 / r^3.
        u_along = along * ((kappa + 1) + 2 * (1 + kappa) * h) + 2 * p * w
        u_across = across * ((kappa - 3) + 2 * (1 - kappa) * h) + 2 * q * w
        return np.asarray(scale * np.column_stack([u_across, u_along]) + np.array(self.translation))

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dx_j."""
        across, along = (points - np.array(self.center)).T / self.radius
        h, dh, w, dw = _decaying_terms(across**2 + along**2)
        kappa, scale = self._constants()
        p, q = _cubics(along, across)
        # Slopes of p and q, times 2 w.
        square = 6 * (along**2 - across**2) * w
        product = 12 * along * across * w
        # Derivatives with respect to r^2, whose own derivative along a direction is twice the coordinate.
        on_along = 2 * (1 + kappa) * dh * along + 2 * p * dw
        on_across = 2 * (1 - kappa) * dh * across + 2 * q * dw
        grad = np.empty((len(points), 2, 2))
        grad[:, 1, 1] = (kappa + 1) + 2 * (1 + kappa) * h + square + 2 * along * on_along
        grad[:, 1, 0] = -product + 2 * across * on_along
        grad[:, 0, 1] = product + 2 * along * on_across
        grad[:, 0, 0] = (kappa - 3) + 2 * (1 - kappa) * h + square + 2 * across * on_across
        return np.asarray(grad * (scale / self.radius))

    def _constants(self) -> tuple[float, float]:
        """Kolosov's constant in plane stress and the displacement scale stress * radius / (8 mu), pixels."""
        nu = self.poisson_ratio
        kappa = (3 - nu) / (1 + nu)
        scale = self.strain * self.radius * (1 + nu) / 4
        return kappa, scale


def _cubics(along: Array, across: Array) -> tuple[Array, Array]:
    """r^3 cos(3 theta) and r^3 sin(3 theta), theta measured from the direction of the load."""
    p = along * (along**2 - 3 * across**2)
    q = across * (3 * along**2 - across**2)
    return p, q


def _decaying_terms(s: Array) -> tuple[Array, ...]:
    """Return h = 1/s, dh/ds, w = 1/s^2 - 1/s^3, dw/ds for s = (r / radius)^2, continued near the centre.

    Below the limit a function f becomes f(limit) + f'(limit) (s^2 - limit^2) / (2 limit): same value and
    slope at the limit, flat at the centre.
    """
    limit = _CONTINUED_BELOW**2
    outer = np.maximum(s, limit)
    inner = np.minimum(s, limit)
    # Both leave a function as it is beyond the limit, where inner is the limit.
    lever = (inner**2 - limit**2) / (2 * limit)
    fade = inner / limit
    h = 1 / outer
    dh = -1 / outer**2
    w = 1 / outer**2 - 1 / outer**3
    dw = 3 / outer**4 - 2 / outer**3
    return h + dh * lever, dh * fade, w + dw * lever, dw * fade


@dataclass(frozen=True)
class Hole:
    """A flat dark disc with a smooth edge, in reference coordinates.

    Raises InputError for a radius or edge that is not positive, or a level outside 0..1.

    Attributes
    ----------
    center, radius : (float, float) and float
        Pixels.
    level : float
        Grey level inside, as a fraction of full scale.
    edge : float
        Half-width of the edge (1 + tanh(distance / edge)) / 2, pixels.
    """

    center: tuple[float, float]
    radius: float
    level: float = 0.05
    edge: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.center).all():
            raise InputError(f"hole: center = {self.center}: must be finite")
        for key, value in (("radius", self.radius), ("edge", self.edge)):
            if not (value > 0 and math.isfinite(value)):
                raise InputError(f"hole: {key} = {value}: must be positive")
        if not 0 <= self.level <= 1:
            raise InputError(f"hole: level = {self.level}: must lie between 0 and 1")

    def cut(self, grey: Array, x: ArrayLike, y: ArrayLike) -> Array:
        """Cut the hole out of grey levels, fractions of full scale, taken at reference points x, y, pixels."""
        distance = np.hypot(np.asarray(x) - self.center[0], np.asarray(y) - self.center[1]) - self.radius
        matter = 0.5 * (1 + np.tanh(distance / self.edge))
        return np.asarray(self.level + matter * (grey - self.level))
