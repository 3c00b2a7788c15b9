"""Start of the displacement: rigid FFT correlation, matched features, a coarse-graining pyramid.

The first is that of [RHR08, section 3.2], the pyramid that of [BP17, section 3.2.2], features are our own.

Runs on one rank, on images binned so far that they are small whatever the camera; every other rank receives the coarse
field. A level of the pyramid is R-DIC on a square grid over binned images. From a displacement that is given the
pyramid needs some of its levels, or none; a frame that jumps needs it moved on by a translation first.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ddic.arrays import IntArray
from ddic.case.schema import StartSection
from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.rigid import GridField, RigidShift, build_uniform_field
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.solvers.gauss_newton import IterationRecord
from ddic.start.binned_pair import (
    BinnedPair,
    choose_block_sizes,
    choose_further_block_sizes,
    choose_rigid_block,
    move_mesh,
)
from ddic.start.coarse_displacement import CoarseField, CutField, KeptResult, move_field
from ddic.start.feature_matches import MatchedField, find_pieces, match_features
from ddic.start.helpers import Helpers
from ddic.start.level import LARGEST_WHOLE, NO_LINES, correlate_in_tiles, correlate_level
from ddic.start.predicted_error import PredictedError, predict_error
from ddic.start.rigid_start import RigidStart, find_rigid_start, move_on

SURE = 0.8
"""Correlation coefficient of a translation from which on nothing else is sought: the region then moves by little else.
A larger value matches features more often, which takes some tenths of a second."""

LARGEST_FOLLOWED = 4
"""Side of the largest blocks, in blocks of the finest level, on which a translation that is not sure may explain every
part of the region, so that the pyramid follows from there without features. A larger value matches features less often,
and overlooks larger deformations of small parts."""

FEWEST_SQUARES = 30
"""Squares of such blocks that have to tell. With fewer the region is small, and each of them holds much of it."""

MOST_UNEXPLAINED = 0.02
"""Share of the region that need not be explained there. A larger value overlooks larger parts that move otherwise."""

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


@dataclass(frozen=True)
class MultilevelStart:
    """A coarse field and what the user should know about how it was found.

    Attributes
    ----------
    field : GridField, CutField, MatchedField or KeptResult
        The displacement, pixels.
    rigid : tuple of RigidShift
        The translations found first, pixels: of the region where one stands out, then of pieces that lines cut it
        into.
    levels : tuple of int
        Block sizes of the pyramid's levels that were measured, pixels, coarsest first.
    warnings : tuple of str
        What did not work.
    n_matches, n_found : int
        Features by whose displacement the field was found, and all that were matched; 0 where none were.
    notes : tuple of str
        What became of a displacement that was given.
    """

    field: CoarseField | KeptResult
    rigid: tuple[RigidShift, ...] = ()
    levels: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    n_matches: int = 0
    n_found: int = 0
    notes: tuple[str, ...] = ()

    def require_field(self) -> CoarseField:
        """Give the field; raises TypeError where that is an earlier result, which is looked up instead."""
        if isinstance(self.field, KeptResult):
            raise TypeError("an earlier result that is kept is looked up where it is needed")
        return self.field

    def describe(self) -> tuple[str, ...]:
        """Say for the log how it was found."""
        shifts = [f"start: rigid shift {found.describe()}, correlation coefficient {found.coefficient:.3f}"
                  for found in self.rigid]
        lines = [*self.notes, *shifts, *self.warnings]
        if self.n_matches:
            lines.append(f"start: {self.n_matches} of {self.n_found} matched features agree with their neighbours")
        if self.levels:
            lines.append(f"start: pyramid on blocks of {', '.join(map(str, self.levels))} px")
        return tuple(lines)


def stay_silent_of_level(size: int, record: IterationRecord) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class Pyramid:
    """An image pair in blocks of several sizes, and what is measured on it.

    Attributes
    ----------
    pair : BinnedPair
        The images, binned at most as far as ``choose_finest_block`` says.
    mesh : Mesh
        The whole mesh, pixels.
    correction : GreyCorrection
        Of grey levels.
    discontinuities : Discontinuities
        Lines across which the displacement may be discontinuous, pixels.
    largest_block : float
        Side, pixels, of the largest blocks on which it is [RHR08, section 3.2].
    helpers : Helpers, optional
        Ranks that help with all pixels of the images; then levels of many blocks are correlated in tiles.
    report : callable
        Told of the block size of a level, pixels, and of each of its iterations, in blocks; by default nobody is, nor
        of levels in tiles.
    """

    pair: BinnedPair
    mesh: Mesh
    correction: GreyCorrection
    discontinuities: Discontinuities = NO_LINES
    largest_block: float = np.inf
    helpers: Helpers | None = None
    report: Callable[[int, IterationRecord], None] = stay_silent_of_level

    @cached_property
    def sizes(self) -> list[int]:
        """Block sizes of the levels, pixels, coarsest first."""
        return choose_block_sizes(self._size, self.mesh)

    @cached_property
    def further_sizes(self) -> list[int]:
        """Those of finer levels, which one rank could not correlate."""
        if self.helpers is None or self.discontinuities.lines:
            return []
        return choose_further_block_sizes(self.sizes)

    @property
    def finest_size(self) -> int:
        """Block size of the finest level, pixels; of the smallest blocks where the region is too small for a level."""
        return self.sizes[-1] if self.sizes else self.rigid_size

    @cached_property
    def rigid_size(self) -> int:
        """Side of the blocks in which a rigid translation is sought, pixels."""
        return choose_rigid_block(self._size, self.mesh)

    def read_whole(self, size: int) -> BinnedPair:
        """Read both images as a whole in blocks of ``size`` pixels, of ``sizes`` or ``rigid_size``; they are kept."""
        if size not in self._pairs:
            # At once what is correlated as a whole; smaller blocks only where features, or a given field, ask for them.
            whole = [self.rigid_size, *(each for each in self.sizes if not self._is_tiled(each))]
            wanted = whole if size in whole else [size]
            finest = self.pair if self.helpers is None else self.helpers.read_whole(min(wanted))
            self._pairs.update(finest.bin_at_sizes(wanted))
        return self._pairs[size]

    @cached_property
    def _pairs(self) -> dict[int, BinnedPair]:
        return {}

    def _is_tiled(self, size: int) -> bool:
        n_blocks = np.prod(np.ptp(self.mesh.nodes, axis=0)) / size**self.mesh.dim
        has_lines = bool(self.discontinuities.lines) and size <= self.largest_block
        return self.helpers is not None and not has_lines and n_blocks > LARGEST_WHOLE

    @property
    def _size(self) -> IntArray:
        """Size of the images along each axis, pixels."""
        return self.pair.size * self.pair.factor

    def find_rigid(self) -> RigidStart:
        """Find translations of the region and of pieces that lines cut; 0, with a warning, where nothing stands out."""
        return find_rigid_start(self.read_whole(self.rigid_size), self.mesh, self.discontinuities)

    def choose_levels_after(self, translation: CoarseField) -> list[int]:
        """Choose the levels that refine a translation, where it explains the whole region on the coarsest of them.

        Returns their block sizes, pixels, coarsest first; none where parts of the region are out of reach.
        """
        for size in self.sizes:
            if self.finest_size < size <= LARGEST_FOLLOWED * self.finest_size:
                predicted = self.predict(size, translation)
                is_told = len(predicted.n_blocks) >= FEWEST_SQUARES
                if is_told and predicted.measure_share_beyond(np.inf) <= MOST_UNEXPLAINED:
                    return [level for level in self.sizes if level <= size]
        return []

    @cached_property
    def matched(self) -> MatchedField | None:
        """A field through features that were found again; None where they do not agree with each other."""
        region = cut_mesh(self.mesh, self.discontinuities.lines).mesh
        pieces = find_pieces(region)
        matches = match_features(self.read_whole(min([*self.sizes, self.rigid_size])), region, pieces)
        return MatchedField(matches, region, pieces) if matches.agree else None

    def predict(self, size: int, field: CoarseField) -> PredictedError:
        """Predict the error of a field in blocks of ``size`` pixels."""
        return predict_error(self.read_whole(size), self.mesh, field.at)

    def correlate(self, sizes: Sequence[int], starts: Sequence[CoarseField],
                  beside: Sequence[CoarseField]) -> MultilevelStart:
        """Correlate levels of some block sizes, coarsest first, each from what the one before found.

        Gives the field of the finest level that worked, or the first start.

        The best of ``starts``, at least one, starts the first level. ``beside`` is what a level may start from beside
        what the one before found: a coarse level of a ragged region may have gone astray, and the residual of the next
        one tells.
        """
        first, done, warnings = starts[0], [], []
        for size in (*sizes, *(self.further_sizes if sizes else ())):
            try:
                field, of_level = self._correlate_level(size, starts)
            except (ConvergenceError, SingularSubdomainError) as error:
                warnings.append(f"start: the pyramid's level with blocks of {size} px was left out ({error})")
            else:
                starts = (field, *beside)
                done.append(size)
                warnings += of_level
        found = MultilevelStart(starts[0], levels=tuple(done), warnings=tuple(warnings))
        if isinstance(first, MatchedField):
            return replace(found, n_matches=len(first.matches.points), n_found=first.matches.n_found)
        return found

    def _correlate_level(self, size: int, starts: Sequence[CoarseField]) -> tuple[CoarseField, list[str]]:
        """The field of one level, and warnings."""
        if self.helpers is None or not self._is_tiled(size):
            lines = self.discontinuities if size <= self.largest_block else NO_LINES
            return correlate_level(self.read_whole(size), self.mesh, starts, self.correction, lines,
                                   partial(self.report, size)), []
        level = correlate_in_tiles(self.helpers, size, self.mesh, starts, self.correction)
        warnings = []
        if level.errors:
            warnings.append(f"start: {len(level.errors)} of {level.n_tiles} parts of the pyramid's level with blocks "
                            f"of {size} px stay as they began ({level.errors[0]})")
        return level.field, warnings


def find_multilevel_start(pyramid: Pyramid, stages: StartSection) -> MultilevelStart:
    """Find a coarse field on the region: that of the finest level that worked, by the stages that are asked for."""
    sizes = pyramid.sizes if stages.pyramid else []
    at_rest = RigidStart((build_uniform_field((0.0,) * pyramid.mesh.dim),), (), 1.0, ())
    rigid_start = pyramid.find_rigid() if stages.rigid else at_rest
    matched, warnings = None, rigid_start.warnings
    starts: tuple[CoarseField, ...] = rigid_start.fields
    # Volumes are smoothed before, so that small regions look alike farther off than their mesh follows.
    is_sure = rigid_start.coefficient >= SURE and (pyramid.mesh.dim == 2 or bool(pyramid.sizes))
    if stages.features and not is_sure:
        followed = pyramid.choose_levels_after(starts[0]) if sizes and rigid_start.translations else []
        finer = None if followed else _search_surroundings(pyramid, rigid_start, stages)
        if finer is not None:
            return finer
        sizes, matched = followed or sizes, None if followed else pyramid.matched
    if matched is None:
        found = pyramid.correlate(sizes, starts, rigid_start.fields)
    else:
        warnings = ()
        found = _correlate_from_features(pyramid, sizes, (matched, *starts), rigid_start.fields)
    return replace(found, rigid=rigid_start.translations, warnings=(*warnings, *found.warnings))


def _correlate_from_features(pyramid: Pyramid, sizes: Sequence[int], starts: Sequence[CoarseField],
                             beside: Sequence[CoarseField]) -> MultilevelStart:
    """The finest level from features, which finds everything there; coarser ones would smooth it.

    In a corner without features it may not find its way: the level before it has larger blocks, hence a longer reach.
    """
    found = pyramid.correlate(sizes[-1:], starts, beside)
    matched = starts[0]
    if found.levels and pyramid.mesh.dim == 3 and isinstance(matched, MatchedField):
        # Cells hold together what parts, unless a line cuts them, and none does in a volume.
        share = matched.measure_share_against(found.require_field().at(matched.matches.points), sizes[-1])
        return found if share <= WRONG_SHARE else replace(found, field=matched, levels=())
    if len(sizes) < 2 or sizes[-1] in found.levels:
        return found
    from_larger = pyramid.correlate(sizes[-2:], starts, beside)
    if sizes[-1] not in from_larger.levels:
        return found
    # Where a specimen has torn, larger blocks lose more than they find, and features know best.
    lost, lost_by_features = (pyramid.predict(sizes[-2], field).measure_share_beyond(np.inf)
                              for field in (from_larger.require_field(), starts[0]))
    return from_larger if lost <= lost_by_features else found


def _search_surroundings(pyramid: Pyramid, rigid_start: RigidStart, stages: StartSection) -> MultilevelStart | None:
    """The same in smaller blocks of what surrounds a small region; None where they are no smaller or show nothing."""
    pixels = pyramid.pair.pixels
    if pixels is None or not pixels.can_bin_finer(pyramid.mesh):
        return None
    translation = np.zeros(pyramid.mesh.dim)
    if rigid_start.translations:
        translation = np.array(rigid_start.translations[0].shift)
    elif pyramid.matched is not None:
        translation = pyramid.matched.matches.displacement.mean(axis=0)
    seen = pixels.bin_surroundings(pyramid.mesh, translation)
    moved = replace(pyramid, pair=seen.pair, mesh=move_mesh(pyramid.mesh, -seen.origin),
                    discontinuities=pyramid.discontinuities.scale(seen.origin, 1.0), helpers=None)
    try:
        found = find_multilevel_start(moved, stages)
    except ConvergenceError:
        # What repeats itself in smaller blocks may not on the whole image.
        return None
    if stages.pyramid and not found.levels:
        return None
    rigid = tuple(replace(one, shift=tuple((one.shift + seen.translation).tolist())) for one in found.rigid)
    return replace(found, field=move_field(found.require_field(), seen.origin, seen.translation), rigid=rigid,
                   notes=(seen.describe(), *found.notes))


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A displacement that may be gone on from, what the log says where it is, and translations from rest to it."""

    field: GridField | CutField
    note: str
    rigid: tuple[RigidShift, ...] = ()


def find_start_from_given(given: CutField, pyramid: Pyramid, stages: StartSection) -> MultilevelStart:
    """Find a coarse field from a displacement that is given on the mesh of the region.

    Where the images bear it out, nothing is searched; where it is in reach of the finest level, that one follows. Else
    it is moved on by a translation; where neither explains the images, nor a translation from rest, features are
    matched; then come the levels of the pyramid in whose reach the best of them is. A displacement that explains the
    images worse than a start from nothing does is not used. The field is ``given`` itself where it is kept.
    """
    predicted = pyramid.predict(pyramid.finest_size, given)
    share = predicted.measure_share_beyond(RIGHT_PX)
    if share <= WRONG_SHARE:
        return MultilevelStart(given)
    begun = (f"start: that is off by more than {RIGHT_PX:g} px on {share:.0%} of the region (correlation coefficient "
             f"{predicted.coefficient:.2f}); searching on")
    is_in_reach = predicted.measure_share_beyond(np.inf) <= WRONG_SHARE
    # Then nothing else is looked at: on a repetitive texture another translation would look as good.
    sizes = pyramid.sizes[-1:] if stages.pyramid and is_in_reach else []
    found = replace(pyramid.correlate(sizes, [given], [given]), notes=(NOTE_IN_REACH,))
    if not found.levels:
        found = _search_on(given, pyramid, stages)
    field = found.require_field()
    if not isinstance(field, GridField | CutField):
        # At nodes once, for others take long at points.
        field = CutField(given.mesh, field.interpolate_at_nodes(given.mesh))
    left = 1 - pyramid.predict(pyramid.finest_size, field).coefficient
    if left > BETTER * (1 - predicted.coefficient):
        kept = "start: nothing was found that explains the images better; the given displacement is kept"
        return MultilevelStart(given, warnings=found.warnings, notes=(begun, kept))
    return replace(found, notes=(begun, *found.notes))


def _search_on(given: CutField, pyramid: Pyramid, stages: StartSection) -> MultilevelStart:
    """The best that is found from a given displacement, that moved on, and rest."""
    candidates = _list_candidates(given, pyramid, stages)
    sizes, best, is_in_reach = _choose_levels(pyramid, candidates)
    beside = [candidate.field for candidate in candidates]
    sizes = sizes if stages.pyramid else []
    matches = stages.rigid and stages.features and pyramid.predict(pyramid.rigid_size, best.field).coefficient < SURE
    if matches and pyramid.matched is not None:
        found = _correlate_from_features(pyramid, sizes, [pyramid.matched, *beside], beside)
        return replace(found, notes=(NOTE_OF_FEATURES,))
    found = pyramid.correlate(sizes, [best.field] if is_in_reach else [best.field, *beside], beside)
    return replace(found, rigid=best.rigid, notes=(best.note if is_in_reach else NOTE_OUT_OF_REACH,))


def _list_candidates(given: CutField, pyramid: Pyramid, stages: StartSection) -> list[_Candidate]:
    """What may be gone on from; what is given first, so that it wins where nothing is better."""
    candidates = [_Candidate(given, NOTE_IN_REACH)]
    if not stages.rigid:
        return candidates
    rigid = pyramid.find_rigid()
    for moved in move_on(given, pyramid.read_whole(pyramid.rigid_size)):
        by = ", ".join(f"{found.describe()}, correlation coefficient {found.coefficient:.3f}"
                       for found in moved.translations)
        candidates.append(_Candidate(moved.field, f"start: the given displacement moved on by {by}"))
    worse = "start: the given displacement explains the images worse than a start from nothing does, and is not used"
    return candidates + [_Candidate(field, worse, rigid.translations) for field in rigid.fields]


def _choose_levels(pyramid: Pyramid, candidates: Sequence[_Candidate]) -> tuple[list[int], _Candidate, bool]:
    """The finest level in whose reach a candidate is, and those below it, coarsest first; all where none is.

    Beside them the candidate that is best on the first of them, or on the coarsest, and whether it is in reach.
    """
    best = candidates[0]
    for size in reversed(pyramid.sizes or [pyramid.finest_size]):
        predicted = [pyramid.predict(size, candidate.field) for candidate in candidates]
        number = int(np.argmax([of_one.coefficient for of_one in predicted]))
        best = candidates[number]
        if predicted[number].measure_share_beyond(np.inf) <= OUT_OF_REACH:
            return [level for level in pyramid.sizes if level <= size], best, True
    return pyramid.sizes, best, False
