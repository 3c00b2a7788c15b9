"""One level of the coarse-graining pyramid: R-DIC on a square grid over binned images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ddic.errors import SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.solvers.correction_size import Tolerances
from ddic.start.binned_pair import CELL, BinnedPair, build_grid, find_active_blocks, scale_mesh
from ddic.start.coarse_displacement import CoarseField, CutField, cut_level, evaluate_at_nodes, scale_to_pixels
from ddic.start.independent import Images, correlate_alone

CUT_OFF = 4.0 * CELL
"""Cut-off wavelength of a level, blocks. A larger value finds smoother fields, and strays less where texture is
poor."""

DEGREE = 3
"""Of the splines between blocks."""

TOLERANCES = Tolerances(relative=1e-12, rms=0.01, max_iterations=30, largest=np.inf)
"""Of Gauss-Newton on a level: the RMS of a correction, in blocks, decides."""


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
