"""One level of the coarse-graining pyramid: R-DIC on a square grid over binned images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.discontinuities import Discontinuities
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import Raster, rasterize
from ddic.solvers.correction_size import Tolerances
from ddic.start.coarse_grid import CELL, build_grid, locate_block_centre
from ddic.start.correlate_alone import Images, correlate_alone
from ddic.start.cut_field import CoarseField, CutField, evaluate_at_nodes
from ddic.start.level_mesh import cut_level, scale_to_pixels

CUT_OFF = 4.0 * CELL
"""Cut-off wavelength of a level, blocks. A larger value finds smoother fields, and strays less where texture is
poor."""

DEGREE = 3
"""Of the splines between blocks."""

TOLERANCES = Tolerances(relative=1e-12, rms=0.01, max_iterations=30, largest=np.inf)
"""Of Gauss-Newton on a level: the RMS of a correction, in blocks, decides."""


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
    """

    reference: MaskedSource
    deformed: MaskedSource
    factor: int

    @property
    def n_blocks(self) -> int:
        """Blocks of an image."""
        return self.reference.image.width * self.reference.image.height

    @property
    def centre(self) -> float:
        """Position of block 0's centre, pixels."""
        return locate_block_centre(self.factor)


def correlate_level(pair: BinnedPair, mesh: Mesh, starts: Sequence[CoarseField], correction: GreyCorrection,
                    discontinuities: Discontinuities) -> CoarseField:
    """Correlate one level from the best of some starts.

    Parameters
    ----------
    pair : BinnedPair
        The images.
    mesh : Mesh
        The whole mesh, pixels.
    starts : sequence of GridField or CutField
        At least one, pixels; that of least residual is taken.
    correction : GreyCorrection
        Of grey levels.
    discontinuities : Discontinuities
        Lines that cut the level's grid, pixels.

    Returns
    -------
    GridField or CutField
        The displacement, pixels.

    Raises
    ------
    ConvergenceError
        Where Gauss-Newton does not converge.
    SingularSubdomainError
        Where the blocks do not determine the displacement.
    """
    region = scale_mesh(mesh, pair.factor)
    active = find_active_blocks(pair.reference, rasterize(region))
    if not active.any():
        raise SingularSubdomainError("no block of the region is usable: everything is masked")
    grid = build_grid(region, active)
    cells = cut_level(grid.mesh, discontinuities.scale(pair.centre, pair.factor), active, DEGREE)
    in_pixels = scale_to_pixels(cells.mesh, pair.factor)
    candidates = [evaluate_at_nodes(start, in_pixels).ravel() / pair.factor for start in starts]
    images = Images(pair.reference, pair.deformed, active, DEGREE, correction)
    where = f"pyramid level with blocks of {pair.factor} px"
    displacement = correlate_alone(images, cells, CUT_OFF, TOLERANCES, candidates, where)
    if cells.mesh.parts is None:
        return grid.make_field(displacement, pair.factor)
    return CutField(in_pixels, displacement.reshape(in_pixels.nodes.shape) * pair.factor)


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
