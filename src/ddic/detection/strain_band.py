"""The straight band in which the strain of a continuous field stands out: a Radon transform over cells [RHR08]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.plane import build_tree

Array = NDArray[np.float64]

NEIGHBOURHOOD = 3.6
"""Radius, elements, of the cells with whose plane of least squares a cell's strain is compared. A larger one takes
smooth fields for bands, in a smaller one the plane follows the band."""

FEWEST_CELLS = 6
"""Cells that a band must have. Fewer stand out by chance."""

OF_NORMAL = 1.4826
"""Standard deviation of normal numbers over the median of their absolute values."""

FLAT = 1e-6
"""Weight of a slope of 0, which decides where a few points leave it open."""

TINY = 1e-300
"""A spread below any that is not 0."""


@dataclass(frozen=True, eq=False)
class Band:
    """A straight band.

    Attributes
    ----------
    line : (2, 2) array
        Its middle from one side of all points to the other, pixels.
    score : float
        Sum of what stands out in it, in standard deviations of such sums where nothing does.
    """

    line: Array
    score: float


def compute_tresca_strain(strain: Array) -> Array:
    """Compute the equivalent strain |e1 - e2| / 2 of plane tensors.

    Parameters
    ----------
    strain : (n, 3) array
        exx, eyy, exy.

    Returns
    -------
    (n,) array
        Half of the difference of the principal strains.
    """
    exx, eyy, exy = strain.T
    return np.asarray(np.hypot((exx - eyy) / 2, exy))


def find_band(points: Array, strain: Array, size: float) -> Band:
    """Find the straight band in which an equivalent strain exceeds that of its surroundings most.

    Parameters
    ----------
    points : (n, 2) array
        Cells' centres, pixels.
    strain : (n,) array
        Equivalent strain of the cells.
    size : float
        Of the cells, pixels.

    Returns
    -------
    Band
        With the largest score.
    """
    excess = strain - _fit_planes(points, strain, NEIGHBOURHOOD * size)
    spread = OF_NORMAL * float(np.median(np.abs(excess - np.median(excess))))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    length = float(np.linalg.norm(np.ptp(points, axis=0))) + size
    n_bands = int(np.ceil(length / size)) + 1
    best = Band(np.stack([middle, middle]), 0.0)
    for angle in np.arange(0.0, np.pi, size / length / 2):
        along = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-along[1], along[0]])
        places = ((points - middle) @ normal + length / 2) / size
        # Bands lie half a cell apart: two sets of bands, a cell apart each.
        for shift in (0.0, 0.5):
            scores = _sum_bands(places + shift, excess, n_bands + 1) / max(spread, TINY)
            # A line through the mesh alone: bands at its edge reach half a cell beyond the last centres.
            at = np.arange(n_bands + 1) - shift
            scores[(at < places.min()) | (at > places.max())] = 0.0
            k = int(scores.argmax())
            if scores[k] > best.score:
                foot = middle + ((k - shift) * size - length / 2) * normal
                best = Band(np.stack([foot - length * along, foot + length * along]), float(scores[k]))
    return best


def _fit_planes(points: Array, values: Array, radius: float) -> Array:
    """Value at each point of the plane that fits the values about it: edges of a smooth field do not stand out."""
    pairs = build_tree(points).query_pairs(radius, output_type="ndarray")
    one, other = np.concatenate([pairs, pairs[:, ::-1], np.arange(len(points))[:, None].repeat(2, axis=1)]).T
    away = (points[other] - points[one]) / radius
    basis = np.column_stack([np.ones(len(away)), away])
    normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(normal, one, basis[:, :, None] * basis[:, None, :])
    np.add.at(right, one, basis * values[other][:, None])
    # Points in a row do not tell the slope across it.
    normal += FLAT * np.diag([0.0, 1.0, 1.0])
    return np.asarray(np.linalg.solve(normal, right[..., None])[:, 0, 0])


def _sum_bands(places: Array, excess: Array, n_bands: int) -> Array:
    """Sums over bands at 0, 1, ..., by the root of the sum of the weights' squares; 0 where a band has few cells.

    Weights fall linearly to 0 at a distance of 1: a jump is smeared over two cells.
    """
    low = np.floor(places).astype(np.int64)
    bands = np.concatenate([low, low + 1])
    weights = np.concatenate([low + 1 - places, places - low])
    total = np.bincount(bands, weights * np.tile(excess, 2), n_bands)
    norm = np.sqrt(np.bincount(bands, weights**2, n_bands))
    is_long = np.bincount(bands, weights, n_bands) >= FEWEST_CELLS
    return np.asarray(np.where(is_long, total / np.maximum(norm, TINY), 0.0))
