"""Shapes of holes: signed distance and nearest point of their outline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

NO_CORNERS = np.zeros((0, 2))


class Hole(Protocol):
    """A closed outline in the plane."""

    @property
    def corners(self) -> NDArray[np.float64]:
        """Points of the outline at which a node is to lie, (n, 2), pixels."""

    def measure_distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Measure the distance to the outline.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n,) array
            Pixels, negative inside.
        """

    def find_nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Find the nearest point of the outline.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Pixels.
        """


@dataclass(frozen=True)
class CircularHole:
    """A circle.

    Attributes
    ----------
    center : tuple of float
        Pixels.
    radius : float
        Pixels.
    """

    center: tuple[float, float]
    radius: float

    @property
    def corners(self) -> NDArray[np.float64]:
        """None, (0, 2)."""
        return NO_CORNERS

    def measure_distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Measure the distance to the circle.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n,) array
            Pixels, negative inside.
        """
        return np.asarray(np.linalg.norm(points - np.array(self.center), axis=1) - self.radius)

    def find_nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Find the nearest point of the circle; the centre itself stays where it is.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Pixels.
        """
        offset = points - np.array(self.center)
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        factor = np.divide(self.radius, length, out=np.zeros_like(length), where=length > 0)
        return np.asarray(np.array(self.center) + offset * factor)


@dataclass(frozen=True)
class PolygonalHole:
    """A closed polygon in either sense; inside is what the even-odd rule calls so.

    Attributes
    ----------
    vertices : (n, 2) array
        Pixels.
    """

    vertices: NDArray[np.float64]

    @property
    def corners(self) -> NDArray[np.float64]:
        """None, (0, 2): nodes go to the nearest point of a side."""
        return NO_CORNERS

    def measure_distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Measure the distance to the polygon.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n,) array
            Pixels, negative inside.
        """
        away = np.linalg.norm(self.find_nearest(points) - points, axis=1)
        return np.where(self._inside(points), -away, away)

    def find_nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Find the nearest point of the polygon.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Pixels.
        """
        best = np.array(points, dtype=np.float64)
        smallest = np.full(len(points), np.inf)
        for start, end in self._edges():
            edge = end - start
            # An edge of no length has its start as its nearest point.
            square = max(edge @ edge, np.finfo(float).tiny)
            along = np.clip((points - start) @ edge / square, 0.0, 1.0)
            candidate = start + along[:, None] * edge
            away = np.linalg.norm(candidate - points, axis=1)
            closer = away < smallest
            best[closer], smallest[closer] = candidate[closer], away[closer]
        return best

    def _inside(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether a ray to the right crosses the polygon an odd number of times, (n,)."""
        x, y = points.T
        inside = np.zeros(len(points), dtype=bool)
        for (xa, ya), (xb, yb) in self._edges():
            spans = (ya > y) != (yb > y)
            height = yb - ya if yb != ya else 1.0
            inside ^= spans & (x < xa + (y - ya) * (xb - xa) / height)
        return inside

    def _edges(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Start and end of each edge, pixels."""
        corners = np.asarray(self.vertices, dtype=np.float64)
        return list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
