"""The pyramid from a displacement that is given: which levels it needs, and whether it needs any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddic.images.grid_field import GridField
from ddic.mesh.mesh import Mesh
from ddic.start.coarse_displacement import CoarseField
from ddic.start.cut_field import CutField
from ddic.start.moved_on import MovedOn, move_on
from ddic.start.multilevel import SURE, Correlated, MultilevelStart, Pyramid, Stages
from ddic.start.predicted_error import PredictedError, predict_error
from ddic.start.rigid_start import RigidStart

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


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A displacement that may be gone on from, and what the log says where it is."""

    field: GridField | CutField
    note: str


@dataclass(frozen=True, eq=False)
class _Choice:
    """Levels to take, coarsest first, and the candidate that is best on the first of them, or on the coarsest."""

    sizes: list[int]
    best: _Candidate
    in_reach: bool


def find_start_from_given(given: CutField, pyramid: Pyramid, stages: Stages) -> MultilevelStart:
    """Find a coarse field from a given displacement.

    Where the images bear it out, nothing is searched; where it is in reach of the finest level, that one follows. Else
    it is moved on by a translation; where neither explains the images, nor a translation from rest, features are
    matched; then come the levels of the pyramid in whose reach the best of them is. A displacement that explains the
    images worse than a start from nothing does is not used.

    Parameters
    ----------
    given : CutField
        On the mesh of the region, pixels.
    pyramid : Pyramid
        The images and the region.
    stages : Stages
        Which stages are taken.

    Returns
    -------
    MultilevelStart
        The field is ``given`` itself where it is kept.
    """
    predicted = _predict(pyramid, pyramid.finest_size, given)
    share = predicted.measure_share_beyond(RIGHT_PX)
    if share <= WRONG_SHARE:
        return MultilevelStart(given, (), (), ())
    begun = (f"start: that is off by more than {RIGHT_PX:g} px on {share:.0%} of the region (correlation coefficient "
             f"{predicted.coefficient:.2f}); searching on")
    is_in_reach = predicted.measure_share_beyond(np.inf) <= WRONG_SHARE
    # Then nothing else is looked at: on a repetitive texture another translation would look as good.
    found = pyramid.correlate(pyramid.sizes[-1:] if stages.pyramid and is_in_reach else [], [given], [given])
    start = MultilevelStart(found.field, (), found.levels, (), notes=(NOTE_IN_REACH,))
    if not found.levels:
        start, found = _search_on(given, pyramid, stages)
    field = _take_at_nodes(found.field, given.mesh)
    left = 1 - _predict(pyramid, pyramid.finest_size, field).coefficient
    if left > BETTER * (1 - predicted.coefficient):
        kept = "start: nothing was found that explains the images better; the given displacement is kept"
        return MultilevelStart(given, (), (), start.warnings, notes=(begun, kept))
    return replace(start, notes=(begun, *start.notes))


def _search_on(given: CutField, pyramid: Pyramid, stages: Stages) -> tuple[MultilevelStart, Correlated]:
    """The best that is found from a given displacement, that moved on, and rest."""
    rigid = pyramid.find_rigid() if stages.rigid else None
    moved = move_on(given, pyramid.pairs[pyramid.rigid_size]) if stages.rigid else []
    candidates = _list_candidates(given, moved, rigid)
    choice = _choose_levels(pyramid, candidates)
    beside = [candidate.field for candidate in candidates]
    sizes = choice.sizes if stages.pyramid else []
    matched = None
    looks = stages.rigid and stages.features
    if looks and _predict(pyramid, pyramid.rigid_size, choice.best.field).coefficient < SURE:
        matched = pyramid.matched
    if matched is not None:
        found = pyramid.correlate(sizes[-1:], [matched, *beside], beside)
        return MultilevelStart(found.field, (), found.levels, found.warnings, len(matched.matches.points),
                               matched.matches.n_found, (NOTE_OF_FEATURES,)), found
    starts = [choice.best.field] if choice.in_reach else [choice.best.field, *beside]
    found = pyramid.correlate(sizes, starts, beside)
    is_from_nothing = rigid is not None and any(choice.best.field is field for field in rigid.fields)
    translations = rigid.translations if rigid is not None and is_from_nothing else ()
    note = choice.best.note if choice.in_reach else NOTE_OUT_OF_REACH
    return MultilevelStart(found.field, translations, found.levels, found.warnings, notes=(note,)), found


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


def _choose_levels(pyramid: Pyramid, candidates: Sequence[_Candidate]) -> _Choice:
    """The finest level in whose reach a candidate is, and those below it; all where none is."""
    best = candidates[0]
    for size in reversed(pyramid.sizes or [pyramid.finest_size]):
        predicted = [_predict(pyramid, size, candidate.field) for candidate in candidates]
        number = int(np.argmax([of_one.coefficient for of_one in predicted]))
        best = candidates[number]
        if predicted[number].measure_share_beyond(np.inf) <= OUT_OF_REACH:
            return _Choice([level for level in pyramid.sizes if level <= size], best, in_reach=True)
    return _Choice(pyramid.sizes, best, in_reach=False)
