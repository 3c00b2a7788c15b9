"""Rigid translations that the pyramid starts from: of the region, and of each piece that lines cut it into."""

from dataclasses import dataclass

import numpy as np

from ddic.errors import ConvergenceError
from ddic.images.rigid import RigidShift, build_uniform_field, find_rigid_shift
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.start.binned_pair import CELL, BinnedPair, find_active_blocks, scale_mesh
from ddic.start.coarse_displacement import CoarseField, CutField, scale_to_pixels
from ddic.start.feature_matches import find_pieces

LEAST_COEFFICIENT = 0.3
"""Correlation coefficient below which a rigid translation is noise. A larger value starts from zero more often."""

REPETITIVE = 4
"""Other translations as good as the best from which on the texture is taken to repeat itself: grids have one on each
side. A few may be chance."""

FEWEST_BLOCKS = 1.5 * CELL
"""Blocks of the region below which no translation is sought."""

FEWEST_OF_PIECE = 600
"""Blocks of a piece below which it takes the region's translation: coefficients of unrelated images of so many reach
0.2 (200 000 translations). A larger value looks for fewer pieces' own."""


@dataclass(frozen=True, eq=False)
class RigidStart:
    """Where the pyramid may start.

    Attributes
    ----------
    fields : tuple of GridField or CutField
        Likely ones first, pixels.
    translations : tuple of RigidShift
        The translations found: of the region where one stands out, then of pieces that lines cut it into; pixels.
    coefficient : float
        Correlation coefficient of the region's translation.
    warnings : tuple of str
        What did not work.
    """

    fields: tuple[CoarseField, ...]
    translations: tuple[RigidShift, ...]
    coefficient: float
    warnings: tuple[str, ...]


def find_rigid_start(pair: BinnedPair, mesh: Mesh, discontinuities: Discontinuities) -> RigidStart:
    """Find the translation of a region, and of each piece that lines cut it into.

    It is at rest, with a warning, where nothing stands out. Raises ConvergenceError where the texture repeats itself,
    so that nobody knows which translation is right.
    """
    region = scale_mesh(mesh, pair.factor)
    shift = _find_shift(pair, region, FEWEST_BLOCKS)
    stands_out = shift.coefficient >= LEAST_COEFFICIENT
    if stands_out and shift.n_alike >= REPETITIVE:
        x, y = shift.shift
        raise ConvergenceError(
            f"the texture repeats itself: {shift.n_alike} other translations match as well as ({x:.0f}, {y:.0f}) px; "
            "give a pair of points (start.points), or switch start.rigid off where nothing moves by half a period")
    whole = shift.shift if stands_out else (0.0, 0.0)
    of_pieces, field = _find_piece_shifts(pair, region, discontinuities, whole)
    fields: list[CoarseField] = [build_uniform_field(whole)]
    if field is not None:
        fields.insert(0, field)
    if stands_out:
        return RigidStart(tuple(fields), (shift, *of_pieces), shift.coefficient, ())
    warning = (f"start: no rigid translation stands out (best correlation coefficient {shift.coefficient:.2f}); "
               "starting from zero")
    return RigidStart(tuple(fields), of_pieces, shift.coefficient, () if of_pieces else (warning,))


def _find_piece_shifts(pair: BinnedPair, region: Mesh, discontinuities: Discontinuities,
                       otherwise: tuple[float, float]) -> tuple[tuple[RigidShift, ...], CutField | None]:
    """Translations of pieces, and their field; that is the translation of the region where they do not find theirs."""
    lines = discontinuities.scale(pair.centre, pair.factor).lines
    blocks = cut_mesh(region, lines).mesh
    pieces = find_pieces(blocks)
    if not pieces.any():
        return (), None
    displacement = np.tile(otherwise, (blocks.n_nodes, 1))
    found = []
    for piece in range(int(pieces.max()) + 1):
        part, nodes = blocks.create_submesh(np.flatnonzero(pieces == piece))
        shift = _find_shift(pair, part, FEWEST_OF_PIECE)
        if shift.coefficient >= LEAST_COEFFICIENT:
            displacement[nodes] = shift.shift
            found.append(shift)
    return tuple(found), CutField(scale_to_pixels(blocks, pair.factor), displacement)


def _find_shift(pair: BinnedPair, part: Mesh, fewest: float) -> RigidShift:
    """Translation of a part, which is in blocks; pixels; of coefficient 0 where it has fewer blocks than that."""
    blocks = find_active_blocks(pair.reference, rasterize(part)).astype(bool)
    if blocks.sum() < fewest:
        return RigidShift((0.0, 0.0), 0.0)
    found = find_rigid_shift(pair.reference.read_whole(), pair.deformed.read_whole(), blocks)
    return found.scale(pair.factor)
