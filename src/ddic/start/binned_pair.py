"""An image pair in blocks of pixels, and the blocks of a region."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.sub_image import MaskedSource
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import Raster
from ddic.start.coarse_grid import locate_block_centre


@dataclass(frozen=True)
class PixelPair:
    """An image pair as it was taken.

    Attributes
    ----------
    reference, deformed : MaskedSource
        The images.
    """

    reference: MaskedSource
    deformed: MaskedSource


@dataclass(frozen=True)
class BinnedPair:
    """An image pair binned over blocks of factor x factor pixels.

    Attributes
    ----------
    reference : MaskedSource
        The reference image, a pixel a block.
    deformed : MaskedSource
        The deformed image, a pixel a block.
    factor : int
        Side of a block, pixels.
    pixels : PixelPair, optional
        The images themselves, where parts of them may be looked at in smaller blocks.
    """

    reference: MaskedSource
    deformed: MaskedSource
    factor: int
    pixels: PixelPair | None = None

    @property
    def n_blocks(self) -> int:
        """Blocks of an image."""
        return self.reference.image.width * self.reference.image.height

    @property
    def centre(self) -> float:
        """Position of block 0's centre, pixels."""
        return locate_block_centre(self.factor)


def scale_mesh(mesh: Mesh, factor: int) -> Mesh:
    """Scale a mesh from pixels to blocks.

    Parameters
    ----------
    mesh : Mesh
        Pixels.
    factor : int
        Side of a block, pixels.

    Returns
    -------
    Mesh
        The same cells, blocks.
    """
    nodes = (mesh.nodes - locate_block_centre(factor)) / factor
    return Mesh(nodes, mesh.connectivity, mesh.offsets, mesh.types)


def find_active_blocks(coarse: MaskedSource, raster: Raster) -> NDArray[np.uint8]:
    """Mark the blocks whose centre lies in the mesh and that are not masked.

    Parameters
    ----------
    coarse : MaskedSource
        A binned image.
    raster : Raster
        Of the mesh in blocks.

    Returns
    -------
    (rows, columns) array of uint8
        1 on active blocks, 0 elsewhere.
    """
    covered = raster.find_covered(coarse.image.width, coarse.image.height)
    usable = coarse.find_usable(coarse.extent)
    return covered if usable is None else covered & usable
