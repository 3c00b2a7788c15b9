"""A line moved, turned and bent until its sides' pixels fit the images best.

The displacement on both sides of a line is evaluated at pixels beside it, and its residual says which side each pixel
belongs to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import ConvergenceError
from ddic.functionals.line_band import BAND, list_pixels_outside
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree, find_nearest_segments, measure_distance, multiply_across
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.raster import list_pixels, rasterize
from ddic.solvers.correction_size import Tolerances
from ddic.start.coarse_displacement import CutField, LevelMesh, cut_level
from ddic.start.independent import Images, correlate_alone

FEWEST_FITTED = 100
"""Pixels below which grey levels are not corrected."""

HALO = 30
"""Pixels about a window after which a cubic spline's coefficients are those of the whole image."""


def evaluate_both_sides(cut: CutMesh, displacement: Array, number: int, points: Array,
                        others: Sequence[Array] = ()) -> tuple[Array, Array]:
    """Evaluate the displacement of the sides of a line, (n, 2) of left and right, pixels, each also beyond the line.

    ``number`` is the line's among those that cut the mesh; points lie near it, (n, 2), pixels, as the other lines,
    (n_vertices, 2) each. Both sides are found by the shape functions of the nearest cell that this line alone cuts; nan
    where another line lies between. Left is where the cross product with the line's direction is positive. Raises
    ConvergenceError where it cuts no cell.
    """
    mesh = cut.mesh
    if mesh.parts is None:
        raise ConvergenceError("the line cuts no cell of the mesh")
    # As it cuts: clear of nodes.
    line, numbers = cut.lines[number], mesh.parts.cells
    n_parts = np.bincount(cut.cell_of[numbers], minlength=int(cut.cell_of.max()) + 1)
    numbers = numbers[n_parts[cut.cell_of[numbers]] == 2]
    centres = mesh.centroids[numbers]
    heights = measure_heights(centres, line)
    # Cell by cell, the part to the right first.
    order = np.lexsort((heights, cut.cell_of[numbers]))
    pairs, low, high = numbers[order].reshape(-1, 2), heights[order][::2], heights[order][1::2]
    # Of cells that another line cuts, both parts lie on one side of this one, or farther from it.
    is_own = (low < 0) & (high > 0)
    if not is_own.any():
        raise ConvergenceError("the line cuts no cell of the mesh by itself")
    right, left = pairs[is_own].T
    middles = centres[order].reshape(-1, 2, 2).mean(axis=1)[is_own]
    nearest = build_tree(middles).query(points)[1]
    u_left, u_right = (interpolate_located(mesh, displacement, place_in_cells(mesh, cells[nearest], points))
                       for cells in (left, right))
    for other in others:
        is_beyond = measure_heights(points, other) * measure_heights(middles, other)[nearest] <= 0
        u_left[is_beyond] = u_right[is_beyond] = np.nan
    return u_left, u_right


def measure_heights(points: Array, line: Array) -> Array:
    """Measure how far points lie to the left of the nearest segment of a polyline, (n,), pixels."""
    segments, _ = find_nearest_segments(points, line)
    along = np.diff(line, axis=0)[segments]
    return np.asarray(multiply_across(along, points - line[segments]) / np.linalg.norm(along, axis=1))


def compute_residuals(images: Images, pixels: IntArray, displacement: Array) -> Array:
    """Compute f(x) - a g(x + u) - b at pixels, with one gain and offset where the images' grey levels are corrected.

    ``pixels`` are columns and rows, (n, 2), the displacement is theirs, (n, 2), pixels. Returns grey levels, (n,); nan
    where a pixel is left out of an image, or is displaced out of it.
    """
    f, g = _read_at(images.reference, pixels), _interpolate_at(images.deformed, pixels + displacement)
    return _subtract(images, f, g, np.isfinite(f - g))


def _subtract(images: Images, f: Array, g: Array, own: BoolArray) -> Array:
    """Subtract a g + b from f, (n,); gain and offset are found by ``own`` pixels, to which the displacement belongs."""
    fitted = own & np.isfinite(f - g)
    if images.correction == "none" or fitted.sum() < FEWEST_FITTED:
        return f - g
    gain, offset = np.polyfit(g[fitted], f[fitted], 1)
    return np.asarray(f - gain * g - offset)


def _read_at(source: MaskedSource, pixels: IntArray) -> Array:
    """Grey levels at pixels, (n,); nan where one lies outside, or does not count."""
    extent = source.extent
    values = np.full(len(pixels), np.nan)
    is_inside = ((pixels >= 0) & (pixels < (extent.width, extent.height))).all(axis=1)
    if not is_inside.any():
        return values
    inside = pixels[is_inside]
    window = Window.between(inside.min(axis=0), inside.max(axis=0) + 1)
    columns, rows = (inside - (window.x0, window.y0)).T
    grey, usable = source.image.read(window).astype(np.float64), source.find_usable(window)
    values[is_inside] = grey[rows, columns] if usable is None else np.where(usable, grey, np.nan)[rows, columns]
    return values


def _interpolate_at(source: MaskedSource, points: Array) -> Array:
    """Grey levels between pixels by a cubic spline, (n,); nan outside, and beside a pixel that does not count."""
    extent = source.extent
    values = np.full(len(points), np.nan)
    is_inside = ((points >= 0) & (points <= (extent.width - 1, extent.height - 1))).all(axis=1)
    if not is_inside.any():
        return values
    inside = points[is_inside]
    window = Window.between(np.floor(inside.min(axis=0)), np.ceil(inside.max(axis=0)) + 1)
    seen = window.grow(HALO).intersection(extent)
    at = inside - (seen.x0, seen.y0)
    between = scipy.ndimage.map_coordinates(source.image.read(seen).astype(np.float64), at[:, ::-1].T, order=3,
                                            mode="mirror")
    usable = source.find_usable(seen)
    if usable is not None:
        columns, rows = np.rint(at).astype(np.int64).T
        between[scipy.ndimage.minimum_filter(usable, size=3)[rows, columns] == 0] = np.nan
    values[is_inside] = between
    return values


REACH = 3.5
"""Distance from the line, elements, up to which cells are measured with it. A larger one costs more."""

SEARCHED = 3.0
"""Distance, in standard deviations of a line's place, by which its vertices may move at a time."""

STEPS = (0.5, 0.05)
"""Steps of the search for the places of vertices, pixels, one after the other."""

CUT_OFF = 4.0
"""Cut-off wavelength along the strip, elements."""

N_BINS = 256
"""Pieces along a segment in which pixels are sorted by their height: a line that turns by a pixel from end to end is
off by 1/512 px in them."""

_BINS = (np.arange(N_BINS) + 0.5) / N_BINS
"""Where they lie along a segment, from 0 to 1."""

MOST_MOVES = 8
"""Times that a line is moved; two or three are usual."""

TELLING = (0.05, 0.95)
"""Shares of what the sides differ by, along the line, between which a move counts: where they do not part, as ahead of
a tip, pixels say nothing of the line's place."""

BELIEVED = 5.0
"""Standard deviations of the residual up to which it counts: what is larger with either side's displacement, as in the
gap of an open crack, says nothing of the side."""

BLUR = 1.0
"""Pixels over which what a pixel costs is spread across the line. In a gap as narrow as that, both sides' extensions
explain what is seen: the middle is taken. A larger value rounds off what tells the place."""

_HAT = np.maximum(1.0 - np.abs(np.arange(-BLUR, BLUR + STEPS[-1] / 2, STEPS[-1])) / BLUR, 0.0)
_HAT /= _HAT.sum()

LEAST_DEVIATION = 0.01
"""Standard deviation of the residual relative to what the sides differ by, at least: images that move by whole pixels
leave none."""

TOLERANCES = Tolerances(relative=1e-12, rms=0.003, max_iterations=50, largest=np.inf)
"""Of Gauss-Newton for a line that is still moved: a hundredth of the jumps that can be found."""


@dataclass(frozen=True, eq=False)
class UncertainLine:
    """A line among others that stay, whose own place is uncertain.

    Attributes
    ----------
    among : Discontinuities
        All lines.
    number : int
        Its own.
    deviation : float
        Standard deviation of its place, pixels: how far it moves where pixels say nothing, and a third of how far it
        may at a time.
    """

    among: Discontinuities
    number: int
    deviation: float

    @property
    def vertices(self) -> Array:
        """Where it is, (n_vertices, 2), pixels."""
        return self.among.lines[self.number]

    @property
    def others(self) -> tuple[Array, ...]:
        """The other lines."""
        return (*self.among.lines[:self.number], *self.among.lines[self.number + 1:])

    @property
    def reach(self) -> float:
        """How far its vertices may move at a time, pixels."""
        return SEARCHED * self.deviation

    def move_to(self, vertices: Array) -> UncertainLine:
        """Put it elsewhere."""
        return replace(self, among=self.among.with_line(self.number, vertices))


@dataclass(frozen=True, eq=False)
class RefinedLine:
    """A line with the displacement on both sides.

    Attributes
    ----------
    line : (n_vertices, 2) array
        Pixels.
    cells : LevelMesh
        The cells about it, cut.
    displacement : (n_dofs,) array
        Of their nodes, pixels.
    n_moves : int
        How often it was moved.
    best : (n_vertices, 2) array
        Where pixels say that it lies with this displacement, hardly elsewhere, pixels.
    """

    line: Array
    cells: LevelMesh
    displacement: Array
    n_moves: int
    best: Array


@dataclass(frozen=True, eq=False)
class Move:
    """Where the pixels about a line say that it lies.

    Attributes
    ----------
    line : (n_vertices, 2) array
        There, pixels.
    distance : float
        Largest move where the sides part, pixels.
    fall : float
        Of the sum of squared residuals, in variances of the residual: noise makes 20 of it.
    """

    line: Array
    distance: float
    fall: float


def refine_line(images: Images, mesh: Mesh, start: CutField, line: UncertainLine, settled: float) -> RefinedLine:
    """Move a line until its sides' pixels fit best, each side's displacement being measured with the line where it is.

    The sides start from ``start``, continuous or not; the region's mesh is not cut. A line that moves by no more than
    ``settled``, pixels, has been found. Raises ConvergenceError where the line or the displacement does not converge,
    SingularSubdomainError where the pixels do not determine the displacement.
    """
    size = measure_cell_size(mesh)
    for n_moves in range(MOST_MOVES):
        strip, _ = mesh.create_submesh(find_strip(mesh, line.vertices, REACH * size))
        cells = cut_level(strip, line.among, images.active, images.degree)
        if cells.mesh.parts is None:
            raise ConvergenceError("the line left the mesh")
        u = correlate_alone(images, cells, CUT_OFF * size, TOLERANCES,
                            [start.interpolate_at_nodes(cells.mesh).ravel()], "the strip along a line")
        move = find_move(images, cells.cut, u.reshape(cells.mesh.nodes.shape), line)
        if move.distance <= settled:
            return RefinedLine(line.vertices, cells, u, n_moves, move.line)
        line = line.move_to(move.line)
    raise ConvergenceError(f"the line was still moving after {MOST_MOVES} rounds")


@dataclass(frozen=True)
class LineEvidence:
    """Squared residuals of some pixels without and with a line.

    Attributes
    ----------
    without_line, with_line : float
        Their sums, grey levels squared.
    n_pixels : int
        How many they are.
    n_more : float
        How many more unknowns explain them with the line.
    """

    without_line: float
    with_line: float
    n_pixels: int
    n_more: float

    @property
    def fall(self) -> float:
        """By how much the mean square falls, grey levels squared."""
        return (self.without_line - self.with_line) / max(self.n_pixels, 1)


@dataclass(frozen=True, eq=False)
class ResidualsBeside:
    """Residuals of the pixels in the cells that a line cuts, without it and with it.

    Attributes
    ----------
    pixels : (n, 2) array
        Columns and rows.
    without_line, with_line : (n,) array
        Grey levels.
    n_more : int
        How many more unknowns there are with the line.
    """

    pixels: Array
    without_line: Array
    with_line: Array
    n_more: int

    def sum(self, chosen: BoolArray) -> LineEvidence:
        """Sum the squares of some of the pixels, (n,), which have their share of the unknowns."""
        without_line, with_line = (float((residuals[chosen] ** 2).sum())
                                   for residuals in (self.without_line, self.with_line))
        n_pixels = int(chosen.sum())
        return LineEvidence(without_line, with_line, n_pixels, self.n_more * n_pixels / max(len(self.pixels), 1))


def measure_residuals(images: Images, mesh: Mesh, displacement: Array, refined: RefinedLine) -> ResidualsBeside:
    """Measure residuals in the cells that a line cuts: of a continuous field on the same strip, and with the line.

    The first is measured alike, from ``displacement``, (n_nodes, 2), pixels. The line is the only one. Raises what
    ``refine_line`` does.
    """
    size = measure_cell_size(mesh)
    strip, nodes = mesh.create_submesh(find_strip(mesh, refined.line, REACH * size))
    whole = cut_level(strip, Discontinuities(), images.active, images.degree)
    continuous = correlate_alone(images, whole, CUT_OFF * size, TOLERANCES, [displacement[nodes].ravel()],
                                 "the strip along a line")
    cut = refined.cells.cut
    if cut.mesh.parts is None:
        raise ValueError("no line cuts the mesh")
    pixels, parts = list_pixels_outside(cut.mesh, cut.mesh.parts.cells, images.degree)
    found = []
    for cells, numbers, u in ((whole, cut.cell_of[parts], continuous), (refined.cells, parts, refined.displacement)):
        placed = place_in_cells(cells.mesh, numbers, pixels.astype(np.float64))
        there = interpolate_located(cells.mesh, u.reshape(cells.mesh.nodes.shape), placed)
        found.append(compute_residuals(images, pixels, there))
    counted = np.isfinite(found[0]) & np.isfinite(found[1])
    return ResidualsBeside(pixels[counted].astype(np.float64), found[0][counted], found[1][counted],
                           refined.cells.kinematics.n_unknowns - whole.kinematics.n_unknowns)


def find_strip(mesh: Mesh, line: Array, reach: float) -> IntArray:
    """Find the cells whose centres lie within ``reach``, pixels, of a line: their sorted numbers, (n,)."""
    return np.flatnonzero(measure_distance(mesh.centroids, line) <= reach).astype(np.int64)


def find_move(images: Images, cut: CutMesh, displacement: Array, given: UncertainLine) -> Move:
    """Find the line by which the pixels about it are told best to which side they belong.

    What a pixel costs on the left beyond what it costs on the right, left^2 - right^2 of the residuals with either
    side's displacement, is summed above the line; that sum jumps from pixel to pixel, and is searched for its least
    value, not differentiated.

    ``displacement`` is that of the nodes of cells that the line cuts, among others, (n_nodes, 2), pixels; nan where it
    is not known. Raises ConvergenceError where no pixel about the line counts.
    """
    line, reach = given.vertices, given.reach
    size = measure_cell_size(cut.mesh)
    about, _ = cut.mesh.create_submesh(find_strip(cut.mesh, line, reach + 2 * size))
    pixels, _ = list_pixels(rasterize(about), np.arange(about.n_cells))
    points = pixels.astype(np.float64)
    near = measure_distance(points, line) <= reach + BAND[images.degree]
    for other in given.others:
        # Beside another line g jumps, whatever the side of this one.
        near &= measure_distance(points, other) > BAND[images.degree]
    points = points[near]
    on_left, on_right = evaluate_both_sides(cut, displacement, given.number, points, given.others)
    known = np.isfinite(on_left + on_right).all(axis=1)
    points, along, sides = points[known], np.diff(line, axis=0), []
    for u, sign in ((on_left[known], 1), (on_right[known], -1)):
        # At pixels of g, each of which shows one side alone: between them, g's spline mixes both.
        pixels = np.rint(points + u).astype(np.int64)
        came_from = pixels - u
        segments, _ = find_nearest_segments(came_from, line)
        from_start, ahead = came_from - line[segments], along[segments]
        lengths = np.linalg.norm(ahead, axis=1)
        heights = multiply_across(ahead, from_start) / lengths
        f, g = _interpolate_at(images.reference, came_from), _read_at(images.deformed, pixels)
        residual = _subtract(images, f, g, sign * heights > 0)
        sides.append((residual, segments, (from_start * ahead).sum(axis=1) / lengths**2, heights))
    (left, _, _, height), (right, *_) = sides
    counted = np.isfinite(left) & np.isfinite(right)
    if not counted.any():
        raise ConvergenceError("no pixel about the line counts")
    own = np.where(height > 0, left, right)[counted]
    difference = (left - right) ** 2
    variance = max((float(np.median(np.abs(own))) / 0.6745) ** 2,
                   LEAST_DEVIATION**2 * float(difference[counted].mean()), 1e-300)
    most = BELIEVED**2 * variance
    costs = np.concatenate([np.minimum(left[counted]**2, most), -np.minimum(right[counted]**2, most)])
    differences = np.tile(difference[counted], 2)
    segments, shares, heights = (np.concatenate([of_side[counted] for of_side in both])
                                 for both in list(zip(*sides, strict=True))[1:])
    tables = []
    for k in range(len(along)):
        mine = segments == k
        tables.append(_Segment.tabulate(costs[mine], differences[mine], shares[mine], heights[mine],
                                        (reach, k == 0, k == len(along) - 1)))
    found = _search_on_grids(tables, reach, variance / given.deviation**2)
    fall = _sum_costs(tables, np.zeros(len(found))) - _sum_costs(tables, found)
    return Move(_move_vertices(line, tables, found), _measure_distance_moved(tables, found), fall / variance)


@dataclass(frozen=True, eq=False)
class _Segment:
    """Costs of the pixels above heights, (N_BINS along a segment, n_heights), STEPS[-1] apart from -reach.

    And the squares of what its sides differ by, (N_BINS,), between its first and last place, in lengths of the segment.
    """

    costs: Array
    differences: Array
    places: tuple[float, float]
    reach: float

    @classmethod
    def tabulate(cls, cost: Array, difference: Array, shares: Array, heights: Array,
                 limits: tuple[float, bool, bool]) -> _Segment:
        """From pixels; at the ends of the line it begins and ends where they do."""
        reach, is_first, is_last = limits
        first = float(shares.min()) if is_first and len(shares) else 0.0
        last = float(shares.max()) if is_last and len(shares) else 1.0
        bins = np.clip((shares - first) / max(last - first, 1e-12), 0.0, 1.0)
        n_heights = int(np.ceil(2 * reach / STEPS[-1])) + 1
        # Sums are spread across the line with those beyond either end.
        margin = len(_HAT) // 2
        low = -reach - margin * STEPS[-1]
        high = low + (n_heights + 2 * margin) * STEPS[-1]
        within, _, _ = np.histogram2d(bins, heights, bins=(N_BINS, n_heights + 2 * margin), weights=cost,
                                      range=((0.0, 1.0), (low, high)))
        # A histogram's last bin holds its upper edge as well.
        above = heights > high
        beyond = np.histogram(bins[above], N_BINS, (0.0, 1.0), weights=cost[above])[0]
        sums = np.cumsum(within[:, ::-1], axis=1)[:, ::-1] + beyond[:, None]
        costs = scipy.ndimage.convolve1d(sums, _HAT, axis=1)[:, margin:margin + n_heights]
        differences = np.histogram(bins, N_BINS, (0.0, 1.0), weights=difference)[0]
        return cls(costs, differences, (first, last), reach)

    def sum_costs(self, ones: Array, others: Array) -> Array:
        """What the segment costs from any height at its beginning to any at its end, (n_ones, n_others)."""
        total = np.zeros((len(ones), len(others)))
        for costs, place in zip(self.costs, _BINS, strict=True):
            at = np.rint((ones[:, None] * (1 - place) + others * place + self.reach) / STEPS[-1]).astype(np.int64)
            total += costs[np.clip(at, 0, len(costs) - 1)]
        return total


def _sum_costs(segments: list[_Segment], heights: Array) -> float:
    """What a line with its ends and bends at heights costs."""
    return float(sum(segment.sum_costs(ones, others)[0, 0] for segment, (ones, others)
                     in zip(segments, pairwise(heights[:, None]), strict=True)))


def _search_on_grids(segments: list[_Segment], reach: float, stiffness: float) -> Array:
    """Heights of the ends and bends at which the line costs least, on a coarse grid and then on a fine one about it.

    Segments meet at bends: the least sum is found from one to the next.
    """
    best, around = np.zeros(len(segments) + 1), reach
    for step in STEPS:
        grid = np.arange(-around, around + step / 2, step)
        grids = best[:, None] + grid
        of_places = stiffness * grids**2
        least, came_from = of_places[0], []
        for segment, ones, others, of_place in zip(segments, grids[:-1], grids[1:], of_places[1:], strict=True):
            totals = least[:, None] + segment.sum_costs(ones, others)
            came_from.append(totals.argmin(axis=0))
            least = totals.min(axis=0) + of_place
        chosen = [int(least.argmin())]
        for origins in reversed(came_from):
            chosen.append(int(origins[chosen[-1]]))
        best, around = grids[np.arange(len(grids)), chosen[::-1]], 2 * step
    return best


def _move_vertices(line: Array, segments: list[_Segment], heights: Array) -> Array:
    """The line with its ends and bends at heights, which at its ends are those of its first and last pixels."""
    along = np.diff(line, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    moved = line.copy()
    for end, place, (one, other) in ((0, 0.0, heights[:2]), (-1, 1.0, heights[-2:])):
        first, last = segments[end].places
        moved[end] += (one + (other - one) * (place - first) / max(last - first, 1e-12)) * normals[end]
    mean = (normals[:-1] + normals[1:]) / 2
    # A segment is as far off as its bend along its own normal.
    moved[1:-1] += heights[1:-1, None] * mean / np.maximum((mean**2).sum(axis=1), 0.1)[:, None]
    return moved


def _measure_distance_moved(segments: list[_Segment], heights: Array) -> float:
    """Largest height where the sides part."""
    differences = np.concatenate([segment.differences for segment in segments])
    shares = np.cumsum(differences) / max(float(differences.sum()), 1e-300)
    at = np.concatenate([one + (other - one) * _BINS for one, other in pairwise(heights)])
    tells = (shares >= TELLING[0]) & (shares <= TELLING[1])
    return float(np.abs(at[tells]).max(initial=0.0))
