"""Shapes of regions and of holes, also of those that a mask image draws: signed distance, nearest point, corners."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.mesh.plane import is_inside_edges, is_simple_polygon, multiply_across, subdivide
from ddic.mesh.raster import SNAP

Box = tuple[float, float, float, float]
"""x0, y0, x1, y1, pixels."""

RegionLike = Sequence[float] | tuple[Sequence[float], float] | Array
"""A box, (x0, y0, x1, y1); a circle, (centre, radius); or the vertices of a polygon, (n, 2); pixels."""


class Outline(Protocol):
    """A closed outline in the plane."""

    def measure_distance(self, points: Array) -> Array:
        """Measure the distance of points, (n, 2), to the outline, (n,), pixels, negative inside."""

    def find_nearest(self, points: Array) -> Array:
        """Find the nearest point of the outline to each of some points, (n, 2), pixels."""


@dataclass(frozen=True)
class Circle:
    """A circle.

    Attributes
    ----------
    center, radius : (x, y) and float
        Pixels.
    """

    center: tuple[float, float]
    radius: float

    @property
    def box(self) -> Box:
        """The smallest box around it."""
        (x, y), r = self.center, self.radius
        return x - r, y - r, x + r, y + r

    def list_points(self, step: float) -> Array:
        """List points of the outline, (n, 2), each at most a step from the next, pixels."""
        # Its leftmost, topmost... points among them.
        angles = np.linspace(0, 2 * np.pi, 4 * int(2 + self.radius / step * np.pi / 2), endpoint=False)
        return np.asarray(np.array(self.center) + self.radius * np.column_stack([np.cos(angles), np.sin(angles)]))

    # It may be larger than any image.
    @np.errstate(over="ignore")
    def find_pixels(self, window: Window) -> BoolArray:
        """Find the pixels of a window whose centres lie inside, (window.height, window.width)."""
        x, y = self.center
        down = np.abs(np.arange(window.y0, window.y1) - y)
        half_width = np.sqrt(np.maximum((self.radius - down) * (self.radius + down), 0.0))
        return np.asarray(np.abs(np.arange(window.x0, window.x1) - x) < half_width[:, None])

    def measure_distance(self, points: Array) -> Array:
        """Measure the distance to the circle, pixels, negative inside."""
        return np.asarray(np.linalg.norm(points - np.array(self.center), axis=1) - self.radius)

    def find_nearest(self, points: Array) -> Array:
        """Find the nearest point of the circle; the centre itself stays where it is."""
        offset = points - np.array(self.center)
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        factor = np.divide(self.radius, length, out=np.zeros_like(length), where=length > 0)
        return np.asarray(np.array(self.center) + offset * factor)


@dataclass(frozen=True)
class Polygon:
    """A closed polygon in either sense; inside is what the even-odd rule calls so.

    Attributes
    ----------
    vertices : (n, 2) array
        Pixels.
    """

    vertices: Array

    @classmethod
    def from_box(cls, box: Sequence[float]) -> "Polygon":
        """The outline of a box x0, y0, x1, y1, pixels."""
        x0, y0, x1, y1 = box
        return cls(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=np.float64))

    @property
    def box(self) -> Box:
        """The smallest box around it."""
        (x0, y0), (x1, y1) = self.vertices.min(axis=0).tolist(), self.vertices.max(axis=0).tolist()
        return x0, y0, x1, y1

    def list_points(self, step: float) -> Array:
        """List points of the outline, (n, 2), each at most a step from the next, pixels."""
        return subdivide(np.concatenate([self.vertices, self.vertices[:1]]), step)

    # It may be larger than any image.
    @np.errstate(over="ignore")
    def find_pixels(self, window: Window) -> BoolArray:
        """Find the pixels of a window whose centres lie inside, (window.height, window.width).

        Of those on the outline the left and the upper ones do, as those of cells.
        """
        rows = np.arange(window.y0, window.y1)
        turns = np.zeros((window.height, window.width + 1), dtype=bool)
        for side in self._edges:
            (xa, ya), (xb, yb) = side[side[:, 1].argsort()]
            crossed = rows[(ya <= rows) & (rows < yb)]
            share = (crossed - ya) / (yb - ya)
            # Rounded as crossings of cells: a number that rounding has lifted a little is no pixel further.
            first = np.ceil(np.round(((1.0 - share) * xa + share * xb) * SNAP) / SNAP)
            turns[crossed - window.y0, np.clip(first - window.x0, 0, window.width).astype(np.int64)] ^= True
        return np.asarray(np.logical_xor.accumulate(turns, axis=1)[:, :-1])

    def measure_distance(self, points: Array) -> Array:
        """Measure the distance to the polygon, pixels, negative inside."""
        away = np.linalg.norm(self.find_nearest(points) - points, axis=1)
        return np.where(is_inside_edges(points, self._edges), -away, away)

    def find_nearest(self, points: Array) -> Array:
        """Find the nearest point of the polygon."""
        best = np.array(points, dtype=np.float64)
        smallest = np.full(len(points), np.inf)
        for start, end in self._edges:
            edge = end - start
            # An edge of no length has its start as its nearest point.
            square = max(edge @ edge, np.finfo(float).tiny)
            along = np.clip((points - start) @ edge / square, 0.0, 1.0)
            candidate = start + along[:, None] * edge
            away = np.linalg.norm(candidate - points, axis=1)
            closer = away < smallest
            best[closer], smallest[closer] = candidate[closer], away[closer]
        return best

    @property
    def _edges(self) -> Array:
        """Start and end of each edge, (n, 2, 2), pixels."""
        corners = np.asarray(self.vertices, dtype=np.float64)
        return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


STRAIGHT_PX = 0.8
"""Distance, pixels, from the edges of pixels within which an outline is straight: the steps of slanted lines are up to
0.7 px high. A larger value rounds small features off."""

SHARP_DEGREES = 30.0
"""Turn of an outline from which on it is a corner; a larger value keeps fewer."""


@dataclass(frozen=True, eq=False)
class OutlinedHole:
    """What lies between closed outlines, the outer one and those of islands in it.

    Attributes
    ----------
    rings : tuple of Outline
        Inside is what an odd number of them holds.
    corners : (n, 2) array
        Where they turn sharply, pixels: a node is to lie at each. In other holes nodes go to the nearest points.
    """

    rings: tuple[Outline, ...]
    corners: Array

    def measure_distance(self, points: Array) -> Array:
        """Measure the distance to the outline, pixels, negative inside."""
        distances = np.array([ring.measure_distance(points) for ring in self.rings])
        inside = np.logical_xor.reduce(distances < 0, axis=0)
        away = np.abs(distances).min(axis=0)
        return np.where(inside, -away, away)

    def find_nearest(self, points: Array) -> Array:
        """Find the nearest point of the outline."""
        nearest = np.array([ring.find_nearest(points) for ring in self.rings])
        chosen = np.linalg.norm(nearest - points, axis=2).argmin(axis=0)
        return np.asarray(nearest[chosen, np.arange(len(points))])


def convert_region(region: RegionLike, name: str) -> Circle | Polygon | None:
    """Convert a region to its outline, None where it is a box; ``name`` is what messages call it.

    Raises InputError where it is none of these, or a polygon whose sides meet elsewhere than at its vertices.
    """
    given: Any = region
    try:
        if np.ndim(given[0]) == 0:
            return None
        if len(given) == 2:
            (x, y), radius = given
            return Circle((float(x), float(y)), float(radius))
        polygon = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, IndexError) as error:
        raise InputError(f"{name}: expected (x0, y0, x1, y1), (centre, radius) or vertices (n, 2), finite "
                         "numbers of pixels") from error
    return convert_polygon(polygon, name)


def convert_polygon(vertices: Array, name: str) -> Polygon:
    """Convert vertices, (n, 2), pixels, to a polygon without those that repeat the one before.

    Raises InputError where sides meet elsewhere than at their common vertex; ``name`` is what messages call it.
    """
    given = np.asarray(vertices, dtype=np.float64)
    if given.ndim != 2 or given.shape[1] != 2 or not np.isfinite(given).all():
        raise InputError(f"{name}: vertices of shape {given.shape}, (n, 2) finite numbers of pixels expected")
    distinct = given[(given != np.roll(given, 1, axis=0)).any(axis=1)]
    if len(distinct) < 3 or not is_simple_polygon(distinct):
        raise InputError(f"{name}: the polygon crosses or touches itself; list its vertices in the order in which they "
                         "follow each other around it")
    return Polygon(distinct)


def convert_holes(circles: Sequence[tuple[tuple[float, float], float]], polygons: Sequence[Array],
                  name: str) -> list[Circle | Polygon]:
    """Convert holes to their outlines, circles first; ``name`` is what messages call the mesh.

    Raises InputError on radii that are not above 0, and on polygons as ``convert_polygon`` does.
    """
    for k, (_, radius) in enumerate(circles):
        if not radius > 0:
            raise InputError(f"{name}.circles[{k}]: radius = {radius}: expected more than 0")
    return [*(Circle(center, radius) for center, radius in circles),
            *(convert_polygon(vertices, f"{name}.polygons[{k}]") for k, vertices in enumerate(polygons))]


def build_outside(region: Circle | Polygon, element_size: float) -> OutlinedHole:
    """Build the hole that is all around a region; it has the region's corners between sides that hold an element."""
    x0, y0, x1, y1 = region.box
    away = 2 * max(x1 - x0, y1 - y0)
    frame = Polygon.from_box((x0 - away, y0 - away, x1 + away, y1 + away))
    corners = _find_corners(region.vertices, element_size) if isinstance(region, Polygon) else np.zeros((0, 2))
    return OutlinedHole((frame, region), corners)


def require_inside(holes: Sequence[Circle | Polygon], region: Circle | Polygon, step: float, name: str) -> None:
    """Refuse, by an InputError, holes that leave the region, looked at every ``step`` pixels along their outlines."""
    low, high = np.array(region.box).reshape(2, 2)
    for number, hole in enumerate(holes):
        # First by their boxes: of a hole without bounds there would be points without end.
        within = (np.array(hole.box[:2]) >= low).all() and (np.array(hole.box[2:]) <= high).all()
        if not within or (region.measure_distance(hole.list_points(step)) >= 0).any():
            raise InputError(f"{name}: hole_{number} leaves the region; move it inside, or draw its notch as part of "
                             f"{name}.region, a polygon")


def find_mask_holes(mask: BoolArray, region: Sequence[float], element_size: float) -> list[OutlinedHole]:
    """Find what a mask leaves out of a region (x0, y0, x1, y1), pixels, what lies outside of the image too.

    The mask is True where cells may be. Holes come from top to bottom; specks of less than half an element's side
    across are left out, and turns between sides shorter than that are no corners.
    """
    low, high = np.floor(region[:2]).astype(int), np.ceil(region[2:]).astype(int)
    left_out = _find_left_out(mask, low, high)
    n, labels, sizes, _ = cv2.connectedComponentsWithStats(left_out, connectivity=4)
    large = [k for k in range(1, n) if sizes[k, cv2.CC_STAT_AREA] >= (0.5 * element_size) ** 2]
    return [_outline(labels == k, low - 1, element_size) for k in large]


def _find_left_out(mask: BoolArray, low: NDArray[np.int_], high: NDArray[np.int_]) -> NDArray[np.uint8]:
    """1 on pixels from low to high, with a margin of one before and two after, that lie in no cell; low, high: (x, y).

    The margin is as the pixels beside it: where the region is as large as the image, it is no hole.
    """
    x, y = (np.arange(first - 1, last + 2).clip(first, last - 1) for first, last in zip(low, high, strict=True))
    height, width = mask.shape
    is_inside = ((y >= 0) & (y < height))[:, None] & (x >= 0) & (x < width)
    shown = mask[np.ix_(y.clip(0, height - 1), x.clip(0, width - 1))]
    return np.asarray(~(is_inside & shown), dtype=np.uint8)


def _outline(inside: BoolArray, low: NDArray[np.int_], element_size: float) -> OutlinedHole:
    """Outline of some pixels along their edges; low: (x, y) of the array's first pixel."""
    padded = np.pad(inside, 1)
    # A contour through the corners of pixels runs along their edges.
    corners = padded[1:, 1:] | padded[:-1, 1:] | padded[1:, :-1] | padded[:-1, :-1]
    contours, _ = cv2.findContours(corners.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    # Corners lie half a pixel before the pixels' centres.
    polygons = [cv2.approxPolyDP(contour, STRAIGHT_PX, True)[:, 0] + low - 0.5 for contour in contours]
    rings = [polygon for polygon in polygons if len(polygon) >= 3]
    sharp = [_find_corners(ring, element_size) for ring in rings]
    return OutlinedHole(tuple(Polygon(ring) for ring in rings), np.concatenate([np.zeros((0, 2)), *sharp]))


def _find_corners(ring: Array, element_size: float) -> Array:
    """Vertices at which a closed polygon turns sharply between two long sides, (n, 2)."""
    behind, ahead = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    sine, cosine = multiply_across(behind, ahead), (behind * ahead).sum(axis=1)
    turn = np.degrees(np.abs(np.arctan2(sine, cosine)))
    shorter = np.minimum(np.linalg.norm(behind, axis=1), np.linalg.norm(ahead, axis=1))
    return np.asarray(ring[(turn >= SHARP_DEGREES) & (shorter >= 0.5 * element_size)])
