"""Straight bands in which an equivalent strain stands out, by its Radon transform [RHR08, sections 5.1 and 5.2].

Of cells, not of pixels: what elements smear of a jump is as wide as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.mesh.plane import build_tree

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

FINE = 8
"""Bins a cell in which cells are counted across a band; a larger value takes time."""

BANDS = 2
"""Bands a cell: each overlaps its neighbours by half."""

MOST_ANGLES, MOST_DISTANCES = 720, 1024
"""Of the transform that is kept and drawn; a larger one has the largest score of its neighbours in each place."""


@dataclass(frozen=True, eq=False)
class StrainBand:
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


@dataclass(frozen=True, eq=False)
class RadonTransform:
    """Scores of bands of all directions and places.

    Attributes
    ----------
    angles : (n_angles,) array
        Of the bands, from +x to +y, radians.
    distances : (n_distances,) array
        Of their middles from that of all points, positive to the side to which +x turns into +y, pixels.
    scores : (n_angles, n_distances) array
        0 where a band has too few cells, or lies outside.
    """

    angles: Array
    distances: Array
    scores: Array

    def keep_peaks(self) -> RadonTransform:
        """Keep the largest scores of as many angles and distances as a picture shows."""
        by_angle, by_distance = (-(-len(values) // most) for values, most in
                                 ((self.angles, MOST_ANGLES), (self.distances, MOST_DISTANCES)))
        rows, columns = (np.arange(0, len(values), step) for values, step in
                         ((self.angles, by_angle), (self.distances, by_distance)))
        largest = np.maximum.reduceat(np.maximum.reduceat(self.scores, rows, axis=0), columns, axis=1)
        return RadonTransform(self.angles[rows], self.distances[columns], largest)


def compute_tresca_strain(strain: Array) -> Array:
    """Compute |e1 - e2| / 2, half the difference of the principal strains, (n,), of tensors exx, eyy, exy, (n, 3)."""
    exx, eyy, exy = strain.T
    return np.asarray(np.hypot((exx - eyy) / 2, exy))


@dataclass(frozen=True, eq=False)
class StandingOut:
    """By how much an equivalent strain exceeds that of its surroundings.

    Attributes
    ----------
    points : (n, 2) array
        Centres of cells, pixels.
    excess : (n,) array
        What is beyond the plane that fits the cells about each, in standard deviations.
    size : float
        Of a cell, pixels.
    """

    points: Array
    excess: Array
    size: float

    @classmethod
    def compare(cls, points: Array, strain: Array, size: float) -> StandingOut:
        """Compare the strain of cells, (n,), with that of the cells about each."""
        excess = strain - _fit_planes(points, strain, NEIGHBOURHOOD * size)
        spread = OF_NORMAL * float(np.median(np.abs(excess - np.median(excess))))
        return cls(points, excess / max(spread, TINY), size)

    def compute_transform(self, is_seen: BoolArray) -> RadonTransform:
        """Sum what stands out over all bands, of the cells that are seen, (n,), alone."""
        points, excess, size = self.points[is_seen], self.excess[is_seen], self.size
        middle, length = self._find_extent()
        n_bands = BANDS * (int(np.ceil(length / size)) + 1) + 1
        distances = size * np.arange(n_bands) / BANDS - length / 2
        angles = np.arange(0.0, np.pi, size / length / 2)
        scores = np.zeros((len(angles), n_bands))
        for k, angle in enumerate(angles if len(points) else ()):
            places = (points - middle) @ np.array([-np.sin(angle), np.cos(angle)])
            scores[k] = _sum_bands((places + length / 2) / size, excess, n_bands)
            # A line through the mesh alone: bands at its edge reach half a cell beyond the last centres.
            scores[k, (distances < places.min()) | (distances > places.max())] = 0.0
        return RadonTransform(angles, distances, scores)

    def find_band(self, transform: RadonTransform) -> StrainBand:
        """Find the band that stands out most."""
        middle, length = self._find_extent()
        k, j = np.unravel_index(int(transform.scores.argmax()), transform.scores.shape)
        angle = transform.angles[k]
        along, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        foot = middle + transform.distances[j] * normal
        return StrainBand(np.stack([foot - length * along, foot + length * along]), float(transform.scores[k, j]))

    def _find_extent(self) -> tuple[Array, float]:
        """The middle of all points, and a length that none of the lines through them exceeds."""
        middle = (self.points.min(axis=0) + self.points.max(axis=0)) / 2
        return middle, float(np.linalg.norm(np.ptp(self.points, axis=0))) + self.size


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


_OFFSETS = np.arange(1 - FINE, FINE) / FINE
_WEIGHTS = 1.0 - np.abs(_OFFSETS)
"""Of the fine bins of a band: they fall linearly to 0 a cell from its middle, as a jump is smeared over two cells."""


def _sum_bands(places: Array, excess: Array, n_bands: int) -> Array:
    """Sums over bands at 0, 1 / BANDS, ... cells, by the root of the sum of squared weights; 0 where cells are few."""
    fine = np.rint(FINE * places).astype(np.int64)
    n_fine = FINE // BANDS * (n_bands - 1) + 1
    sums, counts = (np.bincount(fine, values, n_fine)[:n_fine] for values in (excess, None))
    total, n_cells, square = (np.convolve(values, weights, mode="same")[::FINE // BANDS] for values, weights in
                              ((sums, _WEIGHTS), (counts, _WEIGHTS), (counts, _WEIGHTS**2)))
    return np.asarray(np.where(n_cells >= FEWEST_CELLS, total / np.sqrt(np.maximum(square, TINY)), 0.0))
