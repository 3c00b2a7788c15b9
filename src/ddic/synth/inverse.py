"""Inverting the motion: which reference point lands on a given point of the deformed image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, InputError
from ddic.synth.fields import DisplacementField

# Distance of u(y - v) from v at which the iteration stops, px; a larger one blurs the truth of a pair.
_TOLERANCE = 1e-12
# The same relative to the largest displacement, which rounding keeps from being met better.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)
_MAX_ITERATIONS = 50
# The gradient is kept from one iteration to the next as long as each gains two digits.
_FAST = 0.01


def find_reference_points(field: DisplacementField, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve x + u(x) = y for x at deformed points y.

    Newton's method on the displacement v = y - x, stopped when |u(y - v) - v| <= 1e-12 px (or four roundings
    of the largest displacement, where that is more) at all points.

    Parameters
    ----------
    field : DisplacementField
        u.
    points : (n, 2) array
        The y, pixels.

    Returns
    -------
    (n, 2) array
        The x, pixels.

    Raises
    ------
    InputError
        Where the field folds the plane (det(I + grad u) <= 0).
    ConvergenceError
        If 50 iterations are not enough.
    """
    v = field.displacement(points)
    inverse = None
    previous = np.inf
    for _ in range(_MAX_ITERATIONS):
        x = points - v
        residual = field.displacement(x) - v
        largest = float(np.abs(residual).max(initial=0.0))
        rounding = _ROUNDING * float(np.abs(v).max(initial=0.0))
        if largest <= max(_TOLERANCE, rounding):
            return x
        if inverse is None or largest > _FAST * previous:
            inverse = _inverse_of_motion(field.gradient(x), x)
        v[:, 0] += inverse[0] * residual[:, 0] + inverse[1] * residual[:, 1]
        v[:, 1] += inverse[2] * residual[:, 0] + inverse[3] * residual[:, 1]
        previous = largest
    worst = int(np.argmax(np.abs(residual).max(axis=1)))
    raise ConvergenceError(
        f"the motion x + u(x) could not be inverted at ({points[worst, 0]:g}, {points[worst, 1]:g}) px: "
        f"{np.abs(residual[worst]).max():.1e} px left after {_MAX_ITERATIONS} iterations; "
        "use a smoother displacement field")


def _inverse_of_motion(gradient: NDArray[np.float64], x: NDArray[np.float64]) -> tuple[
        NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Entries 00, 01, 10, 11 of (I + grad u)^-1 at x (n, 2), each (n,)."""
    a, b = 1 + gradient[:, 0, 0], gradient[:, 0, 1]
    c, d = gradient[:, 1, 0], 1 + gradient[:, 1, 1]
    determinant = a * d - b * c
    if not (determinant > 0).all():
        folded = x[np.argmin(determinant)]
        raise InputError(f"displacement field: folds the image near ({folded[0]:g}, {folded[1]:g}) px, "
                         "det(I + grad u) <= 0; use a smaller amplitude or a larger wavelength")
    return d / determinant, -b / determinant, -c / determinant, a / determinant
