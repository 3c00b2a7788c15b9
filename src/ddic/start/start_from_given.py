"""The pyramid from a displacement that is given: which levels it needs, and whether it needs any.

A frame that jumps needs the given displacement moved on by a translation first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import StartSection
from ddic.images.rigid import GridField, RigidShift, find_rigid_shift
from ddic.mesh.interpolation import interpolate_located, locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.start.binned_pair import BinnedPair, scale_mesh
from ddic.start.coarse_displacement import CoarseField, CutField
from ddic.start.feature_matches import find_piece_of_nodes, find_pieces
from ddic.start.multilevel import SURE, MultilevelStart, Pyramid
from ddic.start.predicted_error import PredictedError, predict_error
from ddic.start.rigid_start import FEWEST_BLOCKS, FEWEST_OF_PIECE, LEAST_COEFFICIENT, RigidStart

RIGHT_PX = 1.0
"""Error, pixels, up to which a displacement is taken as it is: Gauss-Newton goes on from there. A larger value saves
searches, and fails where the speckles are small."""

WRONG_SHARE = 0.02
"""Share of the region that may be off by more. A larger value overlooks small pieces that moved by themselves."""

OUT_OF_REACH = 0.1
"""Share of the region that may be out of the reach of the level with which the pyramid begins. A larger value leaves
out levels that a part of the region needs."""

BETTER = 0.9
"""Largest part of what a given displacement leaves (1 less its correlation coefficient) that another one may leave to
be taken in its place. A larger value replaces good displacements by coarse ones."""

NOTE_IN_REACH = "start: the pyramid goes on from it"

NOTE_OUT_OF_REACH = ("start: neither the given displacement nor a translation is in reach of a level of the pyramid; "
                     "all levels are taken, from the best of them")

NOTE_OF_FEATURES = "start: features match; the given displacement is not used"

AREA_RANGE = (0.2, 5.0)
"""Least and largest area of a displaced cell, times its own, with which it is drawn: others are torn."""

LARGEST_STRETCH = 10.0
"""Largest side of a displaced cell's bounding box, times that of the cell, with which it is drawn."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A displacement that may be gone on from, and what the log says where it is."""

    field: GridField | CutField
    note: str


def find_start_from_given(given: CutField, pyramid: Pyramid, stages: StartSection) -> MultilevelStart:
    """Find a coarse field from a displacement that is given on the mesh of the region.

    Where the images bear it out, nothing is searched; where it is in reach of the finest level, that one follows. Else
    it is moved on by a translation; where neither explains the images, nor a translation from rest, features are
    matched; then come the levels of the pyramid in whose reach the best of them is. A displacement that explains the
    images worse than a start from nothing does is not used. The field is ``given`` itself where it is kept.
    """
    predicted = _predict(pyramid, pyramid.finest_size, given)
    share = predicted.measure_share_beyond(RIGHT_PX)
    if share <= WRONG_SHARE:
        return MultilevelStart(given)
    begun = (f"start: that is off by more than {RIGHT_PX:g} px on {share:.0%} of the region (correlation coefficient "
             f"{predicted.coefficient:.2f}); searching on")
    is_in_reach = predicted.measure_share_beyond(np.inf) <= WRONG_SHARE
    # Then nothing else is looked at: on a repetitive texture another translation would look as good.
    sizes = pyramid.sizes[-1:] if stages.pyramid and is_in_reach else []
    found, levels, _ = pyramid.correlate(sizes, [given], [given])
    start = MultilevelStart(found, levels=levels, notes=(NOTE_IN_REACH,))
    if not levels:
        start, found = _search_on(given, pyramid, stages)
    field = _take_at_nodes(found, given.mesh)
    left = 1 - _predict(pyramid, pyramid.finest_size, field).coefficient
    if left > BETTER * (1 - predicted.coefficient):
        kept = "start: nothing was found that explains the images better; the given displacement is kept"
        return MultilevelStart(given, warnings=start.warnings, notes=(begun, kept))
    return replace(start, notes=(begun, *start.notes))


def _search_on(given: CutField, pyramid: Pyramid, stages: StartSection) -> tuple[MultilevelStart, CoarseField]:
    """The best that is found from a given displacement, that moved on, and rest; and its field."""
    rigid = pyramid.find_rigid() if stages.rigid else None
    moved = move_on(given, pyramid.pairs[pyramid.rigid_size]) if stages.rigid else []
    candidates = _list_candidates(given, moved, rigid)
    sizes, best, is_in_reach = _choose_levels(pyramid, candidates)
    beside = [candidate.field for candidate in candidates]
    sizes = sizes if stages.pyramid else []
    matched = None
    looks = stages.rigid and stages.features
    if looks and _predict(pyramid, pyramid.rigid_size, best.field).coefficient < SURE:
        matched = pyramid.matched
    if matched is not None:
        field, levels, warnings = pyramid.correlate(sizes[-1:], [matched, *beside], beside)
        return MultilevelStart(field, (), levels, warnings, len(matched.matches.points), matched.matches.n_found,
                               (NOTE_OF_FEATURES,)), field
    starts = [best.field] if is_in_reach else [best.field, *beside]
    field, levels, warnings = pyramid.correlate(sizes, starts, beside)
    is_from_nothing = rigid is not None and any(best.field is field for field in rigid.fields)
    translations = rigid.translations if rigid is not None and is_from_nothing else ()
    note = best.note if is_in_reach else NOTE_OUT_OF_REACH
    return MultilevelStart(field, translations, levels, warnings, notes=(note,)), field


def _take_at_nodes(field: CoarseField, mesh: Mesh) -> GridField | CutField:
    """The same where it is quickly evaluated, else between the nodes of a mesh."""
    return field if isinstance(field, GridField | CutField) else CutField(mesh, field.interpolate_at_nodes(mesh))


def _predict(pyramid: Pyramid, size: int, field: GridField | CutField) -> PredictedError:
    return predict_error(pyramid.pairs[size], pyramid.mesh, field.at)


def _list_candidates(given: CutField, moved: Sequence[MovedOn], rigid: RigidStart | None) -> list[_Candidate]:
    """What may be gone on from; what is given first, so that it wins where nothing is better."""
    candidates = [_Candidate(given, NOTE_IN_REACH)]
    for one in moved:
        by = ", ".join(f"({found.shift[0]:.2f}, {found.shift[1]:.2f}) px, correlation coefficient "
                       f"{found.coefficient:.3f}" for found in one.translations)
        candidates.append(_Candidate(one.field, f"start: the given displacement moved on by {by}"))
    if rigid is not None:
        worse = ("start: the given displacement explains the images worse than a start from nothing does, and is not "
                 "used")
        candidates += [_Candidate(field, worse) for field in rigid.fields
                       if isinstance(field, GridField | CutField)]
    return candidates


def _choose_levels(pyramid: Pyramid, candidates: Sequence[_Candidate]) -> tuple[list[int], _Candidate, bool]:
    """The finest level in whose reach a candidate is, and those below it, coarsest first; all where none is.

    Beside them the candidate that is best on the first of them, or on the coarsest, and whether it is in reach.
    """
    best = candidates[0]
    for size in reversed(pyramid.sizes or [pyramid.finest_size]):
        predicted = [_predict(pyramid, size, candidate.field) for candidate in candidates]
        number = int(np.argmax([of_one.coefficient for of_one in predicted]))
        best = candidates[number]
        if predicted[number].measure_share_beyond(np.inf) <= OUT_OF_REACH:
            return [level for level in pyramid.sizes if level <= size], best, True
    return pyramid.sizes, best, False


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
    grey, pieces = _bring(given, pair)
    deformed = pair.deformed.read_whole()
    found = []
    whole = _find_shift(grey, deformed, pieces >= 0, FEWEST_BLOCKS, pair.factor)
    n_pieces = int(pieces.max(initial=-1)) + 1
    of_pieces = {}
    for piece in range(n_pieces if n_pieces > 1 else 0):
        shift = _find_shift(grey, deformed, pieces == piece, FEWEST_OF_PIECE, pair.factor)
        if shift is not None:
            of_pieces[piece] = shift
    if of_pieces:
        by_node = np.tile((0.0, 0.0) if whole is None else whole.shift, (given.mesh.n_nodes, 1))
        piece_of_node = find_piece_of_nodes(given.mesh)
        for piece, shift in of_pieces.items():
            by_node[piece_of_node == piece] = shift.shift
        found.append(MovedOn(CutField(given.mesh, given.displacement + by_node), tuple(of_pieces.values())))
    if whole is not None:
        found.append(MovedOn(CutField(given.mesh, given.displacement + np.array(whole.shift)), (whole,)))
    return found


def _find_shift(grey: Array, deformed: Array, blocks: BoolArray, fewest: float, factor: int) -> RigidShift | None:
    """Translation of some blocks, pixels; None where it does not stand out."""
    if blocks.sum() < fewest:
        return None
    found = find_rigid_shift(grey, deformed, blocks)
    return found.scale(factor) if found.coefficient >= LEAST_COEFFICIENT else None


def _bring(given: CutField, pair: BinnedPair) -> tuple[Array, IntArray]:
    """The reference image as the given displacement puts it into the deformed one, and the piece of each block."""
    before = scale_mesh(given.mesh, pair.factor)
    after = Mesh(before.nodes + given.displacement / pair.factor, before.connectivity, before.offsets, before.types)
    # Torn and folded cells would cover everything.
    kept = np.flatnonzero(_find_drawn(before, after))
    height, width = pair.reference.extent.height, pair.reference.extent.width
    pieces = np.full((height, width), -1, dtype=np.int64)
    grey = np.zeros((height, width))
    if not kept.size:
        return grey, pieces
    drawn, nodes = after.create_submesh(kept)
    y, x = np.mgrid[0:height, 0:width].astype(float)
    located = locate(drawn, np.column_stack([x.ravel(), y.ravel()]))
    inside = located.cells >= 0
    origins = interpolate_located(drawn, before.nodes[nodes], located)[inside]
    reference = pair.reference.read_whole()
    places = origins[:, ::-1].T
    grey.reshape(-1)[inside] = scipy.ndimage.map_coordinates(reference, places, order=1, mode="nearest")
    counted = np.ones(len(origins), dtype=bool)
    usable = pair.reference.find_usable(pair.reference.extent)
    if usable is not None:
        row, column = np.rint(places).astype(np.int64)
        counted = usable[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] > 0
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
