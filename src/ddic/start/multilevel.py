"""Start of the displacement: rigid FFT correlation, then a coarse-graining pyramid [BP17, Fig. 5].

Runs on one rank, on images binned so far that they are small whatever the camera; every other rank
receives the coarse field.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.binned import bin_image
from ddic.images.grid_field import GridField, build_uniform_field
from ddic.images.rigid import RigidShift, find_rigid_shift
from ddic.images.sub_image import MaskedSource
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.start.pyramid_level import CELL, BinnedPair, correlate_level, find_active_blocks, scale_mesh

LARGEST_COARSE_IMAGE = 1_000_000
"""Pixels of the finest image of the pyramid: what one rank is asked to hold and correlate."""

LARGEST_FFT_IMAGE = 500_000
ENOUGH_FFT_IMAGE = 200_000
ENOUGH_BLOCKS = 2000
"""Blocks of the image enough for a rigid translation, if that many of them show the region: coefficients of unrelated
images then stay below 0.11 (2000 samples, 200 000 translations), far from LEAST_COEFFICIENT."""

SMALLEST_SIDE = 1.5 * CELL
"""Least side of the region on the coarsest level, blocks: there the grid is hardly more than an affine map."""

COARSEST = 64
"""Largest block, pixels. A level finds displacements of about a block beyond its start."""

LEAST_COEFFICIENT = 0.3
"""Correlation coefficient below which a rigid translation is noise."""


@dataclass(frozen=True)
class MultilevelStart:
    """A coarse field and what the user should know about how it was found.

    rigid: the translation found first, pixels (None where switched off); levels: block sizes, pixels.
    """

    field: GridField
    rigid: RigidShift | None
    levels: tuple[int, ...]
    warnings: tuple[str, ...]


def find_multilevel_start(pair: BinnedPair, mesh: Mesh, *, rigid: bool, pyramid: bool,
                          correction: GreyCorrection) -> MultilevelStart:
    """Find a coarse field on the region of ``mesh`` (the whole mesh, pixels).

    pair: the images, binned at most as far as ``choose_finest_block`` says.
    """
    n_pixels = pair.n_blocks * pair.factor**2
    sizes = choose_block_sizes(n_pixels, mesh) if pyramid else []
    rigid_size = _rigid_block_size(n_pixels, mesh)
    pairs = _binned_pairs(pair, [*sizes, *([rigid_size] if rigid else [])])
    shift = _rigid(pairs[rigid_size], mesh) if rigid else None
    warnings: list[str] = []
    if shift is not None and shift.coefficient < LEAST_COEFFICIENT:
        warnings.append(f"start: no rigid translation stands out (best correlation coefficient {shift.coefficient:.2f}"
                        "); starting from zero")
        shift = None
    field = rigid_field = build_uniform_field((0.0, 0.0) if shift is None else shift.shift)
    done: list[int] = []
    for size in sizes:
        try:
            # A coarse level of a ragged region may have gone astray: the residual of the next one tells.
            field = correlate_level(pairs[size], mesh, [field, rigid_field] if done else [field], correction)
            done.append(size)
        except (ConvergenceError, SingularSubdomainError) as error:
            warnings.append(f"start: the pyramid's level with blocks of {size} px was left out ({error})")
    return MultilevelStart(field, shift, tuple(done), tuple(warnings))


def choose_finest_block(n_pixels: int) -> int:
    """Side of the smallest blocks that the start looks at, pixels."""
    return 1 if n_pixels <= LARGEST_FFT_IMAGE else _finest_level(n_pixels)


def _finest_level(n_pixels: int) -> int:
    finest = 2
    while n_pixels / finest**2 > LARGEST_COARSE_IMAGE:
        finest *= 2
    return finest


def choose_block_sizes(n_pixels: int, mesh: Mesh) -> list[int]:
    """Block sizes of the pyramid's levels, pixels, coarsest first."""
    side = float((mesh.nodes.max(axis=0) - mesh.nodes.min(axis=0)).min())
    sizes = [_finest_level(n_pixels)]
    while sizes[-1] < COARSEST and side / (2 * sizes[-1]) >= SMALLEST_SIDE:
        sizes.append(2 * sizes[-1])
    return [size for size in reversed(sizes) if side / size >= CELL]


def _rigid_block_size(n_pixels: int, mesh: Mesh) -> int:
    region = float(np.prod(mesh.nodes.max(axis=0) - mesh.nodes.min(axis=0)))
    size = 1
    while n_pixels / size**2 > LARGEST_FFT_IMAGE or (
            n_pixels / size**2 > ENOUGH_FFT_IMAGE and region / (2 * size) ** 2 >= ENOUGH_BLOCKS):
        size *= 2
    return size


def _binned_pairs(pair: BinnedPair, sizes: Iterable[int]) -> dict[int, BinnedPair]:
    """Both images at all block sizes (powers of 2), each binned from the one before."""
    pairs: dict[int, BinnedPair] = {}
    finer = pair
    for size in sorted(set(sizes)):
        ratio = size // finer.factor
        finer = BinnedPair(bin_image(finer.reference, ratio), bin_image(finer.deformed, ratio), size)
        pairs[size] = finer
    return pairs


def _rigid(pair: BinnedPair, mesh: Mesh) -> RigidShift:
    region = find_active_blocks(pair.reference, rasterize(scale_mesh(mesh, pair.factor))).astype(bool)
    if region.sum() < SMALLEST_SIDE:
        return RigidShift((0.0, 0.0), 0.0)
    found = find_rigid_shift(_values(pair.reference), _values(pair.deformed), region)
    return RigidShift((pair.factor * found.shift[0], pair.factor * found.shift[1]), found.coefficient)


def _values(source: MaskedSource) -> NDArray[np.float64]:
    return source.image.read(source.extent).astype(np.float64)
