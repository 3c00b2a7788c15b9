"""Start of the displacement: rigid FFT correlation, matched features, a coarse-graining pyramid.

The first is that of [RHR08, section 3.2], the pyramid that of [BP17, section 3.2.2], features are our own.

Runs on one rank, on images binned so far that they are small whatever the camera; every other rank receives the coarse
field. What surrounds a small region is looked at in smaller blocks. A level of the pyramid is R-DIC on a square grid
over binned images.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.case.schema import StartSection
from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.binned import bin_image, bin_window, join_blocks
from ddic.images.rigid import RigidShift, build_uniform_field
from ddic.images.window import Window
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.solvers.correction_size import Tolerances
from ddic.start.binned_pair import (
    CELL,
    BinnedPair,
    build_grid,
    choose_block_sizes,
    choose_finest_block,
    choose_rigid_block,
    find_active_blocks,
    find_finest_level,
    scale_mesh,
)
from ddic.start.coarse_displacement import (
    CoarseField,
    CutField,
    KeptResult,
    cut_level,
    evaluate_at_nodes,
    move_field,
    move_mesh,
    scale_to_pixels,
)
from ddic.start.feature_matches import MatchedField, find_pieces, match_features
from ddic.start.independent import Images, correlate_alone
from ddic.start.predicted_error import predict_error
from ddic.start.rigid_start import RigidStart, find_rigid_start

CUT_OFF = 4.0 * CELL
"""Cut-off wavelength of a level, blocks. A larger value finds smoother fields, and strays less where texture is
poor."""

DEGREE = 3
"""Of the splines between blocks."""

TOLERANCES = Tolerances(relative=1e-12, rms=0.01, max_iterations=30, largest=np.inf)
"""Of Gauss-Newton on a level: the RMS of a correction, in blocks, decides."""


def correlate_level(pair: BinnedPair, mesh: Mesh, starts: Sequence[CoarseField], correction: GreyCorrection,
                    discontinuities: Discontinuities) -> CoarseField:
    """Correlate one level from the best of some starts; displacements, the whole mesh and the lines are in pixels.

    Of ``starts``, at least one, that of least residual is taken; ``discontinuities`` cut the level's grid. Raises
    ConvergenceError where Gauss-Newton does not converge, SingularSubdomainError where the blocks do not determine the
    displacement.
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

MARGIN = 0.5
"""What is seen around the region, times its longer side: it may turn by any angle about its middle, and grow by two
thirds beside what the translation takes. A larger value finds larger motions, in larger blocks."""


@dataclass(frozen=True)
class LinesOnLevels:
    """Lines across which the displacement may be discontinuous, and from which level on [RHR08, section 3.2].

    Attributes
    ----------
    discontinuities : Discontinuities
        Pixels.
    largest_block : float
        Side, pixels, of the largest blocks on which displacements are discontinuous.
    """

    discontinuities: Discontinuities
    largest_block: float

    def choose_lines(self, size: int) -> Discontinuities:
        """Give the lines of a level with blocks of ``size`` pixels: all, or none."""
        return self.discontinuities if size <= self.largest_block else Discontinuities()


NO_LINES = LinesOnLevels(Discontinuities(), np.inf)


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
    lines : LinesOnLevels
        Discontinuities of the displacement.
    """

    pair: BinnedPair
    mesh: Mesh
    correction: GreyCorrection
    lines: LinesOnLevels = NO_LINES

    @cached_property
    def sizes(self) -> list[int]:
        """Block sizes of the levels, pixels, coarsest first."""
        return choose_block_sizes(self._n_pixels, self.mesh)

    @property
    def finest_size(self) -> int:
        """Block size of the finest level, pixels; of the smallest blocks where the region is too small for a level."""
        return self.sizes[-1] if self.sizes else min(self.pairs)

    @cached_property
    def rigid_size(self) -> int:
        """Side of the blocks in which a rigid translation is sought, pixels."""
        return choose_rigid_block(self._n_pixels, self.mesh)

    @cached_property
    def pairs(self) -> dict[int, BinnedPair]:
        """Both images at all block sizes."""
        return _binned_pairs(self.pair, [*self.sizes, self.rigid_size])

    @property
    def _n_pixels(self) -> int:
        return self.pair.n_blocks * self.pair.factor**2

    def find_rigid(self) -> RigidStart:
        """Find the translation of the region, and of each piece that lines cut it into.

        It is at rest, with a warning, where nothing stands out.
        """
        return find_rigid_start(self.pairs[self.rigid_size], self.mesh, self.lines.discontinuities)

    def choose_levels_after(self, translation: CoarseField) -> list[int]:
        """Choose the levels that refine a translation, where it explains the whole region on the coarsest of them.

        Returns their block sizes, pixels, coarsest first; none where parts of the region are out of reach.
        """
        for size in self.sizes:
            if self.finest_size < size <= LARGEST_FOLLOWED * self.finest_size:
                predicted = predict_error(self.pairs[size], self.mesh, translation.at)
                is_told = len(predicted.n_blocks) >= FEWEST_SQUARES
                if is_told and predicted.measure_share_beyond(np.inf) <= MOST_UNEXPLAINED:
                    return [level for level in self.sizes if level <= size]
        return []

    @cached_property
    def matched(self) -> MatchedField | None:
        """A field through features that were found again; None where they do not agree with each other."""
        region = cut_mesh(self.mesh, self.lines.discontinuities.lines).mesh
        pieces = find_pieces(region)
        matches = match_features(self.pairs[min(self.pairs)], region, pieces)
        return MatchedField(matches, region, pieces) if matches.agree else None

    def correlate(self, sizes: Sequence[int], starts: Sequence[CoarseField], beside: Sequence[CoarseField],
                  ) -> tuple[CoarseField, tuple[int, ...], tuple[str, ...]]:
        """Correlate levels of some block sizes, coarsest first, each from what the one before found.

        Gives the field of the finest level that worked, or the first start, the block sizes of the levels that worked,
        and what did not work.

        The best of ``starts``, at least one, starts the first level. ``beside`` is what a level may start from beside
        what the one before found: a coarse level of a ragged region may have gone astray, and the residual of the next
        one tells.
        """
        done, warnings = [], []
        for size in sizes:
            try:
                field = correlate_level(self.pairs[size], self.mesh, starts, self.correction,
                                        self.lines.choose_lines(size))
            except (ConvergenceError, SingularSubdomainError) as error:
                warnings.append(f"start: the pyramid's level with blocks of {size} px was left out ({error})")
            else:
                starts = (field, *beside)
                done.append(size)
        return starts[0], tuple(done), tuple(warnings)


def find_multilevel_start(pyramid: Pyramid, stages: StartSection) -> MultilevelStart:
    """Find a coarse field on the region: that of the finest level that worked, by the stages that are asked for."""
    sizes = pyramid.sizes if stages.pyramid else []
    at_rest = RigidStart((build_uniform_field((0.0, 0.0)),), (), 1.0, ())
    rigid_start = pyramid.find_rigid() if stages.rigid else at_rest
    matched, warnings, starts = None, rigid_start.warnings, rigid_start.fields
    if stages.features and rigid_start.coefficient < SURE:
        followed = pyramid.choose_levels_after(starts[0]) if sizes and rigid_start.translations else []
        finer = None if followed else _search_surroundings(pyramid, rigid_start, stages)
        if finer is not None:
            return finer
        sizes, matched = followed or sizes, None if followed else pyramid.matched
    if matched is not None:
        # From there the finest level finds everything, and coarser ones would smooth it.
        starts, sizes, warnings = (matched, *starts), sizes[-1:], ()
    field, levels, left_out = pyramid.correlate(sizes, starts, rigid_start.fields)
    n_matches, n_found = (0, 0) if matched is None else (len(matched.matches.points), matched.matches.n_found)
    return MultilevelStart(field, rigid_start.translations, levels, (*warnings, *left_out), n_matches, n_found)


def _search_surroundings(pyramid: Pyramid, rigid_start: RigidStart, stages: StartSection) -> MultilevelStart | None:
    """The same in smaller blocks of what surrounds a small region; None where they are no smaller or show nothing."""
    pixels = pyramid.pair.pixels
    if pixels is None or not can_bin_finer(pixels, pyramid.mesh):
        return None
    translation = np.zeros(2)
    if rigid_start.translations:
        translation = np.array(rigid_start.translations[0].shift)
    elif pyramid.matched is not None:
        translation = pyramid.matched.matches.displacement.mean(axis=0)
    seen = bin_surroundings(pixels, pyramid.mesh, translation)
    lines = replace(pyramid.lines, discontinuities=pyramid.lines.discontinuities.scale(seen.origin, 1.0))
    mesh = move_mesh(pyramid.mesh, -seen.origin)
    try:
        found = find_multilevel_start(Pyramid(seen.pair, mesh, pyramid.correction, lines), stages)
    except ConvergenceError:
        # What repeats itself in smaller blocks may not on the whole image.
        return None
    if stages.pyramid and not found.levels:
        return None
    rigid = tuple(replace(one, shift=(one.shift[0] + seen.translation[0], one.shift[1] + seen.translation[1]))
                  for one in found.rigid)
    return replace(found, field=move_field(found.field, seen.origin, seen.translation), rigid=rigid,
                   notes=(seen.describe(), *found.notes))


def _binned_pairs(pair: BinnedPair, sizes: Iterable[int]) -> dict[int, BinnedPair]:
    """Both images at all block sizes (powers of 2), each binned from the one before."""
    pairs: dict[int, BinnedPair] = {}
    finer = pair
    for size in sorted(set(sizes)):
        ratio = size // finer.factor
        finer = BinnedPair(bin_image(finer.reference, ratio), bin_image(finer.deformed, ratio), size)
        pairs[size] = finer
    return pairs


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Parts of both images, of the same size, that show a region and what is around it.

    Attributes
    ----------
    pair : BinnedPair
        The parts, positions counted from where each begins.
    origin, translation : (2,) array
        Where the reference image's part begins, and where the deformed image's part begins from there, pixels.
    """

    pair: BinnedPair
    origin: Array
    translation: Array

    def describe(self) -> str:
        """Say for the log what is looked at."""
        x, y = self.origin
        width, height = (n * self.pair.factor for n in (self.pair.reference.image.width,
                                                        self.pair.reference.image.height))
        return (f"start: the region and what surrounds it, {width} x {height} px from ({x:.0f}, {y:.0f}) px on, in "
                f"blocks of {self.pair.factor} px")


def can_bin_finer(pixels: BinnedPair, mesh: Mesh) -> bool:
    """Tell whether what surrounds a region is so small that the pyramid has finer levels there than on whole images."""
    size = _find_size(pixels)
    return find_finest_level(int(_find_extent(size, mesh).prod())) < find_finest_level(int(size.prod()))


def bin_surroundings(pixels: BinnedPair, mesh: Mesh, translation: Array) -> Surroundings:
    """Bin what surrounds a region, in blocks as small as those of an image of that size.

    ``translation``, (2,), pixels, is about that of the region.
    """
    size = _find_size(pixels)
    extent = _find_extent(size, mesh)
    factor = choose_finest_block(int(extent.prod()))
    extent -= extent % factor
    middle = (mesh.nodes.min(axis=0) + mesh.nodes.max(axis=0)) / 2
    origin, moved = (np.clip(np.rint(place - extent / 2).astype(int), 0, size - extent)
                     for place in (middle, middle + translation))
    parts = [join_blocks(source, [bin_window(source, factor, Window(*begin, *(begin + extent)))])
             for source, begin in ((pixels.reference, origin), (pixels.deformed, moved))]
    return Surroundings(BinnedPair(parts[0], parts[1], factor), origin.astype(float), (moved - origin).astype(float))


def _find_size(pixels: BinnedPair) -> IntArray:
    """Width and height of both images, pixels."""
    return np.array([pixels.reference.image.width, pixels.reference.image.height])


def _find_extent(size: IntArray, mesh: Mesh) -> IntArray:
    """Width and height of what is seen of an image, pixels."""
    sides = np.ptp(mesh.nodes, axis=0)
    return np.minimum(np.ceil(sides + 2 * MARGIN * sides.max()).astype(int), size)
