"""Sides of the blocks of pixels that the start looks at: a megapixel at most of an image, or of what is seen of it."""

from __future__ import annotations

import numpy as np

from ddic.mesh.mesh import Mesh
from ddic.start.coarse_grid import CELL

LARGEST_COARSE_IMAGE = 1_000_000
"""Pixels of the finest image of the pyramid: what one rank is asked to hold and correlate. A larger value gives a
better start later."""

LARGEST_FFT_IMAGE = 500_000
"""Most blocks of the image in which a rigid translation is sought. A larger value takes longer."""

ENOUGH_FFT_IMAGE = 200_000
"""Blocks of the image enough for a rigid translation, if ENOUGH_BLOCKS of them show the region. A larger value takes
longer."""

ENOUGH_BLOCKS = 2000
"""Blocks of the region enough for a rigid translation: coefficients of unrelated images then stay below 0.11 (2000
samples, 200 000 translations), far from LEAST_COEFFICIENT. A larger value keeps more blocks of small regions."""

SMALLEST_SIDE = 1.5 * CELL
"""Least side of the region on the coarsest level, blocks: there the grid is hardly more than an affine map. A larger
value leaves out coarse levels."""

COARSEST = 64
"""Largest block, pixels. A level finds displacements of about a block beyond its start; a larger value reaches
further."""


def choose_finest_block(n_pixels: int) -> int:
    """Find the side of the smallest blocks that the start looks at.

    Parameters
    ----------
    n_pixels : int
        Of an image.

    Returns
    -------
    int
        Pixels.
    """
    return 1 if n_pixels <= LARGEST_FFT_IMAGE else find_finest_level(n_pixels)


def find_finest_level(n_pixels: int) -> int:
    """Find the side of the smallest blocks of the pyramid.

    Parameters
    ----------
    n_pixels : int
        Of an image.

    Returns
    -------
    int
        Pixels.
    """
    finest = 2
    while n_pixels / finest**2 > LARGEST_COARSE_IMAGE:
        finest *= 2
    return finest


def choose_block_sizes(n_pixels: int, mesh: Mesh) -> list[int]:
    """Choose the block sizes of the pyramid's levels.

    Parameters
    ----------
    n_pixels : int
        Of an image.
    mesh : Mesh
        The whole mesh, pixels.

    Returns
    -------
    list of int
        Pixels, coarsest first; none where the region is smaller than a cell of each.
    """
    side = float(np.ptp(mesh.nodes, axis=0).min())
    sizes = [find_finest_level(n_pixels)]
    while sizes[-1] < COARSEST and side / (2 * sizes[-1]) >= SMALLEST_SIDE:
        sizes.append(2 * sizes[-1])
    return [size for size in reversed(sizes) if side / size >= CELL]


def choose_rigid_block(n_pixels: int, mesh: Mesh) -> int:
    """Choose the side of the blocks in which a rigid translation is sought.

    Parameters
    ----------
    n_pixels : int
        Of an image.
    mesh : Mesh
        The whole mesh, pixels.

    Returns
    -------
    int
        Pixels.
    """
    region = float(np.prod(np.ptp(mesh.nodes, axis=0)))
    size = 1
    while True:
        n_blocks = n_pixels / size**2
        n_larger_blocks_of_region = region / (2 * size) ** 2
        is_too_large = n_blocks > LARGEST_FFT_IMAGE
        is_more_than_enough = n_blocks > ENOUGH_FFT_IMAGE and n_larger_blocks_of_region >= ENOUGH_BLOCKS
        if not (is_too_large or is_more_than_enough):
            return size
        size *= 2
