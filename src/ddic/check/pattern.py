"""Where an image bears a pattern, how large its features are, and the region and the elements that they suggest."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from ddic.arrays import Array, BoolArray, IntArray
from ddic.images.grey_levels import measure_feature_size
from ddic.images.source import ImageSource

BLOCK = 16
"""Side of the squares, or cubes, whose texture is told, pixels: three features of a usual pattern."""

WELL_TEXTURED = 90.0
"""Percentile of the blocks' gradient energy that stands for the pattern: a specimen fills a tenth of its image."""

HARDLY = 0.1
"""Gradient energy of a block over that of the pattern, below which it has hardly any texture. A larger share leaves out
faint speckle, a smaller one takes a dark background's noise for a pattern."""

LEAST_FILLED = 0.85
"""Share of the blocks along each edge of the suggested region that bear the pattern; a larger one draws it smaller."""

FEATURES_A_SIDE = 3.0
"""Features along the side of an element: fewer leave nodes to noise."""

SMALLEST_ELEMENT = 8
"""Suggested for the finest pattern, pixels."""

N_WINDOWS = 16
"""Windows whose autocorrelation tells the features' size."""

DEEP, LEAST_DEPTH = 5.0, 0.6
"""Blocks from what bears no pattern in which a window of 128 px shows nothing else; and share of the deepest block's
depth from which on one is taken where the specimen is narrower, or a volume, whose windows are smaller."""


@dataclass(frozen=True, eq=False)
class Pattern:
    """What of an image bears a pattern.

    Attributes
    ----------
    has_texture : (n_rows, n_columns) or (n_planes, n_rows, n_columns) bool array
        Of each block of BLOCK pixels a side.
    strength : array of the same shape
        Gradient energy of each block over that of the pattern.
    feature_size : float
        Width of a feature, pixels; nan where none is found.
    """

    has_texture: BoolArray
    strength: Array
    feature_size: float

    def choose_element_size(self) -> int:
        """Suggest the side of the elements, pixels: even, as many features as FEATURES_A_SIDE."""
        if not math.isfinite(self.feature_size):
            return BLOCK
        return max(SMALLEST_ELEMENT, 2 * math.ceil(FEATURES_A_SIDE * self.feature_size / 2.0))

    def measure_bare_share(self, region: tuple[int, ...]) -> float:
        """Measure the share of a region, its lowest corner, then its highest, pixels, that has hardly any texture."""
        ends = self._find_blocks(np.reshape(region, (2, -1)))
        return float(1.0 - self.has_texture[tuple(slice(first, last + 1) for first, last in ends)].mean())

    def find_bare(self, points: Array) -> BoolArray:
        """Find the points, (n, dim), pixels, about which the image has hardly any texture, (n,)."""
        return np.asarray(~self.has_texture[self._find_blocks(points)])

    def find_strength(self, points: Array) -> Array:
        """Find how strong the pattern is about points, (n, dim), pixels, (n,): 1 where as in most of it; nan at nan."""
        strength = self.strength[self._find_blocks(np.nan_to_num(points))]
        return np.where(np.isnan(points).any(axis=1), np.nan, strength)

    def _find_blocks(self, points: Array) -> tuple[IntArray, ...]:
        """Rows and columns, or planes, rows and columns, of the blocks that hold points."""
        places = np.floor((points + 0.5) / BLOCK).astype(int).T[::-1]
        return tuple(np.clip(place, 0, n - 1) for place, n in zip(places, self.has_texture.shape, strict=True))

    def describe_elements(self, size: float) -> str:
        """Say in a line of ``ddic check`` what the pattern asks of elements of a size, pixels."""
        if not math.isfinite(self.feature_size):
            return "no features are told: is there a pattern in the region?"
        asked = "" if size >= 0.8 * self.choose_element_size() else f": {self.choose_element_size()} px are suggested"
        return (f"features of {self.feature_size:.1f} px, {size / self.feature_size:.1f} along the side of an element"
                f"{asked}")


def find_pattern(image: ImageSource) -> Pattern:
    """Find what of an image, or a volume, bears a pattern; it is read a band at a time."""
    energy = _measure_block_energy(image)
    typical = float(np.percentile(energy, WELL_TEXTURED))
    # Single blocks, bare or not, say nothing of the specimen.
    has_texture = scipy.ndimage.median_filter(energy > HARDLY * typical, size=3, mode="nearest")
    strength = energy / max(typical, 1e-300)
    return Pattern(has_texture, strength, measure_feature_size(image, _choose_places(has_texture)))


def _choose_places(has_texture: BoolArray) -> Array:
    """Places deep in what bears the pattern, (n, dim), pixels: a window that shows an edge would tell that."""
    inside = (slice(1, -1),) * has_texture.ndim
    depth = scipy.ndimage.distance_transform_cdt(np.pad(has_texture, 1), "chessboard")[inside]
    blocks = np.argwhere(has_texture & (depth >= min(LEAST_DEPTH * float(depth.max()), DEEP)))[:, ::-1]
    chosen = np.unique(np.linspace(0, max(len(blocks) - 1, 0), N_WINDOWS).astype(int))
    return BLOCK * (blocks[chosen] + 0.5) if len(blocks) else np.zeros((0, has_texture.ndim))


def _measure_block_energy(image: ImageSource) -> Array:
    """Mean |grad f|^2 of each whole block, by rows, (grey level / px)^2, by central differences in rows of blocks."""
    energy = np.zeros([max(n // BLOCK, 1) for n in image.extent.shape])
    n_bands, *across, n_columns = energy.shape
    for number, rows in zip(range(n_bands), image.extent.split_rows(BLOCK), strict=False):
        band = image.read(rows)
        for place in np.ndindex(*across):
            part = (slice(None), *(slice(BLOCK * k, BLOCK * (k + 1)) for k in place), slice(BLOCK * n_columns))
            row = np.nan_to_num(np.asarray(band[part], np.float64))
            slopes = np.gradient(row) if min(row.shape) > 1 else [np.zeros_like(row)]
            squares = sum(slope**2 for slope in reversed(slopes)).mean(axis=tuple(range(row.ndim - 1)))
            energy[number, *place] = squares.reshape(n_columns, -1).mean(axis=1)
    return energy


def choose_region(pattern: Pattern, image: ImageSource) -> tuple[int, int, int, int]:
    """Suggest the rectangle x0, y0, x1, y1, pixels, about the largest piece of an image that bears the pattern.

    Its sides are whole numbers of the suggested elements. Edges that hardly bear it are cut off, holes stay.
    """
    labels, n_pieces = scipy.ndimage.label(pattern.has_texture)
    if not n_pieces:
        rows, columns = slice(0, labels.shape[0]), slice(0, labels.shape[1])
    else:
        rows, columns = _trim(labels == 1 + int(np.bincount(labels.ravel())[1:].argmax()))
    element = pattern.choose_element_size()
    # Without the outermost block, in which the specimen may end.
    low = (np.array([columns.start, rows.start]) + 1) * BLOCK
    high = np.minimum((np.array([columns.stop, rows.stop]) - 1) * BLOCK, [image.width - 1, image.height - 1])
    n_elements = np.maximum((high - low) // element, 1)
    margin = (high - low - n_elements * element) // 2
    x0, y0 = (low + np.maximum(margin, 0)).tolist()
    return x0, y0, x0 + int(n_elements[0]) * element, y0 + int(n_elements[1]) * element


def _trim(is_piece: BoolArray) -> tuple[slice, slice]:
    """Rows and columns of the box about a piece, without edges of which it fills less than LEAST_FILLED."""
    rows, columns = np.flatnonzero(is_piece.any(axis=1)), np.flatnonzero(is_piece.any(axis=0))
    y0, y1, x0, x1 = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    while y1 - y0 > 1 and x1 - x0 > 1:
        box = is_piece[y0:y1, x0:x1]
        filled = [box[0].mean(), box[-1].mean(), box[:, 0].mean(), box[:, -1].mean()]
        worst = int(np.argmin(filled))
        if filled[worst] >= LEAST_FILLED:
            break
        y0, y1, x0, x1 = (y0 + (worst == 0), y1 - (worst == 1), x0 + (worst == 2), x1 - (worst == 3))
    return slice(y0, y1), slice(x0, x1)
