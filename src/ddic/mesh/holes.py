"""Shapes of holes: signed distance and nearest point of their outline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Hole(Protocol):
    """A closed outline; points are (n, 2), pixels."""

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance to the outline, (n,), pixels, negative inside."""

    def nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Nearest point of the outline, (n, 2), pixels."""


@dataclass(frozen=True)
class CircularHole:
    """A circle; centre and radius in pixels."""

    center: tuple[float, float]
    radius: float

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance to the circle, (n,), pixels, negative inside."""
        return np.asarray(np.linalg.norm(points - np.array(self.center), axis=1) - self.radius)

    def nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Nearest point of the circle, (n, 2), pixels; the centre itself stays where it is."""
        offset = points - np.array(self.center)
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        factor = np.divide(self.radius, length, out=np.zeros_like(length), where=length > 0)
        return np.asarray(np.array(self.center) + offset * factor)


@dataclass(frozen=True)
class PolygonalHole:
    """A closed polygon; vertices (n, 2) in pixels, either sense, inside by the even-odd rule."""

    vertices: NDArray[np.float64]

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance to the polygon, (n,), pixels, negative inside."""
        away = np.linalg.norm(self.nearest(points) - points, axis=1)
        return np.where(self._inside(points), -away, away)

    def nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Nearest point of the polygon, (n, 2), pixels."""
        best = np.array(points, dtype=np.float64)
        smallest = np.full(len(points), np.inf)
        for start, end in self._edges():
            edge = end - start
            along = np.clip((points - start) @ edge / max(edge @ edge, np.finfo(float).tiny), 0.0, 1.0)
            candidate = start + along[:, None] * edge
            away = np.linalg.norm(candidate - points, axis=1)
            closer = away < smallest
            best[closer], smallest[closer] = candidate[closer], away[closer]
        return best

    def _inside(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        inside = np.zeros(len(points), dtype=bool)
        for (xa, ya), (xb, yb) in self._edges():
            crosses = (ya > points[:, 1]) != (yb > points[:, 1])
            height = yb - ya if yb != ya else 1.0
            inside ^= crosses & (points[:, 0] < xa + (points[:, 1] - ya) * (xb - xa) / height)
        return inside

    def _edges(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        corners = np.asarray(self.vertices, dtype=np.float64)
        return list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
