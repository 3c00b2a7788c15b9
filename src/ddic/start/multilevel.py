"""Start of the displacement: rigid FFT correlation, then a coarse-graining pyramid [BP17, Fig. 5].

Runs on one rank, on images binned so far that they are small whatever the camera; every other rank
receives the coarse field.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.binned import bin_image
from ddic.images.grid_field import build_uniform_field
from ddic.images.rigid import RigidShift
from ddic.kinematics.discontinuities import Discontinuities
from ddic.mesh.mesh import Mesh
from ddic.start.coarse_grid import CELL
from ddic.start.cut_field import CoarseField
from ddic.start.pyramid_level import BinnedPair, correlate_level
from ddic.start.rigid_start import RigidStart, find_rigid_start

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


@dataclass(frozen=True)
class LinesOnLevels:
    """Lines across which the displacement may be discontinuous, and from which level on [RHR08, section 3].

    Attributes
    ----------
    discontinuities : Discontinuities
        Pixels.
    largest_block : float
        Side, pixels, of the largest blocks on which displacements are discontinuous.
    """

    discontinuities: Discontinuities
    largest_block: float

    def choose_lines(self, size: int) -> Discontinuities:
        """Give the lines of a level.

        Parameters
        ----------
        size : int
            Side of its blocks, pixels.

        Returns
        -------
        Discontinuities
            All lines, or none.
        """
        return self.discontinuities if size <= self.largest_block else Discontinuities()


NO_LINES = LinesOnLevels(Discontinuities(), np.inf)


@dataclass(frozen=True)
class MultilevelStart:
    """A coarse field and what the user should know about how it was found.

    Attributes
    ----------
    field : GridField or CutField
        The displacement, pixels.
    rigid : tuple of RigidShift
        The translations found first, pixels: of the region where one stands out, then of pieces that lines cut it
        into.
    levels : tuple of int
        Block sizes of the pyramid's levels that were measured, pixels, coarsest first.
    warnings : tuple of str
        What did not work.
    """

    field: CoarseField
    rigid: tuple[RigidShift, ...]
    levels: tuple[int, ...]
    warnings: tuple[str, ...]


def find_multilevel_start(pair: BinnedPair, mesh: Mesh, *, rigid: bool, pyramid: bool, correction: GreyCorrection,
                          lines: LinesOnLevels = NO_LINES) -> MultilevelStart:
    """Find a coarse field on the region of a mesh.

    Parameters
    ----------
    pair : BinnedPair
        The images, binned at most as far as ``choose_finest_block`` says.
    mesh : Mesh
        The whole mesh, pixels.
    rigid : bool
        Whether a rigid translation is sought first.
    pyramid : bool
        Whether the coarse-graining pyramid follows.
    correction : GreyCorrection
        Of grey levels.
    lines : LinesOnLevels
        Discontinuities of the displacement.

    Returns
    -------
    MultilevelStart
        The field of the finest level that worked.
    """
    n_pixels = pair.n_blocks * pair.factor**2
    sizes = choose_block_sizes(n_pixels, mesh) if pyramid else []
    rigid_size = _rigid_block_size(n_pixels, mesh)
    all_sizes = [*sizes, rigid_size] if rigid else sizes
    pairs = _binned_pairs(pair, all_sizes)

    at_rest = RigidStart((build_uniform_field((0.0, 0.0)),), (), ())
    rigid_start = find_rigid_start(pairs[rigid_size], mesh, lines.discontinuities) if rigid else at_rest
    warnings = list(rigid_start.warnings)
    starts = rigid_start.fields
    done: list[int] = []
    for size in sizes:
        try:
            field = correlate_level(pairs[size], mesh, starts, correction, lines.choose_lines(size))
        except (ConvergenceError, SingularSubdomainError) as error:
            warnings.append(f"start: the pyramid's level with blocks of {size} px was left out ({error})")
        else:
            # A coarse level of a ragged region may have gone astray: the residual of the next one tells.
            starts = (field, *rigid_start.fields)
            done.append(size)
    return MultilevelStart(starts[0], rigid_start.translations, tuple(done), tuple(warnings))


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
    return 1 if n_pixels <= LARGEST_FFT_IMAGE else _finest_level(n_pixels)


def _finest_level(n_pixels: int) -> int:
    """Side of the smallest blocks of the pyramid, pixels."""
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
    sizes = [_finest_level(n_pixels)]
    while sizes[-1] < COARSEST and side / (2 * sizes[-1]) >= SMALLEST_SIDE:
        sizes.append(2 * sizes[-1])
    return [size for size in reversed(sizes) if side / size >= CELL]


def _rigid_block_size(n_pixels: int, mesh: Mesh) -> int:
    """Side of the blocks in which a rigid translation is sought, pixels."""
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


def _binned_pairs(pair: BinnedPair, sizes: Iterable[int]) -> dict[int, BinnedPair]:
    """Both images at all block sizes (powers of 2), each binned from the one before."""
    pairs: dict[int, BinnedPair] = {}
    finer = pair
    for size in sorted(set(sizes)):
        ratio = size // finer.factor
        finer = BinnedPair(bin_image(finer.reference, ratio), bin_image(finer.deformed, ratio), size)
        pairs[size] = finer
    return pairs
