"""Rendering a pair of images whose displacement is known exactly: motion inverted, noise added, grey levels rounded."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.errors import ConvergenceError, InputError
from ddic.images.window import Window
from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.synth.fields import DisplacementField, Hole, Pair
from ddic.synth.speckle import SpeckleTexture, TwoScaleTexture

# Distance of u(y - v) from v at which the iteration stops, px; a larger one blurs the truth of a pair.
_TOLERANCE = 1e-12
# The same relative to the largest displacement, which rounding keeps from being met better.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)
_MAX_ITERATIONS = 50
# The gradient is kept from one iteration to the next as long as each gains two digits.
_FAST = 0.01


def find_reference_points(field: DisplacementField, points: Array) -> Array:
    """Solve x + u(x) = y for x (n, 2) at deformed points y (n, 2), pixels.

    Newton's method on the displacement v = y - x, stopped when |u(y - v) - v| <= 1e-12 px (or four roundings of the
    largest displacement, where that is more) at all points. Raises InputError where the field folds the plane (det(I +
    grad u) <= 0), ConvergenceError if 50 iterations are not enough.
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


def _inverse_of_motion(gradient: Array, x: Array) -> tuple[ Array, Array, Array, Array]:
    """Entries 00, 01, 10, 11 of (I + grad u)^-1 at x (n, 2), each (n,)."""
    a, b = 1 + gradient[:, 0, 0], gradient[:, 0, 1]
    c, d = gradient[:, 1, 0], 1 + gradient[:, 1, 1]
    determinant = a * d - b * c
    if not (determinant > 0).all():
        folded = x[np.argmin(determinant)]
        raise InputError(f"displacement field: folds the image near ({folded[0]:g}, {folded[1]:g}) px, "
                         "det(I + grad u) <= 0; use a smaller amplitude or a larger wavelength")
    return d / determinant, -b / determinant, -c / determinant, a / determinant


Stored = NDArray[Any]

_FULL_SCALE = {8: 255.0, 16: 65535.0, 32: 255.0}
_DTYPES: dict[int, np.dtype[Any]] = {
    8: np.dtype(np.uint8), 16: np.dtype(np.uint16), 32: np.dtype(np.float32)}


@dataclass(frozen=True)
class Digitiser:
    """Camera model: full scale, additive Gaussian noise, rounding.

    Raises InputError for another bit depth, a negative noise or a negative seed.

    Attributes
    ----------
    bit_depth : int
        8 (0..255), 16 (0..65535), or 32 for float32 values on the scale 0..255, not rounded.
    noise : float
        Standard deviation in grey levels of an 8-bit image, whatever the bit depth.
    seed : int
        Of the noise, at least 0.
    """

    bit_depth: int = 8
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.bit_depth not in _DTYPES:
            raise InputError(f"image: bit_depth = {self.bit_depth}: must be 8, 16 or 32 (float)")
        if not (self.noise >= 0 and math.isfinite(self.noise)):
            raise InputError(f"image: noise = {self.noise}: must be at least 0 grey levels")
        if self.seed < 0:
            raise InputError(f"image: seed = {self.seed}: must be at least 0")

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the stored values: uint8, uint16 or float32."""
        return _DTYPES[self.bit_depth]

    def store(self, grey: Array, stream: tuple[int, ...]) -> Stored:
        """Turn grey levels of any shape, fractions of full scale, into stored values of type ``dtype``.

        The seed and the numbers of ``stream`` fix the noise; different streams are independent.
        """
        full_scale = _FULL_SCALE[self.bit_depth]
        levels = grey * full_scale
        if self.noise > 0:
            generator = np.random.default_rng([self.seed, *stream])
            levels += self.noise * (full_scale / 255.0) * generator.standard_normal(levels.shape)
        np.clip(levels, 0.0, full_scale, out=levels)
        if self.bit_depth != 32:
            np.rint(levels, out=levels)
        return levels.astype(self.dtype)


@dataclass(frozen=True)
class Picture:
    """Size of a camera's pictures and how they are digitised.

    Raises InputError where there is no pixel.

    Attributes
    ----------
    width, height : int
        Pixels, at least 1.
    digitiser : Digitiser
        From grey levels to stored values; 8 bit without noise where it is left out.
    """

    width: int
    height: int
    digitiser: Digitiser = field(default_factory=Digitiser)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InputError(f"image: size = {self.width}x{self.height}: must be at least 1x1 pixels")

    @property
    def middle(self) -> Pair:
        """Position of the picture's centre, pixels."""
        return (self.width - 1) / 2, (self.height - 1) / 2


# Images are made square by square: temporary arrays stay in cache and memory does not grow with the image.
# The noise is drawn square by square too, so this number is part of what a seed means.
_SQUARE = 256


@dataclass(frozen=True)
class ImagePair:
    """Reference and deformed image.

    Attributes
    ----------
    reference, deformed : (height, width) array
        Stored grey levels: uint8, uint16 or float32.
    """

    reference: Stored
    deformed: Stored


class Pictured(Protocol):
    """What a camera sees before and after the motion, at any point of its picture."""

    def reference_grey(self, points: Array) -> Array:
        """Evaluate the grey level f before the motion, (n,) fractions of full scale, at points (n, 2), pixels."""

    def deformed_grey(self, points: Array) -> Array:
        """Evaluate the grey level g after the motion, (n,) fractions of full scale, at points (n, 2), pixels."""


@dataclass(frozen=True)
class Scene:
    """What the camera looks at.

    Attributes
    ----------
    texture : SpeckleTexture or TwoScaleTexture
        Paint of the plane.
    field : DisplacementField
        Its motion.
    hole : Hole, optional
        Cut out of the paint.
    """

    texture: SpeckleTexture | TwoScaleTexture
    field: DisplacementField
    hole: Hole | None = None

    def reference_grey(self, points: Array) -> Array:
        """Evaluate the grey level f before the motion, (n,) fractions of full scale, at points (n, 2), pixels."""
        x, y = points.T
        grey = self.texture.grey(x, y)
        return grey if self.hole is None else self.hole.cut(grey, x, y)

    def deformed_grey(self, points: Array) -> Array:
        """Evaluate the grey level g after the motion at points y: f at the solution x of x + u(x) = y."""
        return self.reference_grey(find_reference_points(self.field, points))


def render_pair(scene: Pictured, picture: Picture) -> ImagePair:
    """Render f and g in memory so that f(x) = g(x + u(x)) holds without any interpolation, with independent noise.

    Raises InputError for a field that folds the plane, ConvergenceError where the motion cannot be inverted to 1e-12
    px.
    """
    bands = list(_bands(scene, picture, stream=0))
    reference = np.concatenate([band.reference for band in bands])
    deformed = np.concatenate([band.deformed for band in bands])
    return ImagePair(reference, deformed)


def write_pair(paths: tuple[Path, Path], scene: Pictured, picture: Picture, stream: int = 0,
               files: NewFiles | None = None) -> None:
    """Write the images of ``render_pair``, reference first, to two uncompressed TIFF files, one band in memory.

    The noise is independent in the two: ``stream`` is that of the reference image, the next one that of the deformed
    image. They take their names with ``files``; by default the two do so by themselves. Raises InputError for a field
    that folds the plane or a folder that cannot be written to, no half-written file staying; OSError where the disk
    does not take them; ConvergenceError where the motion cannot be inverted to 1e-12 px.
    """
    with begin_files(files) as new:
        reference, deformed = (_create_tiff(new.begin(path), picture) for path in paths)
        first_rows = range(0, picture.height, _SQUARE)
        for row, band in zip(first_rows, _bands(scene, picture, stream), strict=True):
            reference.fill(row, band.reference)
            deformed.fill(row, band.deformed)


@dataclass(frozen=True)
class _EmptyTiff:
    """A TIFF file whose header and size are final; its rows lie one after the other from ``offset``."""

    path: Path
    offset: int

    def fill(self, row: int, band: Stored) -> None:
        """Write whole rows, the first of which is ``row``."""
        with self.path.open("r+b") as file:
            file.seek(self.offset + row * band[0].nbytes)
            file.write(band.tobytes())


def _create_tiff(path: Path, picture: Picture) -> _EmptyTiff:
    """Make a file of the picture's size and type."""
    import tifffile

    shape = (picture.height, picture.width)
    pixels = tifffile.memmap(path, shape=shape, dtype=picture.digitiser.dtype, photometric="minisblack", metadata=None)
    return _EmptyTiff(path, int(pixels.offset))


def _bands(scene: Pictured, picture: Picture, stream: int) -> Iterator[ImagePair]:
    """Bands of both images from top to bottom, each a row of squares."""
    for y0 in range(0, picture.height, _SQUARE):
        y1 = min(y0 + _SQUARE, picture.height)
        squares = []
        for x0 in range(0, picture.width, _SQUARE):
            window = Window((x0, y0), (min(x0 + _SQUARE, picture.width), y1))
            squares.append(_render_square(scene, picture, window, stream))
        reference = np.concatenate([square.reference for square in squares], axis=1)
        deformed = np.concatenate([square.deformed for square in squares], axis=1)
        yield ImagePair(reference, deformed)


def _render_square(scene: Pictured, picture: Picture, window: Window, stream: int) -> ImagePair:
    """Both images in a window."""
    x, y = np.meshgrid(np.arange(window.x0, window.x1), np.arange(window.y0, window.y1))
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    reference = scene.reference_grey(points).reshape(x.shape)
    deformed = scene.deformed_grey(points).reshape(x.shape)
    store = picture.digitiser.store
    return ImagePair(store(reference, (stream, window.x0, window.y0)),
                     store(deformed, (stream + 1, window.x0, window.y0)))
