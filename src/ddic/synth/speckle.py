"""The speckle texture: a sum of Gaussians at random over the whole plane, known at any point; also of two scales."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ddic.arrays import Array, IntArray
from ddic.errors import InputError
from ddic.synth import speckle_kernels as kernels

_MEAN_SIGMA_SQUARED = (
    kernels.SIGMA_MIN**2 + kernels.SIGMA_MIN * kernels.SIGMA_MAX + kernels.SIGMA_MAX**2) / 3
_MEAN_AMPLITUDE = (kernels.AMPLITUDE_MIN + kernels.AMPLITUDE_MAX) / 2
_MEAN_AMPLITUDE_SQUARED = (
    kernels.AMPLITUDE_MIN**2 + kernels.AMPLITUDE_MIN * kernels.AMPLITUDE_MAX + kernels.AMPLITUDE_MAX**2) / 3

# Campbell's theorem for a sum of independent Gaussians at the points of a Poisson process.
RAW_MEAN = kernels.DENSITY * _MEAN_AMPLITUDE * 2 * math.pi * _MEAN_SIGMA_SQUARED
RAW_DEVIATION = math.sqrt(kernels.DENSITY * _MEAN_AMPLITUDE_SQUARED * math.pi * _MEAN_SIGMA_SQUARED)
TEXTURE_DEVIATION = 0.6
"""Standard deviation of s; more drives grey levels towards the ends of the scale."""

FARTHEST = 1e9
"""Texture units from the origin beyond which no speckle is drawn: far out numbers of cells would not be whole."""

# Area whose speckles are drawn at once, and side of the tiles that a larger one is cut into, texture units: more
# draw fewer speckles twice, and hold more of them.
_LARGEST_BLOCK = 2048.0**2
_TILE = 512.0


@dataclass(frozen=True)
class SpeckleTexture:
    """Speckles at random over the whole plane; a picture of any size is a window of the same texture.

    Raises InputError for a seed out of range or a factor that is not positive.

    Attributes
    ----------
    seed : int
        Fixes every speckle, 0 <= seed < 2^64.
    size_factor : float
        Magnification; 1 has 0.08 speckles per px^2 with standard deviations of 1.3 to 1.6 px.
    """

    seed: int = 0
    size_factor: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**64:
            raise InputError(f"texture: seed = {self.seed}: must be at least 0 and below 2^64")
        if not (self.size_factor > 0 and math.isfinite(self.size_factor)):
            raise InputError(f"texture: size_factor = {self.size_factor}: must be positive")

    def evaluate(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Evaluate the texture s, of mean 0 and standard deviation 0.6, at points of any common shape, pixels.

        The speckles' tails that are cut sum to less than 1e-7. Raises InputError if a coordinate is not finite, or too
        far away.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        flat_x, flat_y = x.ravel() / self.size_factor, y.ravel() / self.size_factor
        if not (np.isfinite(flat_x).all() and np.isfinite(flat_y).all()):
            raise InputError("texture: coordinates must be finite")
        if max(np.abs(flat_x).max(initial=0.0), np.abs(flat_y).max(initial=0.0)) > FARTHEST:
            raise InputError(f"texture: a point lies more than {FARTHEST:g} px away, where no speckles are drawn; give "
                             "a smaller displacement")
        raw = np.empty(x.size)
        for chosen in _compact_groups(flat_x, flat_y):
            raw[chosen] = self._sum_of_speckles(flat_x[chosen], flat_y[chosen])
        scaled = (raw - RAW_MEAN) * (TEXTURE_DEVIATION / RAW_DEVIATION)
        return scaled.reshape(x.shape)

    def grey(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Evaluate the grey level 0.5 - 0.45 tanh s, a fraction of full scale, at points of any shape, pixels."""
        return np.asarray(0.5 - 0.45 * np.tanh(self.evaluate(x, y)))

    def _sum_of_speckles(self, x: Array, y: Array) -> Array:
        """Sum of Gaussians at points x, y (n,) in texture units, drawing the cells of their bounding box."""
        column0, n_columns = _cells_in_reach(x)
        row0, n_rows = _cells_in_reach(y)
        cells = kernels.CellBlock(row0, column0, n_rows, n_columns)
        seed = np.uint64(self.seed)
        starts = kernels.count_speckles(seed, cells)
        speckles = kernels.draw_speckles(seed, cells, starts)
        return np.asarray(kernels.sum_speckles(x, y, cells, starts, speckles))


def _cells_in_reach(coordinates: Array) -> tuple[int, int]:
    """First cell and number of cells, along one axis, whose speckles may reach the coordinates (n,)."""
    first = math.floor((coordinates.min() - kernels.REACH) / kernels.CELL_SIZE)
    last = math.floor((coordinates.max() + kernels.REACH) / kernels.CELL_SIZE)
    return first, last - first + 1


def _compact_groups(x: Array, y: Array) -> Iterator[slice | IntArray]:
    """Split points x, y (n,) into groups whose bounding boxes are small enough to draw at once."""
    if len(x) == 0:
        return
    if (np.ptp(x) + 1.0) * (np.ptp(y) + 1.0) <= _LARGEST_BLOCK:
        yield slice(None)
        return
    columns = np.floor(x / _TILE).astype(np.int64)
    rows = np.floor(y / _TILE).astype(np.int64)
    order = np.lexsort((columns, rows))
    new_tile = (np.diff(columns[order]) != 0) | (np.diff(rows[order]) != 0)
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
