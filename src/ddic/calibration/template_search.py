"""Where a picture taken at another magnification lies in an image: search by normalised cross-correlation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.images.camera import CameraMapping, similarity

RATIO_RANGE = 0.15
"""Relative error of the given ratio that the search covers."""

ROTATION_RANGE = 5.0
"""Rotation that the search covers either way, degrees."""

TILE = 64
"""Side of the searched tile, far px: long enough to be told apart, short enough for coarse steps."""

_SMALL_TILE = 32

LEAST_TILE = 16
"""Side below which a tile of speckle may match anywhere, far px."""

_CLEAR = 0.9
"""Correlation coefficient at which no further candidate is tried."""

_STEPS = 6
_FINE_STEPS = (0.5, 0.25)
_TILES = 4
_BLUR = 1.0
"""Gaussian blur of both images, far px: widens the peak that the search must hit."""

Grey = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Match:
    """A tile of the near image found in the far image.

    mapping: similarity from far to near px. coefficient: correlation coefficient of the tile, -1 where nothing could
    be compared. centre: (x, y) of the tile, near px. side: of the tile, near px.
    """

    mapping: CameraMapping
    coefficient: float
    centre: tuple[float, float]
    side: float


@dataclass(frozen=True, eq=False)
class TileSearch:
    """The far image and the near image reduced to its resolution, both slightly blurred.

    far: (height, width), its mean taken off. power: of its windows of the tiles' size. reduced: the near image at
    about one px per far px. scale: (x, y) near px per reduced px. ratio: the given near px per far px.
    side: of the tiles, far px.
    """

    far: Grey
    power: NDArray[np.float64]
    reduced: Grey
    scale: tuple[float, float]
    ratio: float
    side: int

    def matches(self, *, fixed: bool = False) -> Iterator[Match]:
        """The best match of each of the tiles, from the one with the most texture on; fixed: only place is searched."""
        for centre in self._tiles():
            yield self._best(centre, fixed)

    def _tiles(self) -> list[tuple[float, float]]:
        """Centres of tiles, reduced px, those with the most gradient in its weaker direction first."""
        height, width = self.reduced.shape
        margin = 0.5 * self.side * (1 + RATIO_RANGE)
        along = [np.linspace(margin, size - 1 - margin, 5) if size - 1 > 2 * margin else np.array([(size - 1) / 2])
                 for size in (width, height)]
        by_y, by_x = np.gradient(self.reduced)
        # Summed over tiles: each place's value says how much texture the tile about it has.
        xx, xy, yy = (cv2.blur(a * b, (self.side, self.side)) for a, b in ((by_x, by_x), (by_x, by_y), (by_y, by_y)))
        weaker = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy)**2 + xy**2)
        centres = [(float(x), float(y)) for x, y in product(*along)]
        order = sorted(centres, key=lambda c: -weaker[int(c[1]), int(c[0])])
        chosen: list[tuple[float, float]] = []
        for c in order:
            if all(max(abs(c[0] - d[0]), abs(c[1] - d[1])) >= 0.75 * self.side for d in chosen):
                chosen.append(c)
        return chosen[:_TILES]

    def _best(self, centre: tuple[float, float], fixed: bool) -> Match:
        steps = [0.0] if fixed else [k / _STEPS for k in range(-_STEPS, _STEPS + 1)]
        # The most likely first: the given ratio, upright.
        grid = sorted(product(steps, steps), key=lambda step: step[0]**2 + step[1]**2)
        best, at = self._match(centre, 0.0, 0.0), (0.0, 0.0)
        for stretch, turn in grid[1:]:
            if best.coefficient >= _CLEAR:
                break
            tried = self._match(centre, stretch, turn)
            if tried.coefficient > best.coefficient:
                best, at = tried, (stretch, turn)
        for fine in () if fixed else _FINE_STEPS:
            middle = at
            for k, j in product((-1, 0, 1), repeat=2):
                stretch, turn = middle[0] + k * fine / _STEPS, middle[1] + j * fine / _STEPS
                tried = self._match(centre, stretch, turn)
                if tried.coefficient > best.coefficient:
                    best, at = tried, (stretch, turn)
        return best

    def _match(self, centre: tuple[float, float], stretch: float, turn: float) -> Match:
        """Find a tile in the far image; stretch, turn: shares of the ranges of ratio and rotation."""
        ratio, degrees = self.ratio * (1 + RATIO_RANGE * stretch), ROTATION_RANGE * turn
        x, y = ((c + 0.5) * s - 0.5 for c, s in zip(centre, self.scale, strict=True))
        c, s = ratio * np.cos(np.deg2rad(degrees)), ratio * np.sin(np.deg2rad(degrees))
        turned = np.array([[c, -s], [s, c]]) / np.array(self.scale)[:, None]
        half = (self.side - 1) / 2
        start = np.array(centre) - turned @ np.array([half, half])
        template = cv2.warpAffine(self.reduced, np.column_stack([turned, start]), (self.side, self.side),
                                  flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REFLECT_101)
        coefficients = correlation_coefficients(self.far, self.power, template)
        row, column = np.unravel_index(int(np.argmax(coefficients)), coefficients.shape)
        place = np.array([column + half, row + half])
        shift = np.array([x, y]) - np.array([[c, -s], [s, c]]) @ place
        return Match(similarity(ratio, degrees, (float(shift[0]), float(shift[1]))),
                     float(coefficients[row, column]), (x, y), self.side * ratio)


def tile_search(far: Grey, near: Grey, ratio: float) -> TileSearch:
    """Prepare the search of the near image (height, width) in the far one; ratio: rough near px per far px.

    The near image must cover at least LEAST_TILE far px either way.
    """
    height, width = near.shape
    size = max(round(width / ratio), 1), max(round(height / ratio), 1)
    reduced = cv2.resize(near, size, interpolation=cv2.INTER_AREA)
    most = min(int(n / (1 + RATIO_RANGE)) for n in (*size, far.shape[1], far.shape[0]))
    # Half the image, so that a tile is left in view where part of the near field is not.
    side = max(min(TILE, most, max(_SMALL_TILE, min(size) // 2)), 1)
    blurred, small = (cv2.GaussianBlur(image, (0, 0), _BLUR) for image in (far, reduced))
    blurred -= blurred.mean()
    return TileSearch(blurred, window_power(blurred, side), small, (width / size[0], height / size[1]), ratio, side)


def correlation_coefficients(image: Grey, power: NDArray[np.float64], template: Grey) -> NDArray[np.float64]:
    """Zero-mean normalised cross-correlation of a template with each window of an image of its size.

    power: of these windows, from ``window_power``.
    Returns (height - template height + 1, width - template width + 1); -1 where a window or the template is blank.
    """
    covariance = cv2.matchTemplate(image, template - np.float32(template.mean()), cv2.TM_CCORR).astype(np.float64)
    own = float(np.var(template, dtype=np.float64)) * template.size
    # What is left of blank ones is rounding of float32.
    blank = own <= 1e-10 * float(np.square(template, dtype=np.float64).sum())
    good = (power > 1e-6 * float(power.max())) & (not blank)
    return np.where(good, covariance / np.sqrt(np.where(good, power * own, 1.0)), -1.0)


def window_power(image: Grey, side: int) -> NDArray[np.float64]:
    """Sum of squares about the mean of each window of side x side pixels of an image."""
    sums, squares = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    total, square = (s[side:, side:] - s[:-side, side:] - s[side:, :-side] + s[:-side, :-side]
                     for s in (sums, squares))
    return np.asarray(square - total**2 / side**2)
