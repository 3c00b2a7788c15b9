"""Registration of an image in one taken at a lower magnification, by Gauss-Newton on the camera mapping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, ndimage

from ddic.calibration.camera_models import CameraModel
from ddic.errors import ConvergenceError
from ddic.images.camera import CameraMapping
from ddic.images.source import ImageSource
from ddic.images.spline import PADDING, GradientImage, read_gradient, read_spline
from ddic.images.window import Window

Array = NDArray[np.float64]

TOLERANCE = 1e-4
"""Gauss-Newton stops when the corners of the near image's part move by less, near px."""

CORRELATION_LENGTH = 6
"""Far px beyond which residuals count as independent."""

_MAX_ITERATIONS = 60
_DEGREE = 3
_SAMPLES_AT_ONCE = 1 << 20


@dataclass(frozen=True, eq=False)
class NearImage:
    """The finer image as a spline, its gradient at pixel centres, and how it is averaged over a far pixel.

    coefficients: padded by PADDING; by_x, by_y: (height, width), grey levels per near px.
    samples: per far pixel either way.
    """

    coefficients: NDArray[np.float32]
    by_x: NDArray[np.float32]
    by_y: NDArray[np.float32]
    samples: int

    @property
    def window(self) -> Window:
        """All its pixels."""
        return Window(0, 0, self.by_x.shape[1], self.by_x.shape[0])

    def averages(self, mapping: CameraMapping, points: Array) -> Array:
        """Means over the unit squares about specimen points (n, 2): grey level and gradient by near x and y, (n, 3)."""
        along = (np.arange(self.samples) + 0.5) / self.samples - 0.5
        shifts = np.stack(np.meshgrid(along, along), axis=-1).reshape(1, -1, 2)
        out = np.empty((len(points), 3))
        step = max(_SAMPLES_AT_ONCE // shifts.shape[1], 1)
        for begin in range(0, len(points), step):
            part = slice(begin, begin + step)
            x = mapping.to_image((points[part, None] + shifts).reshape(-1, 2))
            where = x[:, ::-1].T
            grey = ndimage.map_coordinates(self.coefficients, where + PADDING[_DEGREE], output=np.float64,
                                           order=_DEGREE, mode="nearest", prefilter=False)
            # The gradient only tells how certain the result is: linear interpolation does for it.
            slopes = [ndimage.map_coordinates(by, where, output=np.float64, order=1, mode="nearest")
                      for by in (self.by_x, self.by_y)]
            out[part] = np.stack([grey, *slopes], axis=1).reshape(-1, shifts.shape[1], 3).mean(axis=1)
        return out


@dataclass(frozen=True, eq=False)
class Registration:
    """What Gauss-Newton found.

    model, parameters: of the mapping. covariance: (n_parameters, n_parameters). gain, offset: f_far = gain f_near +
    offset, averaged over far pixels. coefficient: zero-mean normalised cross-correlation. local_coefficient: the median
    of those of squares of 16 x 16 far px. residual_std: grey levels of the far image. n_pixels: far pixels compared.
    correlation: variance of the parameters over that from independent residuals. iterations: of Gauss-Newton.
    """

    model: CameraModel
    parameters: Array
    covariance: Array
    gain: float
    offset: float
    coefficient: float
    local_coefficient: float
    residual_std: float
    n_pixels: int
    correlation: float
    iterations: int

    @property
    def mapping(self) -> CameraMapping:
        """The mapping found."""
        return self.model.mapping(self.parameters)


def near_image(source: ImageSource, ratio: float) -> NearImage:
    """Read an image as a spline; ratio: near px per far px, which tells how many samples a far pixel takes."""
    window = Window(0, 0, source.width, source.height)
    gradient = read_gradient(source, window, _DEGREE)
    coefficients = read_spline(source, window, _DEGREE).coefficients
    return NearImage(coefficients, gradient.by_x, gradient.by_y, max(round(ratio), 1))


def register(far: GradientImage, near: NearImage, model: CameraModel, start: Array, part: Window,
             tolerance: float = TOLERANCE) -> Registration:
    """Find phi, gain and offset with Z^T r = 0, r = f_far - gain mean(f_near(phi)) - offset at far pixels.

    far: the whole image. start: parameters of the model. part: of the near image, whose pixels are used.
    tolerance: largest step of the part's corners at the end, near px.
    The near image is averaged over the square that each far pixel covers, as the far camera does. Columns of Z are
    the derivatives of r by the parameters, made of the gradient of the far image, the far grey levels, and 1: what
    only the near camera resolves is noise in the near averages, and must not be in what weighs the residuals.
    The covariance is A^-1 Z^T R Z A^-T, A = Z^T J with J the derivatives made of the near gradient, and R the
    covariance of the residuals from their autocorrelation up to CORRELATION_LENGTH px, tapered linearly.
    Raises ConvergenceError where the mapping runs away or does not settle.
    """
    parameters, corners = start, _corners(part)
    seen: _Patch | None = None
    try:
        for iteration in range(1, _MAX_ITERATIONS + 1):
            if seen is None or iteration <= 4:
                # Pixels at the rim come and go at first; then their number is kept so that the steps can end.
                seen = _visible(far.window, model.mapping(parameters), part)
            linear = _linearised(far, near, model, parameters, seen)
            step = linear.step()[:model.n_parameters]
            before = model.mapping(parameters).to_specimen(corners)
            parameters = parameters + step
            moved = model.mapping(parameters).to_image(before) - corners
            if np.abs(moved).max() < tolerance:
                break
        else:
            raise ConvergenceError(f"registration of the near image did not settle in {_MAX_ITERATIONS} iterations: "
                                   f"its corners still move by {np.abs(moved).max():.1e} near px")
        seen = _visible(far.window, model.mapping(parameters), part)
        linear = _linearised(far, near, model, parameters, seen)
    except (ValueError, linalg.LinAlgError) as error:
        raise ConvergenceError(f"registration of the near image ran away: {error}") from error
    return _found(model, parameters, linear, seen, iteration)


@dataclass(frozen=True, eq=False)
class _Patch:
    """Far pixels whose squares lie in a part of the near image: mask (rows, columns) of a window, points (n, 2)."""

    rows: slice
    columns: slice
    mask: NDArray[np.bool_]
    points: Array


@dataclass(frozen=True, eq=False)
class _Linearised:
    """Far and near grey levels (n,), and the derivatives of the near ones by the mapping's parameters (n, m).

    slopes: of the uncorrected near grey levels from the near gradient; steered: of the corrected ones from the far
    gradient.
    """

    far: Array
    near: Array
    slopes: Array
    steered: Array

    @property
    def grey_correction(self) -> tuple[float, float]:
        """Gain and offset whose residual has zero mean and no correlation with the far grey levels."""
        centred = self.far - self.far.mean()
        common = float(centred @ self.near)
        if not common > 0:
            raise ValueError("the images have no common texture there")
        gain = float(centred @ centred) / common
        return gain, float(self.far.mean() - gain * self.near.mean())

    @property
    def residual(self) -> Array:
        gain, offset = self.grey_correction
        return self.far - gain * self.near - offset

    @property
    def jacobian(self) -> Array:
        """J: derivatives of the corrected near grey levels by the parameters, the gain and the offset."""
        return np.column_stack([self.grey_correction[0] * self.slopes, self.near, np.ones_like(self.near)])

    @property
    def weights(self) -> Array:
        """Z: the columns that the residual is orthogonal to in the end."""
        return np.column_stack([self.steered, self.far, np.ones_like(self.far)])

    def step(self) -> Array:
        """Correction of the parameters, the gain and the offset; Z^T Z stands for Z^T J, which is useless far off."""
        z = self.weights
        return np.asarray(linalg.solve(z.T @ z, z.T @ self.residual, assume_a="pos"))


def _linearised(far: GradientImage, near: NearImage, model: CameraModel, parameters: Array,
                seen: _Patch) -> _Linearised:
    mapping = model.mapping(parameters)
    means = near.averages(mapping, seen.points)
    by_parameters = model.derivatives(parameters, seen.points)
    grey, by_x, by_y = (a[seen.rows, seen.columns][seen.mask].astype(np.float64)
                        for a in (far.values, far.by_x, far.by_y))
    # grad f_far = (d phi / d X)^T grad f_near.
    gradient = np.linalg.solve(mapping.jacobian(seen.points).transpose(0, 2, 1),
                               np.column_stack([by_x, by_y])[:, :, None])[:, :, 0]
    return _Linearised(grey, means[:, 0], np.einsum("ni,nim->nm", means[:, 1:], by_parameters),
                       np.einsum("ni,nim->nm", gradient, by_parameters))


def _corners(part: Window) -> Array:
    left, top, right, bottom = part.x0, part.y0, part.x1 - 1, part.y1 - 1
    return np.array([[left, top], [right, top], [left, bottom], [right, bottom]], dtype=np.float64)


def _visible(far: Window, mapping: CameraMapping, part: Window) -> _Patch:
    around = mapping.to_specimen(_corners(part))
    low, high = np.floor(around.min(axis=0)).astype(int) - 1, np.ceil(around.max(axis=0)).astype(int) + 2
    box = Window(*low, *high).intersection(far)
    if box.width < 8 or box.height < 8:
        raise ValueError("the near image covers fewer than 8 far px")
    x, y = np.meshgrid(np.arange(box.x0, box.x1 + 1) - 0.5, np.arange(box.y0, box.y1 + 1) - 0.5)
    image = mapping.to_image(np.column_stack([x.ravel(), y.ravel()])).reshape(*x.shape, 2)
    inside = ((image >= (part.x0 - 0.5, part.y0 - 0.5)) & (image <= (part.x1 - 0.5, part.y1 - 0.5))).all(axis=2)
    mask = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
    if np.count_nonzero(mask) < 64:
        raise ValueError("the near image covers fewer than 64 far pixels")
    points = np.column_stack([x[:-1, :-1][mask] + 0.5, y[:-1, :-1][mask] + 0.5])
    return _Patch(slice(box.y0, box.y1), slice(box.x0, box.x1), mask, points)


def _found(model: CameraModel, parameters: Array, linear: _Linearised, seen: _Patch, iterations: int) -> Registration:
    residual, weights = linear.residual, linear.weights
    inverse = linalg.inv(weights.T @ linear.jacobian)
    # Degrees of freedom that the parameters took from the residual.
    freedom = len(residual) / (len(residual) - weights.shape[1])
    scatter = freedom * _correlated_scatter(residual, weights, seen.mask)
    plain = freedom * float(residual @ residual) / len(residual) * (weights.T @ weights)
    m = model.n_parameters
    gain, offset = linear.grey_correction
    covariance, independent = ((inverse @ s @ inverse.T)[:m, :m] for s in (scatter, plain))
    ratio = float(np.mean(np.diag(covariance) / np.maximum(np.diag(independent), 1e-300)))
    return Registration(model, parameters, covariance, gain, offset, _coefficient(linear.far, linear.near),
                        float(np.median(list(_local_coefficients(linear, seen)))), float(residual.std()),
                        len(residual), ratio, iterations)


def _correlated_scatter(residual: Array, weights: Array, mask: NDArray[np.bool_]) -> Array:
    """Z^T R Z."""
    height, width = mask.shape
    r = np.zeros((height, width))
    r[mask] = residual
    columns = np.zeros((height, width, weights.shape[1]))
    columns[mask] = weights
    reach = CORRELATION_LENGTH
    total = np.zeros((weights.shape[1],) * 2)
    for dy in range(min(reach, height - 1) + 1):
        for dx in range(-min(reach, width - 1), min(reach, width - 1) + 1):
            if dy == 0 and dx < 0:
                continue
            here = np.s_[:height - dy, max(-dx, 0): width - max(dx, 0)]
            there = np.s_[dy:, max(dx, 0): width - max(-dx, 0)]
            taper = (1 - dy / (reach + 1)) * (1 - abs(dx) / (reach + 1))
            autocovariance = float((r[here] * r[there]).sum()) / len(residual)
            product = np.tensordot(columns[here], columns[there], axes=([0, 1], [0, 1]))
            both = product if dy == 0 and dx == 0 else product + product.T
            total += taper * autocovariance * both
    return total


def _local_coefficients(linear: _Linearised, seen: _Patch, side: int = 16) -> Iterator[float]:
    """Correlation coefficients of squares of far pixels, of those that are half seen and have texture."""
    row, column = np.nonzero(seen.mask)
    block = (row // side) * (seen.mask.shape[1] // side + 1) + column // side
    order = np.argsort(block, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(block[order])) + 1):
        if len(members) >= side**2 / 2 or len(members) == len(order):
            yield _coefficient(linear.far[members], linear.near[members])


def _coefficient(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 0 else 0.0
