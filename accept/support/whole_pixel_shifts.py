"""What sampling alone makes a far camera err by: full-resolution images shifted by whole pixels, then reduced.

No image is interpolated to make these pairs, none has noise but its rounding, and the displacement is known exactly:
what remains of f - g(x + u) is what the far camera's pixels do not tell, and so is the error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from ddic.functionals.correlation import Correlation, read_correlation
from ddic.images.binned import ArraySource
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.mesh.mesh import Mesh

Array = NDArray[np.float64]

SETTLED = 1e-5
"""Largest correction, pixels, with which Gauss-Newton ends."""


@dataclass(frozen=True)
class ShiftError:
    """Errors of one pair.

    Attributes
    ----------
    shift : (2,) array
        Of the deformed image, full-resolution px along x and y.
    error : (n, 2) array
        Of the displacement of the nodes, full-resolution px.
    residual_std : float
        Of f - g(x + u), grey levels.
    predicted : float
        Vector RMS of the error, were the residual white noise: that of the covariance residual_std^2 M^-1.
    """

    shift: Array
    error: Array
    residual_std: float
    predicted: float


def measure_shifts(image: Array, mesh: Mesh, ratio: int, degree: int) -> Iterator[ShiftError]:
    """Measure all shifts by less than a far pixel but the one by nothing.

    Parameters
    ----------
    image : (height, width) array
        Full resolution, grey levels.
    mesh : Mesh
        In pixels of the reduced image without its first row and column, a pixel inside it.
    ratio : int
        Full-resolution px per far px.
    degree : int
        Of the spline.

    Yields
    ------
    ShiftError
        Of each shift.
    """
    reference = read_correlation(mesh, _source(_reduce(image[ratio:, ratio:], ratio)), degree)
    hessian = reference.assemble_hessian().tocsc()
    scatter = float(np.trace(splu(hessian).solve(np.eye(mesh.n_dofs)))) / mesh.n_nodes
    for place in range(1, ratio**2):
        down, right = divmod(place, ratio)
        shifted = _reduce(image[ratio - down:, ratio - right:], ratio)
        exact = np.tile([right / ratio, down / ratio], mesh.n_nodes)
        found, residual_std = _iterate(reference, DeformedSubImage(_source(shifted), degree), exact)
        error = ratio * (found - exact).reshape(-1, 2)
        yield ShiftError(np.array([right, down], dtype=float), error, residual_std,
                         ratio * residual_std * float(np.sqrt(scatter)))


def _reduce(image: Array, ratio: int) -> Array:
    """Means of squares, rounded to grey levels as the far images are."""
    height, width = (size // ratio for size in image.shape)
    squares = image[:height * ratio, :width * ratio].reshape(height, ratio, width, ratio)
    return np.asarray(np.rint(squares.mean(axis=(1, 3))))


def _source(image: Array) -> MaskedSource:
    return MaskedSource(ArraySource(Path("memory"), image.astype(np.float32)))


def _iterate(reference: Correlation, deformed: DeformedSubImage, start: Array) -> tuple[Array, float]:
    """Gauss-Newton from a start; the displacement, and the residual's standard deviation."""
    factor, q = splu(reference.assemble_hessian().tocsc()), start
    for _ in range(50):
        correction = factor.solve(reference.assemble_right_hand_side(reference.compute_residual(deformed, q)))
        q = q + correction
        if np.abs(correction).max() < SETTLED:
            return q, float(np.nanstd(reference.compute_residual_image(deformed, q)))
    raise RuntimeError("Gauss-Newton did not settle")
