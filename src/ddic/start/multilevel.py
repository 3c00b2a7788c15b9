"""Start of the displacement: rigid FFT correlation, matched features, a coarse-graining pyramid [BP17, Fig. 5].

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
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_displacement import CoarseField
from ddic.start.coarse_grid import CELL
from ddic.start.feature_matches import match_features
from ddic.start.matched_field import MatchedField
from ddic.start.pyramid_level import correlate_level
from ddic.start.rigid_start import RigidStart, find_pieces, find_rigid_start

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

SURE = 0.8
"""Correlation coefficient of a translation from which on nothing else is sought: the region then moves by little else.
A larger value matches features more often, which takes some tenths of a second."""

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
class Stages:
    """Which stages of the start are taken.

    Attributes
    ----------
    rigid : bool
        Whether a rigid translation is sought first.
    features : bool
        Whether features are matched where that translation does not explain the region.
    pyramid : bool
        Whether the coarse-graining pyramid follows.
    """

    rigid: bool = True
    features: bool = True
    pyramid: bool = True


@dataclass(frozen=True)
class MultilevelStart:
    """A coarse field and what the user should know about how it was found.

    Attributes
    ----------
    field : GridField, CutField or MatchedField
        The displacement, pixels.
    rigid : tuple of RigidShift
        The translations found first, pixels: of the region where one stands out, then of pieces that lines cut it
        into.
    levels : tuple of int
        Block sizes of the pyramid's levels that were measured, pixels, coarsest first.
    warnings : tuple of str
        What did not work.
    n_matches, n_found : int
        Features by whose displacement the field was found, and all that were matched; 0 where none were.
    """

    field: CoarseField
    rigid: tuple[RigidShift, ...]
    levels: tuple[int, ...]
    warnings: tuple[str, ...]
    n_matches: int = 0
    n_found: int = 0


def find_multilevel_start(pair: BinnedPair, mesh: Mesh, stages: Stages, correction: GreyCorrection,
                          lines: LinesOnLevels = NO_LINES) -> MultilevelStart:
    """Find a coarse field on the region of a mesh.

    Parameters
    ----------
    pair : BinnedPair
        The images, binned at most as far as ``choose_finest_block`` says.
    mesh : Mesh
        The whole mesh, pixels.
    stages : Stages
        Which stages are taken.
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
    sizes = choose_block_sizes(n_pixels, mesh) if stages.pyramid else []
    rigid_size = _rigid_block_size(n_pixels, mesh)
    all_sizes = [*sizes, rigid_size] if stages.rigid else sizes
    pairs = _binned_pairs(pair, all_sizes)

    at_rest = RigidStart((build_uniform_field((0.0, 0.0)),), (), 1.0, ())
    rigid_start = find_rigid_start(pairs[rigid_size], mesh, lines.discontinuities) if stages.rigid else at_rest
    warnings = list(rigid_start.warnings)
    starts = rigid_start.fields
    matched = None
    if stages.features and rigid_start.coefficient < SURE:
        matched = _match_features(pairs[min(all_sizes)], mesh, lines.discontinuities)
    if matched is not None:
        # From there the finest level finds everything, and coarser ones would smooth it.
        starts, sizes, warnings = (matched, *starts), sizes[-1:], []
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
    n_matches, n_found = (0, 0) if matched is None else (len(matched.matches.points), matched.matches.n_found)
    return MultilevelStart(starts[0], rigid_start.translations, tuple(done), tuple(warnings), n_matches, n_found)


def _match_features(pair: BinnedPair, mesh: Mesh, discontinuities: Discontinuities) -> MatchedField | None:
    """A field through features that were found again; None where they do not agree with each other."""
    region = cut_mesh(mesh, discontinuities.lines).mesh
    pieces = find_pieces(region)
    matches = match_features(pair, region, pieces)
    return MatchedField(matches, region, pieces) if matches.agree else None


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
