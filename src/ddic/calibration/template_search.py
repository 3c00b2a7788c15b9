"""Where a picture taken at another magnification lies in an image: search by normalised cross-correlation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.images.camera import CameraMapping, similarity
from ddic.mesh.plane import build_rotation

RATIO_RANGE = 0.15
"""Relative error of the given ratio that the search covers; a larger one takes longer, for steps are shares of it."""

ROTATION_RANGE = 5.0
"""Rotation that the search covers either way, degrees; a larger one takes longer, for steps are shares of it."""

TILE = 64
"""Side of the searched tile, far px: long enough to be told apart, short enough for coarse steps."""

_SMALL_TILE = 32
"""Side, far px, that a tile keeps where the near field is less than twice as long."""

LEAST_TILE = 16
"""Side below which a tile of speckle may match anywhere, far px."""

_CLEAR = 0.9
"""Correlation coefficient at which no further candidate is tried."""

_STEPS = 6
"""Steps either way in which the ranges of ratio and of rotation are searched; fewer may step over the peak."""

_FINE_STEPS = (0.5, 0.25)
"""Shares of a step by which the best candidate is moved afterwards, one after the other."""

_TILES = 4
"""Tiles that are searched at most, until one leads to a registration."""

_APART = 0.75
"""Least distance of two tiles over their side."""

_BLUR = 1.0
"""Gaussian blur of both images, far px: widens the peak that the search must hit."""

Grey = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Match:
    """A tile of the near image found in the far image.

    Attributes
    ----------
    mapping : CameraMapping
        Similarity from far to near px.
    coefficient : float
        Correlation coefficient of the tile, -1 where nothing could be compared.
    centre : (float, float)
        Of the tile, near px.
    side : float
        Of the tile, near px.
    """

    mapping: CameraMapping
    coefficient: float
    centre: tuple[float, float]
    side: float


@dataclass(frozen=True, eq=False)
class TileSearch:
    """The far image and the near image reduced to its resolution, both slightly blurred.

    Attributes
    ----------
    far : (height, width) array
        The far image, its mean taken off.
    power : (height - side + 1, width - side + 1) array
        Sum of squares about the mean of its windows of the tiles' size.
    reduced : (rows, columns) array
        The near image at about one px per far px.
    scale : (float, float)
        Near px per reduced px along x and y.
    ratio : float
        The given near px per far px.
    side : int
        Of the tiles, far px.
    """

    far: Grey
    power: NDArray[np.float64]
    reduced: Grey
    scale: tuple[float, float]
    ratio: float
    side: int

    def find_matches(self, *, fixed: bool = False) -> Iterator[Match]:
        """Find the best match of each tile, from the tile with the most texture on.

        Parameters
        ----------
        fixed : bool, optional
            Only the place is searched, with the given ratio and upright.

        Yields
        ------
        Match
            Of the next tile.
        """
        for centre in self._choose_tiles():
            yield self._find_best(centre, fixed)

    def _choose_tiles(self) -> list[tuple[float, float]]:
        """Centres of tiles, reduced px, those with the most gradient in its weaker direction first."""
        height, width = self.reduced.shape
        # The tile may be larger in the near image by the error of the ratio.
        margin = 0.5 * self.side * (1 + RATIO_RANGE)
        along_x, along_y = (_places_along(size, margin) for size in (width, height))
        weaker = self._weaker_gradient()
        centres = [(float(x), float(y)) for x, y in product(along_x, along_y)]
        by_texture = sorted(centres, key=lambda centre: -weaker[int(centre[1]), int(centre[0])])
        chosen: list[tuple[float, float]] = []
        for x, y in by_texture:
            distances = (max(abs(x - other_x), abs(y - other_y)) for other_x, other_y in chosen)
            if all(distance >= _APART * self.side for distance in distances):
                chosen.append((x, y))
        return chosen[:_TILES]

    def _weaker_gradient(self) -> NDArray[np.float64]:
        """Mean square of the gradient in its weaker direction over the tile about each place of the reduced image."""
        by_y, by_x = np.gradient(self.reduced)
        tile = (self.side, self.side)
        xx = cv2.blur(by_x * by_x, tile)
        xy = cv2.blur(by_x * by_y, tile)
        yy = cv2.blur(by_y * by_y, tile)
        # The smaller eigenvalue of [[xx, xy], [xy, yy]].
        return np.asarray(0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2))

    def _find_best(self, centre: tuple[float, float], fixed: bool) -> Match:
        """The best match of a tile over ratios and rotations: on a grid, then around its best point."""
        best = self._match(centre, 0.0, 0.0)
        if fixed:
            return best
        at = (0.0, 0.0)
        steps = [k / _STEPS for k in range(-_STEPS, _STEPS + 1)]
        # The most likely first: the given ratio, upright.
        grid = sorted(product(steps, steps), key=lambda step: step[0] ** 2 + step[1] ** 2)
        for stretch, turn in grid[1:]:
            if best.coefficient >= _CLEAR:
                break
            tried = self._match(centre, stretch, turn)
            if tried.coefficient > best.coefficient:
                best, at = tried, (stretch, turn)
        for fine in _FINE_STEPS:
            middle = at
            for k, j in product((-1, 0, 1), repeat=2):
                stretch = middle[0] + k * fine / _STEPS
                turn = middle[1] + j * fine / _STEPS
                tried = self._match(centre, stretch, turn)
                if tried.coefficient > best.coefficient:
                    best, at = tried, (stretch, turn)
        return best

    def _match(self, centre: tuple[float, float], stretch: float, turn: float) -> Match:
        """Find a tile in the far image; stretch, turn: shares of the ranges of ratio and rotation."""
        ratio = self.ratio * (1 + RATIO_RANGE * stretch)
        degrees = ROTATION_RANGE * turn
        matrix = ratio * build_rotation(np.deg2rad(degrees))
        half = (self.side - 1) / 2
        template = self._turned_tile(centre, matrix)
        coefficients = correlate_template(self.far, self.power, template)
        row, column = np.unravel_index(int(np.argmax(coefficients)), coefficients.shape)
        # The tile's centre, in near px and where it was found in the far image.
        x, y = ((place + 0.5) * scale - 0.5 for place, scale in zip(centre, self.scale, strict=True))
        offset = np.array([x, y]) - matrix @ np.array([column + half, row + half])
        mapping = similarity(ratio, degrees, (float(offset[0]), float(offset[1])))
        return Match(mapping, float(coefficients[row, column]), (x, y), self.side * ratio)

    def _turned_tile(self, centre: tuple[float, float], matrix: NDArray[np.float64]) -> Grey:
        """The tile about a place of the reduced image, as the far image shows it; matrix: far to near px."""
        turned = matrix / np.array(self.scale)[:, None]
        half = (self.side - 1) / 2
        start = np.array(centre) - turned @ np.array([half, half])
        tile = cv2.warpAffine(self.reduced, np.column_stack([turned, start]), (self.side, self.side),
                              flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REFLECT_101)
        return np.asarray(tile)


def prepare_search(far: Grey, near: Grey, ratio: float) -> TileSearch:
    """Prepare the search of the near image in the far one.

    Parameters
    ----------
    far, near : (height, width) array
        Grey levels; the near image must cover at least LEAST_TILE far px either way.
    ratio : float
        Rough near px per far px.

    Returns
    -------
    TileSearch
        Both images at the far one's resolution.
    """
    height, width = near.shape
    size = max(round(width / ratio), 1), max(round(height / ratio), 1)
    reduced = cv2.resize(near, size, interpolation=cv2.INTER_AREA)
    most = min(int(n / (1 + RATIO_RANGE)) for n in (*size, far.shape[1], far.shape[0]))
    # Half the image, so that a tile is left in view where part of the near field is not.
    side = max(min(TILE, most, max(_SMALL_TILE, min(size) // 2)), 1)
    blurred_far = cv2.GaussianBlur(far, (0, 0), _BLUR)
    blurred_near = cv2.GaussianBlur(reduced, (0, 0), _BLUR)
    blurred_far -= blurred_far.mean()
    return TileSearch(
        far=blurred_far,
        power=sum_window_squares(blurred_far, side),
        reduced=blurred_near,
        scale=(width / size[0], height / size[1]),
        ratio=ratio,
        side=side,
    )


def correlate_template(image: Grey, power: NDArray[np.float64], template: Grey) -> NDArray[np.float64]:
    """Correlate a template with each window of an image of its size (zero-mean, normalised).

    Parameters
    ----------
    image : (height, width) array
        Grey levels.
    power : (height - rows + 1, width - columns + 1) array
        Of the image's windows, from ``sum_window_squares``.
    template : (rows, columns) array
        Grey levels.

    Returns
    -------
    (height - rows + 1, width - columns + 1) array
        Correlation coefficients; -1 where a window or the template is blank.
    """
    centred = template - np.float32(template.mean())
    covariance = cv2.matchTemplate(image, centred, cv2.TM_CCORR).astype(np.float64)
    own_power = float(np.var(template, dtype=np.float64)) * template.size
    # What is left of blank ones is rounding of float32.
    blank = own_power <= 1e-10 * float(np.square(template, dtype=np.float64).sum())
    good = (power > 1e-6 * float(power.max())) & (not blank)
    norm = np.sqrt(np.where(good, power * own_power, 1.0))
    return np.where(good, covariance / norm, -1.0)


def sum_window_squares(image: Grey, side: int) -> NDArray[np.float64]:
    """Sum the squares about the mean of each window of an image.

    Parameters
    ----------
    image : (height, width) array
        Grey levels.
    side : int
        Of the windows, pixels.

    Returns
    -------
    (height - side + 1, width - side + 1) array
        Grey levels squared.
    """
    sums, squares = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    total = _sum_windows(sums, side)
    square = _sum_windows(squares, side)
    return np.asarray(square - total**2 / side**2)


def _sum_windows(integral: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Sums over windows from sums over all that is left of and above each place."""
    top_left, top_right = integral[:-side, :-side], integral[:-side, side:]
    bottom_left, bottom_right = integral[side:, :-side], integral[side:, side:]
    return np.asarray(bottom_right - top_right - bottom_left + top_left)


def _places_along(size: int, margin: float) -> NDArray[np.float64]:
    """Five places along a side of so many px, a margin from its ends; the middle where there is no room."""
    last = size - 1
    if last <= 2 * margin:
        return np.array([last / 2])
    return np.linspace(margin, last - margin, 5)
