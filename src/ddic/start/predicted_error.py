"""What binned images say of the error of a displacement, before anything is solved."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from ddic.arrays import Array, BoolArray, IntArray
from ddic.images.sub_image import MaskedSource
from ddic.mesh.mesh import Mesh
from ddic.start.binned_pair import BinnedPair

IN_REACH = 0.5
"""Correlation coefficient of a square of blocks from which on its error can be predicted, and Gauss-Newton follows it.
A larger value calls more displacements far off."""

FEWEST_BLOCKS = {2: 64, 3: 250}
"""Blocks of a square, or a cube, below which it says nothing: a quarter of it."""

MOST_SQUARES = {2: 600, 3: 200}
"""Squares, or cubes, that are looked at, drawn from all: of a piece of the region of 2 % there are a dozen, or four.
More take longer."""

LEAST_TEXTURE = 0.05
"""Variance of a square's grey levels, times the median of all, below which it is blank and says nothing."""


@dataclass(frozen=True, eq=False)
class PredictedError:
    """What images say of the error of a displacement, square by square of some blocks.

    Attributes
    ----------
    correlation : (n,) array
        Correlation coefficient of the reference image and the deformed one, brought back by the displacement.
    error : (n,) array
        Displacement that is missing, pixels; inf where the coefficient is too low to tell it.
    n_blocks : (n,) array
        Blocks of each square: its weight.
    """

    correlation: Array
    error: Array
    n_blocks: Array

    @property
    def coefficient(self) -> float:
        """Mean correlation coefficient; 1 where no square says anything."""
        return float(np.average(self.correlation, weights=self.n_blocks)) if self.n_blocks.size else 1.0

    def measure_share_beyond(self, limit: float) -> float:
        """Measure the part of the region, between 0 and 1, whose error is larger than a limit, pixels.

        A limit of inf asks for the part whose error cannot be told; it is 0 where no square says anything.
        """
        if not self.n_blocks.size:
            return 0.0
        is_beyond = np.isinf(self.error) | (self.error > limit)
        return float(self.n_blocks[is_beyond].sum() / self.n_blocks.sum())


def predict_error(pair: BinnedPair, mesh: Mesh, displace: Callable[[Array], Array]) -> PredictedError:
    """Predict the error of a displacement: one step of optical flow in each square, or cube, of a cell's side.

    ``displace`` gives the displacement, (n, dim), of points, (n, dim), pixels. Each square's gain and offset of grey
    levels are its own; squares without texture are left out. Errors hold up to a part of a speckle, or of a block where
    that is larger.
    """
    active = pair.find_active(pair.scale(mesh))
    # Along y and x, as in arrays.
    blocks = np.array(np.nonzero(active))
    if not blocks.size:
        return PredictedError(np.zeros(0), np.zeros(0), np.zeros(0))
    squares = _number_squares(blocks, pair.cell)
    drawn = _draw_squares(squares, MOST_SQUARES[pair.dim])
    blocks, squares = blocks[:, drawn], squares[drawn]
    points = blocks[::-1].T * float(pair.factor) + pair.centre
    places = ((points + displace(points) - pair.centre) / pair.factor)[:, ::-1].T
    f = pair.reference.read_whole()[tuple(blocks)]
    seen = _find_seen(pair.deformed, places)
    return _judge(*_sum_squares(f, _sample(pair.deformed, places), squares, seen), pair.factor)


def _number_squares(blocks: IntArray, side: int) -> IntArray:
    """Square that each block, (dim, n), lies in, from 0."""
    squares = (blocks - blocks.min(axis=1, keepdims=True)) // side
    return np.asarray(np.ravel_multi_index(tuple(squares), tuple(squares.max(axis=1) + 1)))


def _draw_squares(squares: IntArray, most: int) -> BoolArray:
    """Blocks of the squares that are looked at: all, or some that are always the same."""
    numbers = np.unique(squares)
    if len(numbers) <= most:
        return np.ones(len(squares), dtype=bool)
    is_drawn = np.zeros(int(numbers[-1]) + 1, dtype=bool)
    is_drawn[np.random.default_rng(0).choice(numbers, most, replace=False)] = True
    return np.asarray(is_drawn[squares])


def _find_seen(deformed: MaskedSource, places: Array) -> BoolArray:
    """Places (row, column) in the deformed image, (dim, n), that are in it, and count."""
    last = np.array(deformed.extent.shape)[:, None] - 1
    inside = ((places >= 0) & (places <= last)).all(axis=0)
    usable = deformed.find_usable(deformed.extent)
    if usable is None:
        return np.asarray(inside)
    nearest = np.rint(np.where(inside, places, 0)).astype(np.int64)
    return np.asarray(inside & (usable[tuple(nearest)] > 0))


def _sample(deformed: MaskedSource, places: Array) -> Array:
    """Grey levels of the deformed image at places, and their slopes there along x, y, ..., a block: (1 + dim, n)."""
    values = deformed.read_whole()
    grey = scipy.ndimage.map_coordinates(values, places, order=3, mode="nearest")
    slopes = [scipy.ndimage.map_coordinates(by, places, order=1, mode="nearest") for by in np.gradient(values)[::-1]]
    return np.stack([grey, *slopes])


def _sum_squares(f: Array, g: Array, squares: IntArray, seen: BoolArray) -> tuple[Array, Array, Array]:
    """Of each square: its blocks, how many are seen, and covariances of f, g, dg/dx, dg/dy, ..., (n, 2 + dim, ...)."""
    n = int(squares.max()) + 1
    n_blocks, own = np.bincount(squares, minlength=n).astype(float), squares[seen]
    n_seen = np.bincount(own, minlength=n).astype(float)
    safe = np.maximum(n_seen, 1.0)
    signals = np.concatenate([f[None], g])[:, seen]
    # About each square's mean: its offset of grey levels is its own.
    signals = signals - np.stack([np.bincount(own, signal, n) / safe for signal in signals])[:, own]
    covariance = np.empty((n, len(signals), len(signals)))
    for i in range(len(signals)):
        for j in range(i + 1):
            covariance[:, i, j] = covariance[:, j, i] = np.bincount(own, signals[i] * signals[j], n) / safe
    return n_blocks, n_seen, covariance


def _judge(n_blocks: Array, n_seen: Array, covariance: Array, factor: int) -> PredictedError:
    variance_f, variance_g = covariance[:, 0, 0], covariance[:, 1, 1]
    fewest = FEWEST_BLOCKS[covariance.shape[1] - 2]
    held = n_blocks >= fewest
    # Squares that the displacement puts out of the image tell that it is wrong, or that the specimen has left.
    is_out = held & (n_seen < fewest / 2)
    told = held & ~is_out
    if told.any():
        told &= variance_f > LEAST_TEXTURE * np.median(variance_f[told])
    product = np.sqrt(variance_f * variance_g)
    likeness = np.where(product > 0, covariance[:, 0, 1] / np.where(product > 0, product, 1.0), 0.0)
    in_reach = told & (likeness >= IN_REACH)
    error = np.full(len(likeness), np.inf)
    if in_reach.any():
        of_reach = covariance[in_reach]
        # f in the grey levels of g.
        gain = np.sqrt(variance_g[in_reach] / variance_f[in_reach])
        right = gain[:, None] * of_reach[:, 0, 2:] - of_reach[:, 1, 2:]
        ridge = 1e-6 * np.trace(of_reach[:, 2:, 2:], axis1=1, axis2=2)
        normal = of_reach[:, 2:, 2:] + ridge[:, None, None] * np.eye(right.shape[1])
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        error[in_reach] = factor * np.linalg.norm(step, axis=1)
    counted = told | is_out
    return PredictedError(np.where(told, likeness, 0.0)[counted], error[counted], n_blocks[counted])
