"""The pyramid from a displacement that is given: which levels it needs, and whether it needs any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.grid_field import GridField
from ddic.start.coarse_displacement import CoarseField
from ddic.start.cut_field import CutField
from ddic.start.moved_on import MovedOn, move_on
from ddic.start.multilevel import SURE, MultilevelStart, Pyramid, Stages
from ddic.start.predicted_error import PredictedError, predict_error
from ddic.start.rigid_start import RigidStart

Array = NDArray[np.float64]

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


OUT_OF_REACH_NOTE = ("start: neither the given displacement nor a translation is in reach of a level of the pyramid; "
                     "all levels are taken, from the best of them")


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A displacement that may be gone on from, and what the log says where it is."""

    field: GridField | CutField
    note: str


def find_start_from_given(given: CutField, pyramid: Pyramid, stages: Stages) -> MultilevelStart:
    """Find a coarse field from a given displacement.

    Where the images bear it out, nothing is searched. Else it is moved on by a translation; where neither explains the
    images, nor a translation from rest, features are matched; then come the levels of the pyramid in whose reach the
    best of them is. A displacement that explains the images worse than a start from nothing does is not used.

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
    finest = pyramid.finest_size
    predicted = _predict(pyramid, finest, given)
    share = predicted.measure_share_beyond(RIGHT_PX)
    if share <= WRONG_SHARE:
        return MultilevelStart(given, (), (), ())
    begun = (f"start: that is off by more than {RIGHT_PX:g} px on {share:.0%} of the region (correlation coefficient "
             f"{predicted.coefficient:.2f}); searching on")
    rigid = pyramid.find_rigid() if stages.rigid else None
    moved = move_on(given, pyramid.pairs[pyramid.rigid_size]) if stages.rigid else []
    candidates = _list_candidates(given, moved, rigid)
    sizes, best = _choose_levels(pyramid, candidates)
    is_in_reach = sizes is not None
    sizes = pyramid.sizes if sizes is None else sizes
    matched = None
    if stages.features and _predict(pyramid, pyramid.rigid_size, best.field).coefficient < SURE:
        matched = pyramid.match()
    fields: list[CoarseField] = [candidate.field for candidate in candidates]
    starts: list[CoarseField] = [best.field] if is_in_reach else [best.field, *fields]
    note = best.note if is_in_reach else OUT_OF_REACH_NOTE
    if matched is not None:
        starts, sizes, note = [matched, *fields], sizes[-1:], "start: features match; the given displacement is not used"
    found = pyramid.correlate(sizes if stages.pyramid else [], starts, fields)
    is_from_nothing = rigid is not None and any(best.field is field for field in rigid.fields)
    translations = rigid.translations if rigid is not None and is_from_nothing else ()
    n_matches, n_found = (0, 0) if matched is None else (len(matched.matches.points), matched.matches.n_found)
    notes = (begun, note)
    if _is_no_better(pyramid, finest, found.field, predicted):
        return MultilevelStart(given, (), (), (), notes=(
            begun, "start: nothing was found that explains the images better; the given displacement is kept"))
    return MultilevelStart(found.field, translations, found.levels, found.warnings, n_matches, n_found, notes)


def _predict(pyramid: Pyramid, size: int, field: GridField | CutField) -> PredictedError:
    return predict_error(pyramid.pairs[size], pyramid.mesh, field.at)


def _list_candidates(given: CutField, moved: Sequence[MovedOn], rigid: RigidStart | None) -> list[_Candidate]:
    """What may be gone on from; what is given first, so that it wins where nothing is better."""
    candidates = [_Candidate(given, "start: the pyramid goes on from it")]
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


def _choose_levels(pyramid: Pyramid, candidates: Sequence[_Candidate]) -> tuple[list[int] | None, _Candidate]:
    """Block sizes of the levels to take, coarsest first, and the candidate that is best on the first of them.

    None where all candidates are out of reach of all levels.
    """
    best = candidates[0]
    for size in reversed(pyramid.sizes or [pyramid.finest_size]):
        predicted = [_predict(pyramid, size, candidate.field) for candidate in candidates]
        number = int(np.argmax([of_one.coefficient for of_one in predicted]))
        best = candidates[number]
        if predicted[number].measure_share_beyond(np.inf) <= OUT_OF_REACH:
            return [level for level in pyramid.sizes if level <= size], best
    return None, best


def _is_no_better(pyramid: Pyramid, size: int, field: CoarseField, of_given: PredictedError) -> bool:
    """Whether a field explains the images hardly better than the given one."""
    # Features that agree with each other are believed.
    if not isinstance(field, GridField | CutField):
        return False
    found = _predict(pyramid, size, field)
    return bool(1 - found.coefficient > BETTER * (1 - of_given.coefficient))
