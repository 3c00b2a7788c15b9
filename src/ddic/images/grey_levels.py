"""What the grey levels of a whole image are like, read a band of rows at a time; how large a pattern's features are."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.images.window import Window

CAMERA_BITS = (8, 10, 12, 14)
"""Bits that cameras use of a wider type."""

BAND_PIXELS = {2: 1 << 20, 3: 1 << 23}
"""Pixels of a band, by the number of dimensions: more make fewer reads, and take more memory. Of volumes chunks of many
planes are decoded anew for each."""

MOST_LOOKED_AT = 1 << 28
"""Pixels, evenly spread, that are searched for a second grey level: those of any camera, a second of reading. A larger
value takes longer for a blank image of more."""

NOISES = (1e-7, 1.0)
"""Least and largest standard deviation of noise over the span of grey levels: of two cameras whose noises differ by
more, one counts for nothing beside rounding. Pictures of 10 bits in files of 16 have noise of 5e-6. Wider limits refuse
less."""

LEAST_RANGE, LARGEST_LEVEL = 1e-12, 1e15
"""Range of a float image's levels below which, and level beyond which, it is refused: sums of fourth powers of them
have to be numbers. Wider limits refuse less."""


@dataclass(frozen=True)
class GreyLevels:
    """Grey levels of an image; pixels that are not finite are counted and left out of the rest.

    Attributes
    ----------
    lowest, highest, mean : float
        Grey levels; infinite and nan where no pixel is finite.
    saturation : float or None
        Grey level at which the image saturates, as ``find_saturation`` finds it.
    n_saturated, n_not_finite : int
        Pixels at that level, and pixels that are nan or infinite.
    gradient_energy : float
        Mean of |grad f|^2 over the inner pixels, (grey level / px)^2.
    """

    lowest: float
    highest: float
    mean: float
    saturation: float | None
    n_saturated: int
    n_not_finite: int
    gradient_energy: float


def measure_grey_levels(source: ImageSource) -> GreyLevels:
    """Measure the grey levels of an image; gradients are central differences."""
    lowest, highest, total = np.inf, -np.inf, 0.0
    n_finite = 0
    levels = _HighestLevel()
    energy, n_energy = 0.0, 0
    for rows in _bands(source):
        # A row more on either side, for the differences.
        wide = source.extent.take_rows(rows.lower[-1] - 1, rows.upper[-1] + 1).intersection(source.extent)
        band = source.read(wide)
        own = band[wide.locate(rows)]
        finite = own[np.isfinite(own)]
        if finite.size:
            lowest = min(lowest, float(finite.min()))
            highest = max(highest, float(finite.max()))
            total += float(finite.sum(dtype=np.float64))
        n_finite += finite.size
        if source.saturation is not None:
            levels.see(own)
        squares = _squared_gradient(band.astype(np.float64))
        energy += float(squares.sum())
        n_energy += squares.size
    saturation = levels.find_saturation(source.saturation)
    return GreyLevels(
        lowest=lowest,
        highest=highest,
        mean=total / n_finite if n_finite else np.nan,
        saturation=saturation,
        n_saturated=levels.n_highest if levels.highest == saturation else 0,
        n_not_finite=source.extent.n_pixels - n_finite,
        gradient_energy=energy / n_energy if n_energy else 0.0,
    )


def find_saturation(source: ImageSource) -> float | None:
    """Find the grey level at which an image saturates: cameras of 12 bits in a file of 16 stop at 4095.

    Where the highest grey level is the largest of 8, 10, 12 or 14 bits, in the lower or the upper bits of the type, it
    is that one; else the largest of the type. None for a float image; others are read whole.
    """
    if source.saturation is None:
        return None
    levels = _HighestLevel()
    for rows in _bands(source):
        levels.see(source.read(rows))
    return levels.find_saturation(source.saturation)


def check_finite(source: ImageSource, mask: ImageSource | None = None) -> None:
    """Check that a float image holds no nan or infinity but where its mask leaves it out.

    The mask is not 0 where pixels are used; without one, all are. Raises InputError where there are such pixels, with
    their number and the first one.
    """
    if source.saturation is not None:
        return
    count = 0
    first: tuple[int, ...] | None = None
    for rows in _bands(source):
        bad = ~np.isfinite(source.read(rows))
        if mask is not None:
            bad &= mask.read(rows) != 0
        if first is None and bad.any():
            in_band = np.unravel_index(int(bad.argmax()), bad.shape)
            first = tuple(int(place) + low for place, low in zip(in_band[::-1], rows.lower, strict=True))
        count += int(np.count_nonzero(bad))
    if first is not None:
        raise InputError(f"{source.path}: {count} pixel(s) are NaN or infinite, the first at "
                         f"({', '.join('xyz'[:len(first)])}) = {first}; leave them out with a mask image (0 there)")


def count_used(mask: ImageSource) -> int:
    """Count the pixels of a mask's image that are not 0."""
    return sum(int(np.count_nonzero(mask.read(rows))) for rows in _bands(mask))


def read_all(source: ImageSource) -> None:
    """Read an image a band at a time and keep nothing, for the errors that it brings."""
    for rows in _bands(source):
        source.read(rows)


def check_varied(source: ImageSource) -> None:
    """Check that an image shows more than one grey level, and a float image levels that can be computed with.

    Raises InputError where it does not, with the level, or how large or small levels are. Pixels that are not finite do
    not count.
    """
    lowest, highest = _find_range(source)
    if source.saturation is not None and (highest > lowest or source.extent.n_pixels > MOST_LOOKED_AT):
        # Of a larger image the pixels that were not looked at may differ; those of the mesh are looked at later.
        return
    if not highest > lowest:
        level = f"one grey level, {highest:g}, everywhere" if np.isfinite(highest) else "no finite grey level"
        raise InputError(f"{source.path}: the image shows {level}: there is nothing to measure by; give another image")
    if highest - lowest < LEAST_RANGE or max(-lowest, highest) > LARGEST_LEVEL:
        raise InputError(f"{source.path}: grey levels from {lowest:g} to {highest:g}: rounding hides them; scale the "
                         "image, to 0 to 255 for instance")


def _find_range(source: ImageSource) -> tuple[float, float]:
    """Lowest and highest finite level; of an integer image two of its levels, where it has two."""
    lowest, highest = np.inf, -np.inf
    for rows in _bands(source) if source.saturation is None else list_spread_bands(source.extent):
        band = source.read(rows)
        values = band if source.saturation is not None else band[np.isfinite(band)]
        if values.size:
            lowest, highest = min(lowest, float(values.min())), max(highest, float(values.max()))
        # The rest of an integer image cannot change what is said.
        if source.saturation is not None and highest > lowest:
            break
    return lowest, highest


def check_noise(source: ImageSource, noise: float) -> None:
    """Check that a noise can be that of an image: its standard deviation, grey levels.

    Raises InputError where it is none of NOISES times what the image's levels may span, or do where they are floats.
    """
    span = float(np.ptp(_find_range(source))) if source.saturation is None else source.saturation
    # Of wider integers hardly any picture uses all.
    least, largest = NOISES[0] * min(span, 65535.0), NOISES[1] * span
    if not least <= noise <= largest:
        raise InputError(f"{source.path}: noise = {noise:g}: grey levels of this image span {span:g}; give the "
                         f"standard deviation of its noise, from {least:.2g} to {largest:.2g}, or leave it out")


@dataclass
class _HighestLevel:
    """The highest grey level of the bands seen so far, how often it occurs, and the bits that occur in any level."""

    highest: float = -np.inf
    n_highest: int = 0
    bits: int = 0

    def see(self, band: NDArray[Any]) -> None:
        """Take a band of an integer image into account, or of a colour one that was turned to grey."""
        highest = float(band.max())
        if highest > self.highest:
            self.highest, self.n_highest = highest, 0
        if highest == self.highest:
            self.n_highest += int(np.count_nonzero(band == highest))
        if np.issubdtype(band.dtype, np.integer):
            self.bits |= int(np.bitwise_or.reduce(band, axis=None))

    def find_saturation(self, largest: float | None) -> float | None:
        """Give the level of saturation; largest: of the type, None for floats."""
        if largest is None or self.highest == largest:
            return largest
        n_type = int(largest).bit_length()
        for n_bits in CAMERA_BITS:
            level = 2**n_bits - 1
            if self.highest == level:
                return float(level)
            n_unused = n_type - n_bits
            in_upper_bits = n_unused > 0 and self.bits > 0 and self.bits % 2**n_unused == 0
            if in_upper_bits and self.highest == level << n_unused:
                return float(level << n_unused)
        return largest


def list_spread_bands(window: Window) -> Iterator[Window]:
    """List bands of whole rows of a window, top to bottom: all, or evenly spread ones of MOST_LOOKED_AT pixels."""
    n_rows = _choose_height(window)
    step = n_rows * max(1, -(-window.n_pixels // MOST_LOOKED_AT))
    return window.split_rows(n_rows, step)


def _bands(source: ImageSource) -> Iterator[Window]:
    """Windows of whole rows from top to bottom, of about BAND_PIXELS each."""
    return source.extent.split_rows(_choose_height(source.extent))


def _choose_height(window: Window) -> int:
    """Rows, or planes, of a band of about BAND_PIXELS."""
    return max(1, BAND_PIXELS[len(window.sizes)] // math.prod(window.sizes[:-1]))


def _squared_gradient(band: Array) -> Array:
    """|grad f|^2 of a band's inner pixels, of those where it is finite."""
    inner, ahead, behind = slice(1, -1), slice(2, None), slice(None, -2)
    squares = np.zeros(tuple(max(n - 2, 0) for n in band.shape))
    for axis in reversed(range(band.ndim)):
        forth, back = (band[(inner,) * axis + (beside,) + (inner,) * (band.ndim - axis - 1)]
                       for beside in (ahead, behind))
        squares += (0.5 * (forth - back))**2
    return np.asarray(squares[np.isfinite(squares)])


SIDES = {2: 128, 3: 48}
"""Pixels along each side of a window that is looked at, by the number of dimensions; features above a quarter of it are
not told."""

HALF = 0.5
"""Correlation at the edge of a feature: the guides' width at half of the maximum."""


def measure_feature_size(source: ImageSource, places: Array) -> float:
    """Measure the size of a pattern's features: the width of the autocorrelation at half of its maximum, pixels.

    It is the median over all axes of windows of SIDES about the places, (n, dim), pixels: some on the specimen, for
    edges and holes in a few of them change little. It is nan where no window has features that end in it.
    """
    widths = [width for place in places for width in _measure_window(source, place)]
    known = [width for width in widths if math.isfinite(width)]
    return float(np.median(known)) if known else math.nan


def _measure_window(source: ImageSource, place: Array) -> list[float]:
    """Widths along each axis about a place."""
    grey = np.nan_to_num(np.asarray(source.read(_place_window(source, place)), np.float64))
    grey = grey - grey.mean()
    for fade in np.meshgrid(*map(np.hanning, grey.shape), indexing="ij", sparse=True):
        grey = grey * fade
    correlation = np.fft.irfftn(np.abs(np.fft.rfftn(grey))**2, s=grey.shape)
    # From no shift on, along each axis.
    lines = [np.moveaxis(correlation, axis, -1)[(0,) * (grey.ndim - 1)] for axis in reversed(range(grey.ndim))]
    return [2.0 * _find_half(line / line[0]) for line in lines if line[0] > 0]


def _place_window(source: ImageSource, place: Array) -> Window:
    """A window about a place, moved into the image."""
    sides = np.array(source.extent.sizes)
    size = np.minimum(sides, SIDES[len(sides)])
    begin = np.clip(np.rint(place - 0.5 * size), 0, sides - size)
    return Window.between(begin, begin + size)


def _find_half(line: Array) -> float:
    """Where a correlation falls below a half first, between pixels; nan where it does not in a quarter of it."""
    below = np.flatnonzero(line[:len(line) // 4 + 1] < HALF)
    if not below.size:
        return math.nan
    k = int(below[0])
    return float(k - 1 + (line[k - 1] - HALF) / (line[k - 1] - line[k]))
