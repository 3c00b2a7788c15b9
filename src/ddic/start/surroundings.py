"""A small region in a large image: what surrounds it, in smaller blocks than the whole image is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.binned import bin_window, join_blocks
from ddic.images.window import Window
from ddic.mesh.mesh import Mesh
from ddic.start.binned_pair import BinnedPair, PixelPair
from ddic.start.block_sizes import choose_finest_block, find_finest_level

Array = NDArray[np.float64]

MARGIN = 0.5
"""What is seen around the region, times its longer side: it may turn by any angle about its middle, and grow by two
thirds beside what the translation takes. A larger value finds larger motions, in larger blocks."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Parts of both images, of the same size, that show a region and what is around it.

    Attributes
    ----------
    pair : BinnedPair
        The parts, positions counted from where each begins.
    origin : (2,) array
        Where the reference image's part begins, pixels.
    translation : (2,) array
        Where the deformed image's part begins, from there, pixels.
    """

    pair: BinnedPair
    origin: Array
    translation: Array

    def describe(self) -> str:
        """Say what is looked at.

        Returns
        -------
        str
            For the log.
        """
        x, y = self.origin
        width, height = (n * self.pair.factor for n in (self.pair.reference.image.width,
                                                        self.pair.reference.image.height))
        return (f"start: the region and what surrounds it, {width} x {height} px from ({x:.0f}, {y:.0f}) px on, in "
                f"blocks of {self.pair.factor} px")


def can_bin_finer(pixels: PixelPair, mesh: Mesh) -> bool:
    """Tell whether what surrounds a region is so small that the pyramid has finer levels there than on whole images.

    Parameters
    ----------
    pixels : PixelPair
        The images.
    mesh : Mesh
        The region, pixels.

    Returns
    -------
    bool
        Whether it has.
    """
    size = _find_size(pixels)
    return find_finest_level(int(_find_extent(size, mesh).prod())) < find_finest_level(int(size.prod()))


def bin_surroundings(pixels: PixelPair, mesh: Mesh, translation: Array) -> Surroundings:
    """Bin what surrounds a region.

    Parameters
    ----------
    pixels : PixelPair
        The images.
    mesh : Mesh
        The region, pixels.
    translation : (2,) array
        Of the region, about, pixels.

    Returns
    -------
    Surroundings
        In blocks as small as those of an image of that size.
    """
    size = _find_size(pixels)
    extent = _find_extent(size, mesh)
    factor = choose_finest_block(int(extent.prod()))
    extent -= extent % factor
    middle = (mesh.nodes.min(axis=0) + mesh.nodes.max(axis=0)) / 2
    origin, moved = (np.clip(np.rint(place - extent / 2).astype(int), 0, size - extent)
                     for place in (middle, middle + translation))
    parts = [join_blocks(source, [bin_window(source, factor, Window(*begin, *(begin + extent)))])
             for source, begin in ((pixels.reference, origin), (pixels.deformed, moved))]
    return Surroundings(BinnedPair(parts[0], parts[1], factor), origin.astype(float), (moved - origin).astype(float))


def _find_size(pixels: PixelPair) -> NDArray[np.int64]:
    """Width and height of both images, pixels."""
    return np.array([pixels.reference.image.width, pixels.reference.image.height])


def _find_extent(size: NDArray[np.int64], mesh: Mesh) -> NDArray[np.int64]:
    """Width and height of what is seen of an image, pixels."""
    sides = np.ptp(mesh.nodes, axis=0)
    return np.minimum(np.ceil(sides + 2 * MARGIN * sides.max()).astype(int), size)
