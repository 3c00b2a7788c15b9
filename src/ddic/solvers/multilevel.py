"""Start of the displacement: rigid FFT correlation, then a coarse-graining pyramid [BP17, Fig. 5].

Runs on one rank, on images binned so far that they are small whatever the camera; every other rank
receives the coarse field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.correlation import GreyCorrection
from ddic.images.binned import bin_image
from ddic.images.grid_field import GridField, uniform_field
from ddic.images.rigid import RigidShift, rigid_shift
from ddic.images.sub_image import MaskedSource
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.solvers.pyramid_level import CELL, BinnedPair, active_blocks, correlate_level, scaled_mesh

LARGEST_COARSE_IMAGE = 2_000_000
"""Pixels of the finest image of the pyramid: what one rank is asked to hold and correlate."""

LARGEST_FFT_IMAGE = 500_000
SMALLEST_SIDE = 3 * CELL
"""Least side of the region on the coarsest level, blocks."""

COARSEST = 8
"""Largest block, pixels, unless the image is so large that the finest level needs larger ones."""


@dataclass(frozen=True)
class MultilevelStart:
    """A coarse field and what the user should know about how it was found.

    rigid: the translation found first, pixels (None where switched off); levels: block sizes, pixels.
    """

    field: GridField
    rigid: RigidShift | None
    levels: tuple[int, ...]
    warnings: tuple[str, ...]


def multilevel_start(reference: MaskedSource, deformed: MaskedSource, mesh: Mesh, *, rigid: bool, pyramid: bool,
                     correction: GreyCorrection) -> MultilevelStart:
    """Find a coarse field on the region of ``mesh`` (the whole mesh, pixels)."""
    shift = _rigid(reference, deformed, mesh) if rigid else None
    field = uniform_field((0.0, 0.0) if shift is None else shift.shift)
    warnings: list[str] = []
    done: list[int] = []
    for factor in block_sizes(reference.image.width * reference.image.height, mesh) if pyramid else ():
        pair = BinnedPair(bin_image(reference, factor), bin_image(deformed, factor), factor)
        try:
            field = correlate_level(pair, mesh, field, correction)
            done.append(factor)
        except (ConvergenceError, SingularSubdomainError) as error:
            warnings.append(f"start: the pyramid's level with blocks of {factor} px was left out ({error})")
    return MultilevelStart(field, shift, tuple(done), tuple(warnings))


def block_sizes(n_pixels: int, mesh: Mesh) -> list[int]:
    """Block sizes of the pyramid's levels, pixels, coarsest first."""
    side = float((mesh.nodes.max(axis=0) - mesh.nodes.min(axis=0)).min())
    finest = 2
    while n_pixels / finest**2 > LARGEST_COARSE_IMAGE:
        finest *= 2
    sizes = [finest]
    while sizes[-1] < COARSEST and side / (2 * sizes[-1]) >= SMALLEST_SIDE:
        sizes.append(2 * sizes[-1])
    return [size for size in reversed(sizes) if side / size >= CELL]


def _rigid(reference: MaskedSource, deformed: MaskedSource, mesh: Mesh) -> RigidShift:
    factor = 1
    while reference.image.width * reference.image.height / factor**2 > LARGEST_FFT_IMAGE:
        factor *= 2
    pair = BinnedPair(bin_image(reference, factor), bin_image(deformed, factor), factor)
    region = active_blocks(pair.reference, rasterize(scaled_mesh(mesh, factor))).astype(bool)
    if region.sum() < SMALLEST_SIDE:
        return RigidShift((0.0, 0.0), 0.0)
    found = rigid_shift(_values(pair.reference), _values(pair.deformed), region)
    return RigidShift((factor * found.shift[0], factor * found.shift[1]), found.coefficient)


def _values(source: MaskedSource) -> NDArray[np.float64]:
    return source.image.read(source.extent).astype(np.float64)
