"""Registration of an image in one of lower magnification: Gauss-Newton on the few parameters of a camera mapping."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, ndimage

from ddic.arrays import Array, BoolArray
from ddic.errors import ConvergenceError
from ddic.images.camera import CameraMapping
from ddic.images.source import ImageSource
from ddic.images.spline import PADDING, GradientImage, read_gradient, read_spline
from ddic.images.window import Window
from ddic.kinematics.motions import fit_complex_factor

Kind = Literal["translation", "similarity", "homography"]

N_PLANE: dict[Kind, int] = {"translation": 2, "similarity": 4, "homography": 8}
"""Parameters of each kind, without the distortion's."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Camera mappings of one kind; parameters are image px, but for the distortion, so that they are of like size.

    Attributes
    ----------
    kind : {"translation", "similarity", "homography"}
        What the homography may be; a translation keeps the ratio and does not turn.
    ratio : float
        Image px per specimen px, of a translation.
    middle : (2,) array
        Specimen point about which parameters are written, specimen px.
    length : float
        Specimen px in which distances from it are measured.
    centre, radius : (2,) array and float
        Of the radial distortion, image px.
    distorts : bool
        Whether k1 is a parameter, the last one.
    """

    kind: Kind
    ratio: float
    middle: Array
    length: float
    centre: Array
    radius: float
    distorts: bool = False

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return N_PLANE[self.kind] + self.distorts

    def build_mapping(self, parameters: Array) -> CameraMapping:
        """Build the mapping from specimen to image px with parameters (n_parameters,); ValueError if there is none."""
        homography = self._local_homography(parameters) @ self._to_local()
        k1 = parameters[-1] if self.distorts else 0.0
        return CameraMapping(homography / homography[2, 2], self.centre, self.radius, np.array([k1, 0.0]))

    def fit(self, mapping: CameraMapping) -> Array:
        """Find the parameters (n_parameters,) of this kind of mapping that is like another one about the middle."""
        local = mapping.homography @ np.linalg.inv(self._to_local())
        local = local / local[2, 2]
        place = local[:2, 2]
        found: Array
        if self.kind == "translation":
            found = place
        elif self.kind == "homography":
            found = local.ravel()[:8]
        else:
            # The rotation and stretch nearest to the mapping's slope.
            slope = local[:2, :2] - np.outer(place, local[2, :2])
            c = 0.5 * (slope[0, 0] + slope[1, 1])
            s = 0.5 * (slope[1, 0] - slope[0, 1])
            found = np.concatenate([[c, s], place])
        if not self.distorts:
            return found
        k1 = mapping.radial[:1] * (self.radius / mapping.radius) ** 2
        return np.concatenate([found, k1])

    def differentiate(self, parameters: Array, points: Array) -> Array:
        """Differentiate the image positions of specimen points (n, 2) by the parameters: (n, 2, n_parameters)."""
        local = (points - self.middle) / self.length
        x, y = local.T
        one, zero = np.ones_like(x), np.zeros_like(x)
        if self.kind == "homography":
            h = self._local_homography(parameters)
            depth = local @ h[2, :2] + 1.0
            place = (local @ h[:2, :2].T + h[:2, 2]) / depth[:, None]
            of_x = [x, y, one, zero, zero, zero, -place[:, 0] * x, -place[:, 0] * y]
            of_y = [zero, zero, zero, x, y, one, -place[:, 1] * x, -place[:, 1] * y]
            undistorted = np.array([of_x, of_y]).transpose(2, 0, 1) / depth[:, None, None]
        elif self.kind == "similarity":
            undistorted = np.array([[x, -y, one, zero], [y, x, zero, one]]).transpose(2, 0, 1)
        else:
            undistorted = np.array([[one, zero], [zero, one]]).transpose(2, 0, 1)
        return self._distort(parameters, points, undistorted) if self.distorts else undistorted

    def _distort(self, parameters: Array, points: Array, undistorted: Array) -> Array:
        """Turn derivatives of undistorted positions into those of distorted ones, and append those by k1."""
        mapping = self.build_mapping(parameters)
        plain = CameraMapping(mapping.homography).to_image(points)
        distortion = CameraMapping(np.eye(3), self.centre, self.radius, mapping.radial)
        offset = plain - self.centre
        by_k1 = offset * ((offset**2).sum(axis=1) / self.radius**2)[:, None]
        return np.concatenate([distortion.jacobian(plain) @ undistorted, by_k1[:, :, None]], axis=2)

    def _local_homography(self, parameters: Array) -> Array:
        """The homography (3, 3) from distances to the middle, over the length, to image px."""
        if self.kind == "homography":
            return np.append(parameters[:8], 1.0).reshape(3, 3)
        if self.kind == "similarity":
            c, s, x, y = parameters[:4]
        else:
            x, y = parameters[:2]
            c, s = self.ratio * self.length, 0.0
        return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])

    def _to_local(self) -> Array:
        """The homography (3, 3) from specimen px to distances to the middle, over the length."""
        x, y = self.middle
        size = 1.0 / self.length
        return np.array([[size, 0.0, -x * size], [0.0, size, -y * size], [0.0, 0.0, 1.0]])


def fit_similarity(mapping: CameraMapping, points: Array) -> tuple[CameraMapping, Array]:
    """Find the similarity that is closest to a mapping at specimen points (n, 2), in the sense of least squares.

    Beside it comes what the mapping adds to it at the points, (n, 2), image px.
    """
    middle = points.mean(axis=0)
    image = mapping.to_image(points)
    place = image.mean(axis=0)
    turn = fit_complex_factor(points - middle, image - place)
    homography = np.eye(3)
    homography[:2, :2] = turn
    homography[:2, 2] = place - turn @ middle
    similarity = CameraMapping(homography)
    return similarity, image - similarity.to_image(points)


TOLERANCE = 1e-4
"""Gauss-Newton stops when the corners of the near image's part move by less, near px."""

CORRELATION_LENGTH = 6
"""Far px beyond which residuals count as independent."""

_MAX_ITERATIONS = 60
_DEGREE = 3
_SAMPLES_AT_ONCE = 1 << 20
"""Samples of the near image that are evaluated at once: more take more memory."""

_CHANGING_ITERATIONS = 4
"""Iterations in which pixels at the rim may come and go; then their number is kept so that the steps can end."""

_LOCAL_SIDE = 16
"""Side, far px, of the squares whose correlation coefficients are told; a larger one evens out what fits badly."""

_LEAST_SIDE, _LEAST_PIXELS = 8, 64
"""Far px, either way and in all, below which a registration is not tried."""


@dataclass(frozen=True, eq=False)
class NearImage:
    """The finer image as a spline, its gradient at pixel centres, and how it is averaged over a far pixel.

    Attributes
    ----------
    coefficients : (height + 2 PADDING, width + 2 PADDING) array
        Of the spline.
    by_x, by_y : (height, width) array
        Gradient, grey levels per near px.
    samples : int
        Per far pixel either way.
    """

    coefficients: NDArray[np.float32]
    by_x: NDArray[np.float32]
    by_y: NDArray[np.float32]
    samples: int

    @property
    def window(self) -> Window:
        """All its pixels."""
        return Window.of_size(self.by_x.shape[1], self.by_x.shape[0])

    def average(self, mapping: CameraMapping, points: Array) -> Array:
        """Average grey level and gradient by near x and y, (n, 3), over the unit squares about far points (n, 2)."""
        along = (np.arange(self.samples) + 0.5) / self.samples - 0.5
        within = np.stack(np.meshgrid(along, along), axis=-1).reshape(1, -1, 2)
        n_samples = within.shape[1]
        averages = np.empty((len(points), 3))
        step = max(_SAMPLES_AT_ONCE // n_samples, 1)
        for begin in range(0, len(points), step):
            part = slice(begin, begin + step)
            positions = mapping.to_image((points[part, None] + within).reshape(-1, 2))
            rows_and_columns = positions[:, ::-1].T
            grey = ndimage.map_coordinates(self.coefficients, rows_and_columns + PADDING[_DEGREE], output=np.float64,
                                           order=_DEGREE, mode="nearest", prefilter=False)
            # The gradient only tells how certain the result is: linear interpolation does for it.
            slopes = [ndimage.map_coordinates(by, rows_and_columns, output=np.float64, order=1, mode="nearest")
                      for by in (self.by_x, self.by_y)]
            samples = np.stack([grey, *slopes], axis=1)
            averages[part] = samples.reshape(-1, n_samples, 3).mean(axis=1)
        return averages


@dataclass(frozen=True, eq=False)
class Registration:
    """What Gauss-Newton found.

    Attributes
    ----------
    model : CameraModel
        Family of the mapping.
    parameters : (n_parameters,) array
        Of the mapping.
    covariance : (n_parameters, n_parameters) array
        Of the parameters.
    gain, offset : float
        f_far = gain f_near + offset, f_near averaged over far pixels; offset in grey levels.
    coefficient : float
        Zero-mean normalised cross-correlation.
    local_coefficient : float
        Median of those of squares of 16 x 16 far px.
    residual_std : float
        Grey levels of the far image.
    n_pixels : int
        Far pixels compared.
    correlation : float
        Variance of the parameters over that from independent residuals.
    iterations : int
        Of Gauss-Newton.
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
        return self.model.build_mapping(self.parameters)


def read_near_image(source: ImageSource, ratio: float) -> NearImage:
    """Read the near image as a spline; ``ratio``, near px per far px, tells how many samples a far pixel takes."""
    gradient = read_gradient(source, source.extent, _DEGREE)
    coefficients = read_spline(source, source.extent, _DEGREE).coefficients
    by_x, by_y = gradient.slopes
    return NearImage(coefficients, by_x, by_y, max(round(ratio), 1))


def register(far: GradientImage, near: NearImage, model: CameraModel, start: Array, part: Window,
             tolerance: float = TOLERANCE) -> Registration:
    """Find phi, gain and offset with Z^T r = 0, r = f_far - gain mean(f_near(phi)) - offset at far pixels.

    The near image is averaged over the square that each far pixel covers, as the far camera does. Columns of Z are
    the derivatives of r by the parameters, made of the gradient of the far image, the far grey levels, and 1: what
    only the near camera resolves is noise in the near averages, and must not be in what weighs the residuals.
    The covariance is A^-1 Z^T R Z A^-T, A = Z^T J with J the derivatives made of the near gradient, and R the
    covariance of the residuals from their autocorrelation up to CORRELATION_LENGTH px, tapered linearly.

    ``far`` is the whole far image; of the near one the pixels of ``part`` are used. ``model`` is the family of phi,
    ``start`` (n_parameters,) are its parameters to begin with. It ends where the part's corners move by less than
    ``tolerance``, near px. Raises ConvergenceError where the mapping runs away or does not settle.
    """
    parameters = start
    corners = part.corners
    try:
        for iteration in range(1, _MAX_ITERATIONS + 1):
            if iteration <= _CHANGING_ITERATIONS:
                seen = _find_visible(far.window, model.build_mapping(parameters), part)
            linear = _linearise(far, near, model, parameters, seen)
            correction = linear.solve()[:model.n_parameters]
            before = model.build_mapping(parameters).to_specimen(corners)
            parameters = parameters + correction
            moved = model.build_mapping(parameters).to_image(before) - corners
            if np.abs(moved).max() < tolerance:
                break
        else:
            raise ConvergenceError(f"registration of the near image did not settle in {_MAX_ITERATIONS} iterations: "
                                   f"its corners still move by {np.abs(moved).max():.1e} near px")
        seen = _find_visible(far.window, model.build_mapping(parameters), part)
        linear = _linearise(far, near, model, parameters, seen)
    except (ValueError, linalg.LinAlgError) as error:
        raise ConvergenceError(f"registration of the near image ran away: {error}") from error
    return _describe(model, parameters, linear, seen, iteration)


@dataclass(frozen=True, eq=False)
class _Patch:
    """Far pixels whose squares lie in a part of the near image: mask (rows, columns) of a window, points (n, 2)."""

    window: Window
    mask: BoolArray
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
        """R (n,), grey levels of the far image."""
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

    def solve(self) -> Array:
        """Correction of the parameters, the gain and the offset; Z^T Z stands for Z^T J, which is useless far off."""
        z = self.weights
        return np.asarray(linalg.solve(z.T @ z, z.T @ self.residual, assume_a="pos"))


def _linearise(far: GradientImage, near: NearImage, model: CameraModel, parameters: Array, seen: _Patch) -> _Linearised:
    """Grey levels at the far pixels of a patch, and their derivatives by the parameters."""
    mapping = model.build_mapping(parameters)
    averages = near.average(mapping, seen.points)
    near_grey, near_gradient = averages[:, 0], averages[:, 1:]
    inside = far.window.locate(seen.window)
    far_grey, by_x, by_y = (values[inside][seen.mask].astype(np.float64) for values in (far.values, *far.slopes))
    # grad f_far = (d phi / d X)^T grad f_near.
    transposed = mapping.jacobian(seen.points).transpose(0, 2, 1)
    far_gradient = np.linalg.solve(transposed, np.column_stack([by_x, by_y])[:, :, None])[:, :, 0]
    by_parameters = model.differentiate(parameters, seen.points)
    return _Linearised(
        far=far_grey,
        near=near_grey,
        slopes=np.einsum("ni,nim->nm", near_gradient, by_parameters),
        steered=np.einsum("ni,nim->nm", far_gradient, by_parameters),
    )


def _find_visible(far: Window, mapping: CameraMapping, part: Window) -> _Patch:
    """Far pixels whose squares lie in a part of the near image; raises ValueError where they are too few."""
    around = mapping.to_specimen(part.corners)
    low = np.floor(around.min(axis=0)).astype(int) - 1
    high = np.ceil(around.max(axis=0)).astype(int) + 2
    box = Window.between(low, high).intersection(far)
    if box.width < _LEAST_SIDE or box.height < _LEAST_SIDE:
        raise ValueError(f"the near image covers fewer than {_LEAST_SIDE} far px")
    # Corners of the pixels' squares, and which of them the part shows.
    x, y = np.meshgrid(np.arange(box.x0, box.x1 + 1) - 0.5, np.arange(box.y0, box.y1 + 1) - 0.5)
    image = mapping.to_image(np.column_stack([x.ravel(), y.ravel()])).reshape(*x.shape, 2)
    beyond_low = image >= (part.x0 - 0.5, part.y0 - 0.5)
    before_high = image <= (part.x1 - 0.5, part.y1 - 0.5)
    inside = (beyond_low & before_high).all(axis=2)
    mask = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
    if np.count_nonzero(mask) < _LEAST_PIXELS:
        raise ValueError(f"the near image covers fewer than {_LEAST_PIXELS} far pixels")
    points = np.column_stack([x[:-1, :-1][mask] + 0.5, y[:-1, :-1][mask] + 0.5])
    return _Patch(box, mask, points)


def _describe(model: CameraModel, parameters: Array, linear: _Linearised, seen: _Patch,
              iterations: int) -> Registration:
    """The covariance and all that is told of a registration."""
    residual, weights = linear.residual, linear.weights
    inverse = linalg.inv(weights.T @ linear.jacobian)
    # Degrees of freedom that the parameters took from the residual.
    freedom = len(residual) / (len(residual) - weights.shape[1])
    scatter = freedom * _correlated_scatter(residual, weights, seen.mask)
    independent_scatter = freedom * float(residual @ residual) / len(residual) * (weights.T @ weights)
    m = model.n_parameters
    covariance = (inverse @ scatter @ inverse.T)[:m, :m]
    independent = (inverse @ independent_scatter @ inverse.T)[:m, :m]
    correlation = np.mean(np.diag(covariance) / np.maximum(np.diag(independent), 1e-300))
    gain, offset = linear.grey_correction
    return Registration(
        model=model,
        parameters=parameters,
        covariance=covariance,
        gain=gain,
        offset=offset,
        coefficient=_correlate(linear.far, linear.near),
        local_coefficient=float(np.median(list(_local_coefficients(linear, seen)))),
        residual_std=float(residual.std()),
        n_pixels=len(residual),
        correlation=float(correlation),
        iterations=iterations,
    )


def _correlated_scatter(residual: Array, weights: Array, mask: BoolArray) -> Array:
    """Z^T R Z: sums over pairs of pixels, distance by distance, each pair of distances +-(dx, dy) once."""
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


def _local_coefficients(linear: _Linearised, seen: _Patch) -> Iterator[float]:
    """Correlation coefficients of squares of far pixels, of those that are half seen and have texture."""
    side = _LOCAL_SIDE
    row, column = np.nonzero(seen.mask)
    block = (row // side) * (seen.mask.shape[1] // side + 1) + column // side
    order = np.argsort(block, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(block[order])) + 1):
        if len(members) >= side**2 / 2 or len(members) == len(order):
            yield _correlate(linear.far[members], linear.near[members])


def _correlate(a: Array, b: Array) -> float:
    """Correlation coefficient of grey levels (n,) and (n,); 0 where one is blank."""
    a = a - a.mean()
    b = b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 0 else 0.0
