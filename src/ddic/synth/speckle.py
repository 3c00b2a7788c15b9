"""The speckle texture: a sum of Gaussians at random over the whole plane or space, known at any point.

Also one of two scales, in the plane.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ddic.arrays import Array, IntArray
from ddic.errors import InputError
from ddic.synth import speckle_kernels as kernels


def _average_power(low: float, high: float, power: int) -> float:
    """Mean of a power of a number that is uniform between two."""
    return sum(low ** (power - k) * high**k for k in range(power + 1)) / (power + 1)


def compute_moments(n_axes: int) -> tuple[float, float]:
    """Compute mean and standard deviation of the sum of speckles, by Campbell's theorem for a Poisson process."""
    size = _average_power(kernels.SIGMA_MIN, kernels.SIGMA_MAX, n_axes)
    mean, square = (_average_power(kernels.AMPLITUDE_MIN, kernels.AMPLITUDE_MAX, power) for power in (1, 2))
    density = kernels.DENSITY[n_axes]
    return density * mean * (2 * math.pi) ** (n_axes / 2) * size, math.sqrt(
        density * square * math.pi ** (n_axes / 2) * size)


TEXTURE_DEVIATION = 0.6
"""Standard deviation of s; more drives grey levels towards the ends of the scale."""

FARTHEST = 1e9
"""Texture units from the origin beyond which no speckle is drawn: far out numbers of cells would not be whole."""

# Area or volume whose speckles are drawn at once, and side of the tiles that a larger one is cut into, by d, texture
# units: more draw fewer speckles twice, and hold more of them.
_LARGEST_BLOCK = 2048.0**2
_TILE = {2: 512.0, 3: 64.0}


@dataclass(frozen=True)
class SpeckleTexture:
    """Speckles at random over the whole plane and space; a picture of any size is a window of the same texture.

    Raises InputError for a seed out of range or a factor that is not positive.

    Attributes
    ----------
    seed : int
        Fixes every speckle, 0 <= seed < 2^64.
    size_factor : float
        Magnification; 1 has 0.08 speckles per px^2, or 0.0219 per px^3, with standard deviations of 1.3 to 1.6 px.
    """

    seed: int = 0
    size_factor: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**64:
            raise InputError(f"texture: seed = {self.seed}: must be at least 0 and below 2^64")
        if not (self.size_factor > 0 and math.isfinite(self.size_factor)):
            raise InputError(f"texture: size_factor = {self.size_factor}: must be positive")

    def evaluate(self, *coordinates: ArrayLike) -> Array:
        """Evaluate the texture s, of mean 0 and standard deviation 0.6, at x, y and, in space, z of any shape, pixels.

        The speckles' tails that are cut sum to less than 1e-7, in space 3e-7. Raises InputError if a coordinate is not
        finite, or too far away.
        """
        given = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in coordinates))
        points = tuple(x.ravel() / self.size_factor for x in given)
        if not all(np.isfinite(x).all() for x in points):
            raise InputError("texture: coordinates must be finite")
        if max(np.abs(x).max(initial=0.0) for x in points) > FARTHEST:
            raise InputError(f"texture: a point lies more than {FARTHEST:g} px away, where no speckles are drawn; give "
                             "a smaller displacement")
        raw = np.empty(given[0].size)
        for chosen in _compact_groups(points):
            raw[chosen] = self._sum_of_speckles(tuple(x[chosen] for x in points))
        mean, deviation = compute_moments(len(points))
        scaled = (raw - mean) * (TEXTURE_DEVIATION / deviation)
        return scaled.reshape(given[0].shape)

    def grey(self, *coordinates: ArrayLike) -> Array:
        """Evaluate the grey level 0.5 - 0.45 tanh s, a fraction of full scale, at points of any shape, pixels."""
        return np.asarray(0.5 - 0.45 * np.tanh(self.evaluate(*coordinates)))

    def _sum_of_speckles(self, points: tuple[Array, ...]) -> Array:
        """Sum of Gaussians at points, (n,) by axis, in texture units, drawing the cells of their bounding box."""
        lower, sizes = zip(*map(_cells_in_reach, points), strict=True)
        cells = kernels.CellBlock(lower, sizes)
        seed = np.uint64(self.seed)
        starts = kernels.count_speckles(seed, cells)
        speckles = kernels.draw_speckles(seed, cells, starts)
        return np.asarray(kernels.sum_speckles(points, cells, starts, speckles))


def _cells_in_reach(coordinates: Array) -> tuple[int, int]:
    """First cell and number of cells, along one axis, whose speckles may reach the coordinates (n,)."""
    first = math.floor((coordinates.min() - kernels.REACH) / kernels.CELL_SIZE)
    last = math.floor((coordinates.max() + kernels.REACH) / kernels.CELL_SIZE)
    return first, last - first + 1


def _compact_groups(points: tuple[Array, ...]) -> Iterator[slice | IntArray]:
    """Split points, (n,) by axis, into groups whose bounding boxes are small enough to draw at once."""
    if len(points[0]) == 0:
        return
    if math.prod(np.ptp(x) + 1.0 for x in points) <= _LARGEST_BLOCK:
        yield slice(None)
        return
    tiles = np.floor(np.stack(points) / _TILE[len(points)]).astype(np.int64)
    order = np.lexsort(tiles)
    new_tile = (np.diff(tiles[:, order]) != 0).any(axis=0)
    yield from np.split(order, np.flatnonzero(new_tile) + 1)


@dataclass(frozen=True)
class TwoScaleTexture:
    """Coarse and fine speckles side by side in one paint.

    Averaged over spots of the fine speckles the grey level is that of ``coarse`` with 1 - fine_share of its contrast.
    Raises InputError for a share that is not between 0 and 1.

    Attributes
    ----------
    coarse, fine : SpeckleTexture
        Speckles, both in the specimen's frame.
    fine_share : float
        Of the fine speckles in the contrast, between 0 and 1.
    """

    coarse: SpeckleTexture
    fine: SpeckleTexture
    fine_share: float = 0.4

    def __post_init__(self) -> None:
        if not 0 <= self.fine_share <= 1:
            raise InputError(f"texture: fine_share = {self.fine_share}: must lie between 0 and 1")

    def grey(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Evaluate the grey level, a fraction of full scale, at points in pixels of the specimen's frame."""
        coarse = np.tanh(self.coarse.evaluate(x, y))
        fine = np.tanh(self.fine.evaluate(x, y))
        return np.asarray(0.5 - 0.45 * ((1 - self.fine_share) * coarse + self.fine_share * fine))


def two_scale_texture(ratio: float, seed: int = 0, speckle_size: float = 1.0,
                      fine_share: float = 0.4) -> TwoScaleTexture:
    """Paint coarse spots of about 5 far pixels and fine ones of about 5 near pixels, in the specimen's frame.

    ``ratio`` is near pixels per far pixel, ``speckle_size`` a magnification of both kinds of spots, ``fine_share`` the
    share of the fine spots in the contrast. Raises InputError for a value out of range.
    """
    # Far from the small seeds that make other specimens.
    fine_seed = (seed + 2**63) % 2**64
    coarse = SpeckleTexture(seed, speckle_size)
    fine = SpeckleTexture(fine_seed, speckle_size / ratio)
    return TwoScaleTexture(coarse, fine, fine_share)
