"""Camera mappings: where a camera sees a point of the specimen."""

from dataclasses import dataclass, field

import numpy as np

from ddic.arrays import Array, BoolArray

_MAX_ITERATIONS = 50
_ROUNDING = 8 * float(np.finfo(np.float64).eps)


def _origin() -> Array:
    return np.zeros(2)


@dataclass(frozen=True, eq=False)
class CameraMapping:
    """A homography from the specimen frame to image pixels, followed by radial distortion.

    x_u = homography applied to X, x = centre + (x_u - centre) (1 + k1 r^2 + k2 r^4), r = |x_u - centre| / radius.
    Raises ValueError where a shape is wrong, a number is not finite, entry [2, 2] is not 1, the homography is singular
    or the radius is not positive.

    Attributes
    ----------
    homography : (3, 3) array
        From the specimen's frame to undistorted image pixels; entry [2, 2] is 1.
    centre : (2,) array
        Centre of the radial distortion, image pixels.
    radius : float
        Length by which the distortion's radii are divided, image pixels.
    radial : (2,) array
        k1 and k2, no unit.
    """

    homography: Array
    centre: Array = field(default_factory=_origin)
    radius: float = 1.0
    radial: Array = field(default_factory=_origin)

    def __post_init__(self) -> None:
        for name, shape in (("homography", (3, 3)), ("centre", (2,)), ("radial", (2,))):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != shape or not np.isfinite(values).all():
                size = " x ".join(map(str, shape))
                raise ValueError(f"{name}: expected {size} finite numbers, got {values.tolist()}")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if self.homography[2, 2] != 1.0:
            raise ValueError(f"homography: entry [2, 2] is {self.homography[2, 2]:g}; divide all entries by it")
        if np.linalg.det(self.homography) == 0.0:
            raise ValueError("homography: is singular, it maps the specimen to a line")
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise ValueError(f"radius: expected a positive number of px, got {self.radius:g}")

    @property
    def distorts(self) -> bool:
        """Whether there is any radial distortion."""
        return bool(self.radial.any())

    def to_image(self, points: Array) -> Array:
        """Map specimen points, (n, 2), to the image, both pixels; raises ValueError beyond the homography's horizon."""
        x = _project(self.homography, points)[0]
        if not self.distorts:
            return x
        offset = x - self.centre
        return self.centre + offset * self._factor((offset**2).sum(axis=1) / self.radius**2)[:, None]

    def jacobian(self, points: Array) -> Array:
        """Differentiate the image position by the specimen's: d x_image / d X, (n, 2, 2), rows x and y of the image.

        Its unit is image pixels per pixel of the specimen's frame. Raises ValueError as ``to_image`` does.
        """
        h = self.homography
        x, depth = _project(h, points)
        projective = (h[None, :2, :2] - x[:, :, None] * h[None, 2:, :2]) / depth[:, None, None]
        if not self.distorts:
            return projective
        offset = (x - self.centre) / self.radius
        square = (offset**2).sum(axis=1)
        slope = 2 * (self.radial[0] + 2 * self.radial[1] * square)
        distortion = (self._factor(square)[:, None, None] * np.eye(2)
                      + slope[:, None, None] * offset[:, :, None] * offset[:, None, :])
        return np.asarray(distortion @ projective)

    def to_specimen(self, points: Array) -> Array:
        """Map points of the image, (n, 2), back to the specimen's frame, both pixels.

        A point that is nan, as where nothing was measured, stays nan. Raises ValueError where the distortion cannot be
        undone, or the point lies beyond the horizon.
        """
        x = self._undistorted(np.asarray(points, dtype=np.float64)) if self.distorts else points
        return _project(np.linalg.inv(self.homography), x)[0]

    def _factor(self, square: Array) -> Array:
        return np.asarray(1 + square * (self.radial[0] + square * self.radial[1]))

    def _undistorted(self, points: Array) -> Array:
        """Newton's method on r (1 + k1 r^2 + k2 r^4) = distance of the distorted point, for all points at once."""
        offset = points - self.centre
        distance = np.sqrt((offset**2).sum(axis=1)) / self.radius
        is_nowhere = np.isnan(distance)
        r = distance.copy()
        with np.errstate(all="ignore"):
            for _ in range(_MAX_ITERATIONS):
                residual = r * self._factor(r**2) - distance
                if (is_nowhere | (np.abs(residual) <= _ROUNDING * distance)).all():
                    break
                r -= residual / self._stretch(r**2)
            undone = (np.abs(r * self._factor(r**2) - distance) <= 4 * _ROUNDING * distance) & self._unfolded(r)
        failed = ~undone & ~is_nowhere
        if failed.any():
            worst = points[int(np.argmax(failed))]
            raise ValueError(f"radial distortion k1 = {self.radial[0]:g}, k2 = {self.radial[1]:g} (radius "
                             f"{self.radius:g} px) cannot be undone at image position ({worst[0]:g}, {worst[1]:g}) px: "
                             "no point before the place where the distortion folds the image is mapped there")
        scale = np.divide(r, distance, out=np.ones_like(r), where=distance > 0)
        return np.asarray(self.centre + offset * scale[:, None])

    def _stretch(self, square: Array) -> Array:
        """Derivative of r (1 + k1 r^2 + k2 r^4)."""
        return np.asarray(1 + square * (3 * self.radial[0] + 5 * square * self.radial[1]))

    def _unfolded(self, r: Array) -> BoolArray:
        """Whether the distorted radius grows all the way from 0 to r >= 0."""
        k1, k2 = self.radial
        square = r**2
        # The stretch is a parabola in r^2, 1 at 0: its least value lies at its vertex or at the end.
        lowest = np.clip(-3 * k1 / (10 * k2), 0.0, square) if k2 > 0 else square
        return np.asarray((r >= 0) & (self._stretch(square) > 0) & (self._stretch(lowest) > 0))


def identity() -> CameraMapping:
    """Return the mapping of the camera whose pixels are the specimen's frame."""
    return CameraMapping(np.eye(3))


def similarity(scale: float, rotation_degrees: float, translation: tuple[float, float]) -> CameraMapping:
    """Return the mapping x = scale R(rotation) X + translation, without distortion.

    The scale is in image pixels per pixel of the specimen's frame, the rotation from x towards y, that is clockwise on
    the screen, the translation in image pixels. Raises ValueError where the scale is not positive or a number is not
    finite.
    """
    if not scale > 0:
        raise ValueError(f"scale: expected a positive number of image px per specimen px, got {scale:g}")
    c, s = scale * np.cos(np.deg2rad(rotation_degrees)), scale * np.sin(np.deg2rad(rotation_degrees))
    return CameraMapping(np.array([[c, -s, translation[0]], [s, c, translation[1]], [0.0, 0.0, 1.0]]))


def _project(homography: Array, points: Array) -> tuple[Array, Array]:
    """A homography (3, 3) applied to points (n, 2), and their depth (n,), 1 at the specimen's origin.

    The inverse of a homography, not scaled, gives points in front of the camera a positive depth too. A point that is
    nan, as where nothing was measured, stays nan.
    """
    points = np.asarray(points, dtype=np.float64)
    moved = points @ homography[:, :2].T + homography[:, 2]
    behind = moved[:, 2] <= 0
    if behind.any():
        beyond = points[int(np.argmax(behind))]
        raise ValueError(f"point ({beyond[0]:g}, {beyond[1]:g}) lies beyond the horizon of the homography "
                         f"{homography.tolist()}")
    return moved[:, :2] / moved[:, 2:], moved[:, 2]
