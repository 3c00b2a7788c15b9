"""Rigid translations that the pyramid starts from: of the region, and of each piece that lines cut it into.

Between the images as they are, and from where a given displacement puts the reference image.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import ConvergenceError
from ddic.images.rigid import GridField, RigidShift, build_uniform_field, find_rigid_shift
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.interpolation import interpolate_located, locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_displacement import CutField
from ddic.start.feature_matches import find_piece_of_nodes, find_pieces

LEAST_COEFFICIENT = 0.3
"""Correlation coefficient below which a rigid translation is noise. A larger value starts from zero more often."""

REPETITIVE = 4
"""Other translations as good as the best from which on the texture is taken to repeat itself: grids have one on each
side. A few may be chance."""

FEWEST_BLOCKS = 24
"""Blocks of the region below which no translation is sought."""

FEWEST_OF_PIECE = 600
"""Blocks of a piece below which it takes the region's translation: coefficients of unrelated images of so many reach
0.2 (200 000 translations). A larger value looks for fewer pieces' own."""

AREA_RANGE = (0.2, 5.0)
"""Least and largest area of a displaced cell, times its own, with which it is drawn: others are torn."""

LARGEST_STRETCH = 10.0
"""Largest side of a displaced cell's bounding box, times that of the cell, with which it is drawn."""


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

    fields: tuple[GridField | CutField, ...]
    translations: tuple[RigidShift, ...]
    coefficient: float
    warnings: tuple[str, ...]


def find_rigid_start(pair: BinnedPair, mesh: Mesh, discontinuities: Discontinuities) -> RigidStart:
    """Find the translation of a region, and of each piece that lines cut it into.

    It is at rest, with a warning, where nothing stands out. Raises ConvergenceError where the texture repeats itself,
    so that nobody knows which translation is right.
    """
    region = pair.scale(mesh)
    shift = _find_shift_of_part(pair, region, FEWEST_BLOCKS)
    if _stands_out(shift) and shift.n_alike >= REPETITIVE:
        listed = ", ".join(f"{along:.0f}" for along in shift.shift)
        raise ConvergenceError(
            f"the texture repeats itself: {shift.n_alike} other translations match as well as ({listed}) px; "
            "give a pair of points (start.points), or switch start.rigid off where nothing moves by half a period")
    whole = shift.shift if _stands_out(shift) else (0.0,) * pair.dim
    of_pieces, field = _find_piece_shifts(pair, region, discontinuities, whole)
    fields = (build_uniform_field(whole),) if field is None else (field, build_uniform_field(whole))
    if _stands_out(shift):
        return RigidStart(fields, (shift, *of_pieces), shift.coefficient, ())
    warning = (f"start: no rigid translation stands out (best correlation coefficient {shift.coefficient:.2f}); "
               "starting from zero")
    return RigidStart(fields, of_pieces, shift.coefficient, () if of_pieces else (warning,))


def _find_piece_shifts(pair: BinnedPair, region: Mesh, discontinuities: Discontinuities,
                       otherwise: tuple[float, ...]) -> tuple[tuple[RigidShift, ...], CutField | None]:
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
        shift = _find_shift_of_part(pair, part, FEWEST_OF_PIECE)
        if _stands_out(shift):
            displacement[nodes] = shift.shift
            found.append(shift)
    return tuple(found), CutField(pair.scale_to_pixels(blocks), displacement)


def _find_shift_of_part(pair: BinnedPair, part: Mesh, fewest: float) -> RigidShift:
    """Translation of a part, which is in blocks; pixels."""
    return _find_shift(pair.reference.read_whole(), pair, pair.find_active(part).astype(bool), fewest)


def _find_shift(grey: Array, pair: BinnedPair, blocks: BoolArray, fewest: float) -> RigidShift:
    """Translation of some blocks of an image in the deformed one, pixels; of coefficient 0 where they are too few."""
    if blocks.sum() < fewest:
        return RigidShift((0.0,) * pair.dim, 0.0)
    return find_rigid_shift(grey, pair.deformed.read_whole(), blocks).scale(pair.factor)


def _stands_out(shift: RigidShift) -> bool:
    return shift.coefficient >= LEAST_COEFFICIENT


@dataclass(frozen=True, eq=False)
class MovedOn:
    """A given displacement, moved on by translations.

    Attributes
    ----------
    field : CutField
        Pixels.
    translations : tuple of RigidShift
        Translations of the pieces, or that of the region; pixels of the deformed image.
    """

    field: CutField
    translations: tuple[RigidShift, ...]


def move_on(given: CutField, pair: BinnedPair) -> list[MovedOn]:
    """Find the translations between a reference image displaced as given and the deformed one.

    Returns each piece moved by its own translation, where there are several pieces and one finds its own, then the
    region by one; none where nothing stands out.
    """
    mesh, found = given.mesh, []
    grey, pieces = _bring(given, pair)
    whole = _find_shift(grey, pair, pieces >= 0, FEWEST_BLOCKS)
    by_node = np.tile(whole.shift if _stands_out(whole) else (0.0,) * pair.dim, (mesh.n_nodes, 1))
    of_pieces = []
    n_pieces = int(pieces.max(initial=-1)) + 1
    if n_pieces > 1:
        piece_of_node = find_piece_of_nodes(mesh)
        for piece in range(n_pieces):
            shift = _find_shift(grey, pair, pieces == piece, FEWEST_OF_PIECE)
            if _stands_out(shift):
                by_node[piece_of_node == piece] = shift.shift
                of_pieces.append(shift)
    if of_pieces:
        found.append(MovedOn(CutField(mesh, given.displacement + by_node), tuple(of_pieces)))
    if _stands_out(whole):
        found.append(MovedOn(CutField(mesh, given.displacement + np.array(whole.shift)), (whole,)))
    return found


def _bring(given: CutField, pair: BinnedPair) -> tuple[Array, IntArray]:
    """The reference image as the given displacement puts it into the deformed one, and the piece of each block."""
    before = pair.scale(given.mesh)
    after = Mesh(before.nodes + given.displacement / pair.factor, before.connectivity, before.offsets, before.types)
    # Torn and folded cells would cover everything.
    kept = np.flatnonzero(_find_drawn(before, after))
    shape = pair.reference.extent.shape
    pieces = np.full(shape, -1, dtype=np.int64)
    grey = np.zeros(shape)
    if not kept.size:
        return grey, pieces
    drawn, nodes = after.create_submesh(kept)
    places_of_blocks = np.indices(shape).reshape(len(shape), -1)[::-1].T
    located = locate(drawn, places_of_blocks.astype(float))
    inside = located.cells >= 0
    origins = interpolate_located(drawn, before.nodes[nodes], located)[inside]
    reference = pair.reference.read_whole()
    places = origins[:, ::-1].T
    grey.reshape(-1)[inside] = scipy.ndimage.map_coordinates(reference, places, order=1, mode="nearest")
    counted = np.ones(len(origins), dtype=bool)
    usable = pair.reference.find_usable(pair.reference.extent)
    if usable is not None:
        nearest = np.clip(np.rint(places).astype(np.int64), 0, np.array(shape)[:, None] - 1)
        counted = usable[tuple(nearest)] > 0
    of_cells = find_pieces(given.mesh)[kept]
    pieces.reshape(-1)[inside] = np.where(counted, of_cells[located.cells[inside]], -1)
    return grey, pieces


def _find_drawn(before: Mesh, after: Mesh) -> BoolArray:
    """Cells that a displacement neither folds nor tears."""
    plain = Mesh(before.nodes, before.connectivity, before.offsets, before.types)
    ratio = measure_areas(after) / measure_areas(plain)
    sides = []
    for mesh in (plain, after):
        corners = mesh.nodes[mesh.connectivity]
        starts = mesh.offsets[:-1]
        sides.append(np.maximum.reduceat(corners, starts) - np.minimum.reduceat(corners, starts))
    stretch = sides[1].max(axis=1) / sides[0].max(axis=1)
    return np.asarray((ratio > AREA_RANGE[0]) & (ratio < AREA_RANGE[1]) & (stretch < LARGEST_STRETCH))
