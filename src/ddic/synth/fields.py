"""Analytic displacement fields, each with its exact gradient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError

Pair = tuple[float, float]


class DisplacementField(Protocol):
    """A displacement known at every point of the plane, in the reference configuration."""

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement u at points (n, 2), pixels; returns (n, 2), pixels."""
        ...

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient du_i/dx_j at points (n, 2), pixels; returns (n, 2, 2), no unit."""
        ...


def require_finite(field: str, **values: float | tuple[float, ...]) -> None:
    """Raise InputError, naming field and parameter, if a parameter is not a finite number."""
    for key, value in values.items():
        if not np.isfinite(value).all():
            raise InputError(f"{field}: {key} = {value}: must be finite")


def require_poisson_ratio(field: str, value: float) -> None:
    """Raise InputError if a Poisson ratio is outside -1 < nu <= 0.5."""
    if not -1.0 < value <= 0.5:
        raise InputError(f"{field}: poisson_ratio = {value}: must be above -1 and at most 0.5")


@dataclass(frozen=True)
class Translation:
    """Uniform displacement; vector: (u_x, u_y), pixels."""

    vector: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("translation", vector=self.vector)

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement at points (n, 2), pixels."""
        return np.broadcast_to(np.array(self.vector, dtype=np.float64), points.shape).copy()

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient at points (n, 2), shape (n, 2, 2)."""
        return np.zeros((len(points), 2, 2))


@dataclass(frozen=True)
class Affine:
    """Uniform gradient: u = vector + matrix (x - center).

    matrix: ((du_x/dx, du_x/dy), (du_y/dx, du_y/dy)), no unit; vector, center: pixels.
    """

    matrix: tuple[Pair, Pair] = ((0.0, 0.0), (0.0, 0.0))
    vector: Pair = (0.0, 0.0)
    center: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("affine", matrix=self.matrix[0] + self.matrix[1], vector=self.vector,
                       center=self.center)

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement at points (n, 2), pixels."""
        return np.asarray((points - np.array(self.center)) @ np.array(self.matrix).T + np.array(self.vector))

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient at points (n, 2), shape (n, 2, 2)."""
        return np.broadcast_to(np.array(self.matrix, dtype=np.float64), (len(points), 2, 2)).copy()


@dataclass(frozen=True)
class Sinusoidal:
    """Waves in both directions; the default values are the reference field of the design notes.

    u_x = offset_x + amplitude_x sin(2 pi x / wavelength_x[0] + phase_x[0])
                                 cos(2 pi y / wavelength_x[1] + phase_x[1])
    u_y = offset_y + amplitude_y cos(2 pi x / wavelength_y[0] + phase_y[0])
                                 sin(2 pi y / wavelength_y[1] + phase_y[1])

    offset, amplitude: (x component, y component), pixels.
    wavelength_x, wavelength_y: of u_x and of u_y, each (along x, along y), pixels.
    phase_x, phase_y: likewise, radians.
    """

    offset: Pair = (0.35, -0.25)
    amplitude: Pair = (0.60, 0.50)
    wavelength_x: Pair = (1024.0, 1280.0)
    wavelength_y: Pair = (1280.0, 1024.0)
    phase_x: Pair = (0.3, -0.2)
    phase_y: Pair = (-0.7, 0.5)

    def __post_init__(self) -> None:
        require_finite("sinusoidal", offset=self.offset, amplitude=self.amplitude, phase_x=self.phase_x,
                       phase_y=self.phase_y, wavelength_x=self.wavelength_x, wavelength_y=self.wavelength_y)
        for key in ("wavelength_x", "wavelength_y"):
            if min(getattr(self, key)) <= 0:
                raise InputError(f"sinusoidal: {key} = {getattr(self, key)}: must be positive")

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement at points (n, 2), pixels."""
        u = np.empty_like(points)
        angle_x, angle_y = _angles(points, self.wavelength_x, self.phase_x)
        u[:, 0] = self.offset[0] + self.amplitude[0] * np.sin(angle_x) * np.cos(angle_y)
        angle_x, angle_y = _angles(points, self.wavelength_y, self.phase_y)
        u[:, 1] = self.offset[1] + self.amplitude[1] * np.cos(angle_x) * np.sin(angle_y)
        return u

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient at points (n, 2), shape (n, 2, 2)."""
        grad = np.empty((len(points), 2, 2))
        a, b = _angles(points, self.wavelength_x, self.phase_x)
        factor = 2 * np.pi * self.amplitude[0] / np.array(self.wavelength_x)
        grad[:, 0, 0] = factor[0] * np.cos(a) * np.cos(b)
        grad[:, 0, 1] = -factor[1] * np.sin(a) * np.sin(b)
        a, b = _angles(points, self.wavelength_y, self.phase_y)
        factor = 2 * np.pi * self.amplitude[1] / np.array(self.wavelength_y)
        grad[:, 1, 0] = -factor[0] * np.sin(a) * np.sin(b)
        grad[:, 1, 1] = factor[1] * np.cos(a) * np.cos(b)
        return grad


def _angles(points: NDArray[np.float64], wavelength: Pair,
            phase: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return (points[:, 0] * (2 * np.pi / wavelength[0]) + phase[0],
            points[:, 1] * (2 * np.pi / wavelength[1]) + phase[1])


@dataclass(frozen=True)
class Bending:
    """Pure bending of a beam along x, in plane stress: what four-point bending does between inner rollers.

    u_x = -curvature X Y, u_y = curvature (X^2 + nu Y^2) / 2, with (X, Y) = (x, y) - center.

    curvature: of the neutral axis y = center[1], 1/px; center: pixels; poisson_ratio: no unit.
    Source: exact plane-stress solution with the strains (-curvature Y, nu curvature Y, 0).
    """

    curvature: float = 1e-5
    center: Pair = (0.0, 0.0)
    poisson_ratio: float = 0.3

    def __post_init__(self) -> None:
        require_finite("bending", curvature=self.curvature, center=self.center)
        require_poisson_ratio("bending", self.poisson_ratio)

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement at points (n, 2), pixels."""
        x, y = (points - np.array(self.center)).T
        return self.curvature * np.column_stack([-x * y, 0.5 * (x**2 + self.poisson_ratio * y**2)])

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient at points (n, 2), shape (n, 2, 2)."""
        x, y = (points - np.array(self.center)).T
        rows = np.array([[-y, -x], [x, self.poisson_ratio * y]])
        return self.curvature * np.moveaxis(rows, 2, 0)


@dataclass(frozen=True)
class Sum:
    """Sum of displacement fields; terms: at least one."""

    terms: tuple[DisplacementField, ...]

    def __post_init__(self) -> None:
        if not self.terms:
            raise InputError("sum: terms: give at least one displacement field")

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement at points (n, 2), pixels."""
        return np.asarray(sum(term.displacement(points) for term in self.terms))

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient at points (n, 2), shape (n, 2, 2)."""
        return np.asarray(sum(term.gradient(points) for term in self.terms))
