"""Rendering a pair of images whose displacement is known exactly: motion inverted, noise added, grey levels rounded."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import reduce
from itertools import product
from operator import add, mul
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.errors import ConvergenceError, InputError
from ddic.images.window import Window
from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.synth.fields import DisplacementField, Hole, Vector
from ddic.synth.speckle import SpeckleTexture, TwoScaleTexture

# Distance of u(y - v) from v at which the iteration stops, px; a larger one blurs the truth of a pair.
_TOLERANCE = 1e-12
# The same relative to the largest displacement, which rounding keeps from being met better.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)
_MAX_ITERATIONS = 50
# The gradient is kept from one iteration to the next as long as each gains two digits.
_FAST = 0.01


def find_reference_points(field: DisplacementField, points: Array) -> Array:
    """Solve x + u(x) = y for x (n, d) at deformed points y (n, d), pixels.

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
        for i, row in enumerate(inverse):
            v[:, i] += reduce(add, map(mul, row, residual.T))
        previous = largest
    worst = int(np.argmax(np.abs(residual).max(axis=1)))
    raise ConvergenceError(
        f"the motion x + u(x) could not be inverted at {_describe_point(points[worst])} px: "
        f"{np.abs(residual[worst]).max():.1e} px left after {_MAX_ITERATIONS} iterations; "
        "use a smoother displacement field")


def _inverse_of_motion(gradient: Array, x: Array) -> list[list[Array]]:
    """Rows of (I + grad u)^-1 at x (n, d), of d entries (n,) each."""
    n_axes = x.shape[1]
    motion = [[gradient[:, i, j] + (i == j) for j in range(n_axes)] for i in range(n_axes)]
    if n_axes == 2:
        (a, b), (c, d) = motion
        adjugate = [[d, -b], [-c, a]]
    else:
        adjugate = [[motion[i - 2][j - 2] * motion[i - 1][j - 1] - motion[i - 2][j - 1] * motion[i - 1][j - 2]
                     for i in range(3)] for j in range(3)]
    determinant = reduce(add, map(mul, motion[0], (row[0] for row in adjugate)))
    if not (determinant > 0).all():
        raise InputError(f"displacement field: folds the image near {_describe_point(x[np.argmin(determinant)])} px, "
                         "det(I + grad u) <= 0; use a smaller amplitude or a larger wavelength")
    return [[entry / determinant for entry in row] for row in adjugate]


def _describe_point(point: Array) -> str:
    return f"({', '.join(f'{x:g}' for x in point)})"


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
    depth : int, optional
        Of a volume, pixels, at least 1.
    """

    width: int
    height: int
    digitiser: Digitiser = field(default_factory=Digitiser)
    depth: int | None = None

    def __post_init__(self) -> None:
        sizes = self.extent.sizes
        if min(sizes) < 1:
            least = "x".join("1" * len(sizes))
            raise InputError(f"image: size = {'x'.join(map(str, sizes))}: must be at least {least} pixels")

    @property
    def extent(self) -> Window:
        """All its pixels."""
        return Window.of_size(self.width, self.height, *(() if self.depth is None else (self.depth,)))

    @property
    def middle(self) -> Vector:
        """Position of the picture's centre, pixels."""
        return tuple((size - 1) / 2 for size in self.extent.sizes)


# Images are made square by square, and volumes cube by cube: temporary arrays stay in cache and memory does not grow
# with the image. The noise is drawn so too: these sides, by d, are part of what a seed means.
_SIDES = {2: 256, 3: 32}


@dataclass(frozen=True)
class ImagePair:
    """Reference and deformed image.

    Attributes
    ----------
    reference, deformed : (height, width) or (depth, height, width) array
        Stored grey levels: uint8, uint16 or float32.
    """

    reference: Stored
    deformed: Stored


class Pictured(Protocol):
    """What a camera sees before and after the motion, at any point of its picture."""

    def reference_grey(self, points: Array) -> Array:
        """Evaluate the grey level f before the motion, (n,) fractions of full scale, at points (n, d), pixels."""

    def deformed_grey(self, points: Array) -> Array:
        """Evaluate the grey level g after the motion, (n,) fractions of full scale, at points (n, d), pixels."""


@dataclass(frozen=True)
class Scene:
    """What the camera looks at.

    Attributes
    ----------
    texture : SpeckleTexture or TwoScaleTexture
        Paint of the plane, or grain of the volume.
    field : DisplacementField
        Its motion.
    hole : Hole, optional
        Cut out of the paint.
    """

    texture: SpeckleTexture | TwoScaleTexture
    field: DisplacementField
    hole: Hole | None = None

    def reference_grey(self, points: Array) -> Array:
        """Evaluate the grey level f before the motion, (n,) fractions of full scale, at points (n, d), pixels."""
        grey = self.texture.grey(*points.T)
        return grey if self.hole is None else self.hole.cut(grey, *points.T)

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

    A volume is a page for each z, one after the other without a gap, so that the file can be mapped into memory.

    The noise is independent in the two: ``stream`` is that of the reference image, the next one that of the deformed
    image. They take their names with ``files``; by default the two do so by themselves. Raises InputError for a field
    that folds the plane or a folder that cannot be written to, no half-written file staying; OSError where the disk
    does not take them; ConvergenceError where the motion cannot be inverted to 1e-12 px.
    """
    with begin_files(files) as new:
        reference, deformed = (_create_tiff(new.begin(path), picture) for path in paths)
        row = 0
        for band in _bands(scene, picture, stream):
            reference.fill(row, band.reference)
            deformed.fill(row, band.deformed)
            row += len(band.reference)


@dataclass(frozen=True)
class _EmptyTiff:
    """A TIFF file whose header and size are final; its rows, or pages, lie one after the other from ``offset``."""

    path: Path
    offset: int

    def fill(self, row: int, band: Stored) -> None:
        """Write whole rows, or pages, the first of which is ``row``."""
        with self.path.open("r+b") as file:
            file.seek(self.offset + row * band[0].nbytes)
            file.write(band.tobytes())


def _create_tiff(path: Path, picture: Picture) -> _EmptyTiff:
    """Make a file of the picture's size and type."""
    import tifffile

    pixels = tifffile.memmap(path, shape=picture.extent.shape, dtype=picture.digitiser.dtype,
                             photometric="minisblack", metadata=None)
    return _EmptyTiff(path, int(pixels.offset))


def _bands(scene: Pictured, picture: Picture, stream: int) -> Iterator[ImagePair]:
    """Bands of both images from top to bottom, each a row of squares; slabs of volumes, each a layer of cubes."""
    n_axes = len(picture.extent.sizes)
    side = _SIDES[n_axes]
    for band in picture.extent.split_rows(side):
        pair = ImagePair(*(np.empty(band.shape, dtype=picture.digitiser.dtype) for _ in range(2)))
        for lower in product(*(range(first, end, side) for first, end in zip(band.lower, band.upper, strict=True))):
            square = Window(lower, tuple(first + side for first in lower)).intersection(band)
            part = _render_square(scene, picture, square, stream)
            pair.reference[band.locate(square)] = part.reference
            pair.deformed[band.locate(square)] = part.deformed
        yield pair


def _render_square(scene: Pictured, picture: Picture, window: Window, stream: int) -> ImagePair:
    """Both images in a window."""
    offsets = np.indices(window.shape, dtype=np.float64).reshape(len(window.shape), -1)
    points = offsets[::-1].T + np.array(window.lower)
    greys = scene.reference_grey(points), scene.deformed_grey(points)
    return ImagePair(*(picture.digitiser.store(grey.reshape(window.shape), (stream + k, *window.lower))
                       for k, grey in enumerate(greys)))
