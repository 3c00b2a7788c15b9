"""Grey levels and spline coefficients of boxes of a volume: one to four bytes a voxel each, and no gradient."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.images.source import FILLED, ImageSource, fill_excluded, without_cross, without_neighbours
from ddic.images.spline import PADDING, FindUsable, GradientImage, SplineImage
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.voxel_prefilter import LARGEST_GAIN, TAPS, filter_box
from ddic.images.window import Window
from ddic.vectors import WIDTH

DEGREE = 3
"""Of the spline."""

DIFFERENCES = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Weights of f(x + k) - f(x - k), k = 1, 2, ...: the derivative of a polynomial of degree 8 exactly."""

REACH = len(DIFFERENCES)
"""Voxels on either side of one that its gradient is taken from."""

PLANES = 64
"""Planes of coefficients that are computed together; larger slabs take memory, smaller ones filter more planes about
them."""

KEPT_TYPES = (np.dtype(np.uint8), np.dtype(np.uint16))
"""Of grey levels that kernels take as they are in the file."""

MIDDLE = 127.5
"""Grey level of bytes whose coefficient is 0."""

STEP = MIDDLE * LARGEST_GAIN / np.iinfo(np.int16).max
"""Grey levels between the coefficients of bytes that int16 can tell apart: a tenth of those between bytes."""


def measure_rounding(source: ImageSource) -> float:
    """Measure what rounding its coefficients leaves of a volume less itself: the residual's deviation, grey levels."""
    # Of evenly spread errors STEP / sqrt(12), by the spline's weights 0.35 times that, and a fifth more.
    return STEP / 8 if len(source.extent.sizes) == 3 and source.saturation == np.iinfo(np.uint8).max else 0.0


def read_values(source: ImageSource, window: Window, find_usable: FindUsable | None = None, *,
                excludes_taps: bool = True) -> GradientImage:
    """Read a box inside the volume with the voxels about it that its gradient is taken from.

    Beyond the volume's faces they continue by reflection. ``find_usable`` is as for ``read_spline``. With
    ``excludes_taps`` voxels beside an excluded one are left out, otherwise only the excluded ones.
    """
    whole = window.grow(REACH)
    pixels, usable = _read_box(source, whole, find_usable)
    # Kernels load whole vectors beyond the box: the voxels about it are room for them.
    values = np.array(pixels, pixels.dtype if pixels.dtype in KEPT_TYPES else np.float32, order="C")
    if usable is not None:
        usable = without_cross(usable, DEGREE // 2 if excludes_taps else 0)[whole.locate(window)].copy()
    return GradientImage(window, values, values[None], usable, REACH)


def read_coefficients(source: ImageSource, window: Window, find_usable: FindUsable | None = None,
                      threads: Threads = ONE_THREAD, *, excludes_taps: bool = True) -> SplineImage:
    """Read a box inside the volume and prefilter it: coefficients depend on the voxels about them, not on the box.

    ``find_usable`` is as for ``read_spline``. With ``excludes_taps`` all that is interpolated from an excluded voxel is
    left out, otherwise only what lies beside it.
    """
    whole = window.grow(PADDING[DEGREE])
    pixels, usable = _read_box(source, whole.grow(TAPS), find_usable)
    is_bytes = pixels.dtype == np.uint8
    scale, offset = (STEP, MIDDLE) if is_bytes else (1.0, 0.0)
    # With room after its end, where kernels load whole vectors.
    room = np.empty(whole.n_pixels + 2 * WIDTH, dtype=np.int16 if is_bytes else np.float32)
    room[whole.n_pixels:] = 0
    out = room[:whole.n_pixels].reshape(whole.shape)
    numbers = pixels if pixels.dtype in KEPT_TYPES else pixels.astype(np.float32, copy=False)

    def fill(slabs: Iterator[Window]) -> None:
        for slab in slabs:
            begin, end = slab.lower[-1] - whole.lower[-1], slab.upper[-1] - whole.lower[-1]
            filter_box(np.ascontiguousarray(numbers[begin:end + 2 * TAPS]), np.float32(1.0 / scale),
                       np.float32(offset), out[begin:end])

    threads.share(whole.split_rows(PLANES), fill)
    if usable is not None:
        reach = DEGREE // 2 if excludes_taps else 0
        inside = whole.grow(TAPS).locate(window)
        usable = without_neighbours(usable, reach, reach + 1)[inside].copy()
    return SplineImage(window, DEGREE, out, usable, scale, offset)


def find_slopes(image: GradientImage) -> Array:
    """Give the gradient of a window, (dim, ...), grey levels per pixel, of a volume by differences."""
    if image.margin == 0:
        return image.slopes.astype(np.float64)
    inside = image.window.grow(image.margin).locate(image.window)
    weights = np.concatenate([np.negative(DIFFERENCES[::-1]), [0.0], DIFFERENCES])
    # Arrays have x last.
    by_axis = (scipy.ndimage.correlate1d(image.slopes[0], weights, axis, np.float64) for axis in (2, 1, 0))
    return np.stack([slopes[inside] for slopes in by_axis])


def _read_box(source: ImageSource, box: Window,
              find_usable: FindUsable | None) -> tuple[NDArray[Any], NDArray[np.uint8] | None]:
    """A box that may leave the volume, by reflection there, excluded voxels filled; and which ones are usable."""
    inside = box.intersection(source.extent)
    # What excluded voxels are filled from may lie outside the box.
    around = inside if find_usable is None else box.grow(FILLED).intersection(source.extent)
    usable, part = None if find_usable is None else find_usable(around), around.locate(inside)
    pixels = fill_excluded(source.read(around), usable)[part]
    usable = None if usable is None else usable[part]
    beyond = [(first - low, high - last) for low, first, last, high
              in zip(box.lower, inside.lower, inside.upper, box.upper, strict=True)][::-1]
    if not np.any(beyond):
        return pixels, usable
    return np.pad(pixels, beyond, mode="reflect"), None if usable is None else np.pad(usable, beyond, mode="reflect")
