"""The lines that a case asks for, looked for in its images: up to three, straight, bent, or ending at one another.

Where a line is, the strain of a continuous field stands out in a straight band [RHR08]. Bands are looked for one after
the other, each without the cells about those before. A line in each is refined without the cells about the others, and
kept as far as the images speak for it, piece by piece between the others: what is left of two that end at each other is
bent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.detection.lines_of_case import UNMEASURABLE, fill_unmeasured, view_first_camera
from ddic.detection.refine_line import (
    LineEvidence,
    RefinedLine,
    ResidualsBeside,
    UncertainLine,
    measure_residuals,
    refine_line,
)
from ddic.detection.strain_band import RadonTransform, StandingOut, StrainBand, compute_tresca_strain
from ddic.errors import ConvergenceError
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.kinematics.enriched import Discontinuities, Opening
from ddic.kinematics.strain import compute_strain
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import measure_distance, multiply_across
from ddic.mesh.quality import measure_cell_size
from ddic.start.coarse_displacement import CutField
from ddic.start.independent import Images

MOST_LINES, MOST_BANDS = 3, 6
"""Lines, and bands of strain, that are looked for."""

LEAST_SCORE = 8.0
"""Score of a band of strain from which on a line is looked for there: noise alone reaches 5. A larger one misses small
jumps."""

ABOUT = 3.0
"""Distance from a band, elements, up to which cells are no longer looked at: what elements smear of a jump fades over
three of them. A line that runs along another one nearer than that is not found."""

TIMES_CHANCE = 3.0
"""How often a line must lower the sum of squared residuals by what its unknowns would lower it by chance. A larger one
misses small jumps, a smaller one takes what elements do not resolve for a line."""

LEAST_SHARE = 0.01
"""Of the fall of squared residuals by a pixel of a line's best piece, that another piece must have: a tenth of its
jump. Beyond a bend, elements smear a little of what opens beside."""

OUTLIERS = 5.0
"""Standard deviations by which chance may exceed its mean."""

UNCERTAIN = 0.2
"""Standard deviation of the place of a band of strain, elements: of what a Radon transform may be off."""

STILL = 0.11
"""Pixels: a line that moves by no more has been found: two of the finer steps of its search, within which noise lets it
waver."""

ASIDE = (1.5, 2.0, 2.5)
"""Distances from a line, elements, up to which cells do not tell where another one lies, and which of its pieces open:
elements smear there what opens beside. The next is tried where the first leaves parts of cells too small to be
measured. A larger one cuts off short pieces at the edge."""

BEYOND = 0.5
"""Pixels by which a line that ends at another one goes on: it cuts the cells up to there from side to side."""

NOT_SOUGHT = ("not looked for: curved lines, lines that bend where no other begins, ends inside the region that are at "
              "no other line (a crack's tip), lines along another one within three elements; give "
              "discontinuity.vertices where there are any")


@dataclass(frozen=True, eq=False)
class Detection:
    """What was seen where lines were looked for.

    Attributes
    ----------
    lines : tuple of (n_vertices, 2) array
        Those that were found, pixels.
    note : str
        What the user should know.
    centres : (n_cells, 2) array
        Of the cells of the continuous field, pixels.
    tresca : (n_cells,) array
        Their equivalent strain, no unit.
    transform : RadonTransform
        Of what stands out in it, all cells being seen.
    """

    lines: tuple[Array, ...]
    note: str
    centres: Array
    tresca: Array
    transform: RadonTransform

    def to_arrays(self) -> dict[str, Array]:
        """Give the maps by the names of the result file (docs/result-file.md)."""
        return {"centres": self.centres, "tresca_strain": self.tresca, "radon_angles": self.transform.angles,
                "radon_distances": self.transform.distances,
                "radon_scores": self.transform.scores.astype(np.float32)}


def find_lines_of_case(inputs: Inputs, frame: Frame, displacement: Array) -> Detection:
    """Find the lines across which a displacement jumps.

    On one rank; the first camera sees the whole region. ``displacement`` is that of a continuous field, (n_nodes, 2),
    pixels; nan where it was not measured, there it follows by equilibrium.
    """
    images, (mesh, _) = view_first_camera(inputs, frame), inputs.build_mesh()
    displacement = fill_unmeasured(mesh, displacement)
    tresca = compute_tresca_strain(compute_strain(mesh, displacement.ravel()).infinitesimal)
    standing_out = StandingOut.compare(mesh.centroids, tresca, measure_cell_size(mesh))
    transform = standing_out.compute_transform(np.ones(mesh.n_cells, dtype=bool))
    search = _Search(images, mesh, displacement, inputs.case.discontinuity[0].opening)
    found, notes = search.find_straight_lines(standing_out, transform)
    joined = join_lines([_cut_off(mesh, straight, number) for number, straight in enumerate(found)])
    lines = tuple(line.list_vertices() for line in joined)
    note = "; ".join([*_describe(found, lines), *notes, NOT_SOUGHT])
    return Detection(lines, f"detection: {note}", mesh.centroids, tresca, transform.keep_peaks())


@dataclass(frozen=True, eq=False)
class _Straight:
    """A straight line across the region, where the images say that it lies, and where others part it.

    ``crossings`` say how far along it, pixels, which others cross it, by number; ``evidence`` is that of the pieces
    between them and the region's edge.
    """

    refined: RefinedLine
    score: float
    crossings: tuple[tuple[float, int], ...]
    evidence: tuple[LineEvidence, ...]

    @property
    def line(self) -> Array:
        """Its ends beyond the region, (2, 2), pixels."""
        return self.refined.line

    @property
    def open_pieces(self) -> IntArray:
        """Numbers of the pieces that the images speak for, and hardly less than for the best of them."""
        falls = np.array([piece.fall for piece in self.evidence])
        speak = np.array([_speaks_for_line(piece) for piece in self.evidence])
        return np.flatnonzero(speak & (falls >= LEAST_SHARE * falls.max()))


@dataclass(frozen=True, eq=False)
class _Search:
    """The images with a continuous field, (n_nodes, 2), pixels, and how lines may open."""

    images: Images
    mesh: Mesh
    displacement: Array
    opening: Opening

    def find_straight_lines(self, standing_out: StandingOut,
                            transform: RadonTransform) -> tuple[list[_Straight], list[str]]:
        """Straight lines that open somewhere, and what is to be told of bands of strain that are none."""
        found: list[_Straight] = []
        notes: list[str] = []
        is_seen = np.ones(self.mesh.n_cells, dtype=bool)
        for n_tried in range(MOST_BANDS + 1):
            band = standing_out.find_band(transform)
            if band.score < LEAST_SCORE:
                if not found and not notes:
                    notes.append(f"no band of strain stands out (score {band.score:.1f}, {LEAST_SCORE:g} asked for)")
                break
            where = f"where strain stands out (score {band.score:.1f})"
            if len(found) == MOST_LINES or n_tried == MOST_BANDS:
                notes.append(f"{where} there may be another line: no more than {MOST_LINES} lines are looked for, in "
                             f"no more than {MOST_BANDS} bands")
                break
            try:
                found, told = self._try_line(found, band)
            except UNMEASURABLE as error:
                told = f"no line could be measured: {error}"
            if told:
                notes.append(f"{where} {told}")
            about = [band.line, *(one.line for one in found)]
            distance = np.min([measure_distance(self.mesh.centroids, line) for line in about], axis=0)
            is_seen &= distance > ABOUT * standing_out.size
            transform = standing_out.compute_transform(is_seen)
        return found, notes

    def _try_line(self, found: list[_Straight], band: StrainBand) -> tuple[list[_Straight], str]:
        """The lines that open with one more in a band, and what is to be told of that one."""
        bands = [*(StrainBand(one.line, one.score) for one in found), band]
        seen = self._refine(bands)
        against = f"no line explains more than chance: {_describe_residuals(seen[-1:])}"
        if not len(seen[-1].open_pieces):
            return found, against
        kept = [k for k, one in enumerate(seen) if len(one.open_pieces)]
        n_left_out = len(seen) - len(kept)
        if not n_left_out:
            return seen, ""
        seen = self._refine([bands[k] for k in kept])
        if not all(len(one.open_pieces) for one in seen):
            return found, against
        return seen, f"a line leaves {n_left_out} found before no more than chance to explain: left out"

    def _refine(self, bands: Sequence[StrainBand]) -> list[_Straight]:
        """Lines in bands where the images say that they lie, the last one first, with their pieces between the others.

        Each is measured without the cells about the others: where lines cross, parts of cells may be too small.
        """
        lines = [band.line for band in bands]
        refined: dict[int, tuple[RefinedLine, ResidualsBeside]] = {}
        last = len(bands) - 1
        for number in (last, *range(last)):
            refined[number] = self._refine_one(lines, number)
            lines[number] = refined[number][0].line
        return [self._part(*refined[number], lines, number, band.score) for number, band in enumerate(bands)]

    def _refine_one(self, lines: Sequence[Array], number: int) -> tuple[RefinedLine, ResidualsBeside]:
        """One line where the images say that it lies, and the residuals beside it.

        Where what is left of a cell beside the others is too little to be measured, it is left out too.
        """
        line, size = lines[number], measure_cell_size(self.mesh)
        away = np.full(self.mesh.n_cells, np.inf)
        for other in (*lines[:number], *lines[number + 1:]):
            away = np.minimum(away, measure_distance(self.mesh.centroids, other))
        alone = UncertainLine(Discontinuities((line,), (self.opening,)), 0, UNCERTAIN * size)
        failures: list[Exception] = []
        is_near = measure_distance(self.mesh.centroids, line) <= size
        for aside in ASIDE[:1] if len(lines) == 1 else ASIDE:
            is_away = away > aside * size
            if not (is_near & is_away).any():
                failures.append(ConvergenceError("it runs along another line"))
                continue
            mesh, nodes = self.mesh.create_submesh(np.flatnonzero(is_away))
            displacement = self.displacement[nodes]
            try:
                refined = refine_line(self.images, mesh, CutField(mesh, displacement), alone, STILL)
                return refined, measure_residuals(self.images, mesh, displacement, refined)
            except UNMEASURABLE as error:
                failures.append(error)
        raise failures[0]

    def _part(self, refined: RefinedLine, residuals: ResidualsBeside, lines: Sequence[Array], number: int,
              score: float) -> _Straight:
        """A line with its pieces between the others."""
        line = lines[number]
        crossings = [(at, other) for other in range(len(lines)) if other != number
                     for at in _find_crossing(self.mesh, line, lines[other])]
        crossings.sort()
        piece = np.searchsorted([at for at, _ in crossings], _measure_along(line, residuals.pixels))
        evidence = tuple(residuals.sum(piece == k) for k in range(len(crossings) + 1))
        return _Straight(refined, score, tuple(crossings), evidence)


def _speaks_for_line(evidence: LineEvidence) -> bool:
    """Whether residuals fall by far more than by chance: noise lets each unknown explain its variance once."""
    n_more = evidence.n_more
    if n_more <= 0 or evidence.n_pixels <= n_more:
        return False
    variance = evidence.with_line / (evidence.n_pixels - n_more)
    by_chance = (n_more + OUTLIERS * np.sqrt(2 * n_more)) * variance
    return bool(evidence.without_line - evidence.with_line > TIMES_CHANCE * by_chance)


def _measure_along(line: Array, points: Array) -> Array:
    """How far points, (n, 2), lie along a straight line from its beginning, (n,), pixels."""
    along = line[1] - line[0]
    return np.asarray((points - line[0]) @ along / np.linalg.norm(along))


def _find_crossing(mesh: Mesh, line: Array, other: Array) -> list[float]:
    """Where another straight line crosses one inside the mesh's box: how far along it, pixels; nothing elsewhere."""
    one, two = line[1] - line[0], other[1] - other[0]
    across = float(multiply_across(one, two))
    if across == 0.0:
        return []
    share = float(multiply_across(other[0] - line[0], two)) / across
    point = line[0] + share * one
    is_inside = bool(((point >= mesh.nodes.min(axis=0)) & (point <= mesh.nodes.max(axis=0))).all())
    return [share * float(np.linalg.norm(one))] if is_inside else []


@dataclass(frozen=True, eq=False)
class OpenLine:
    """A line as far as it opens.

    Attributes
    ----------
    vertices : (n_vertices, 2) array
        Pixels.
    ends : pair of pair of int
        Of its beginning and its end: number of the straight line that it is part of there, and of the one at which that
        ends; -1 for the edge of the region.
    """

    vertices: Array
    ends: tuple[tuple[int, int], tuple[int, int]]

    @property
    def reverse(self) -> OpenLine:
        """The same from its end."""
        return OpenLine(self.vertices[::-1], self.ends[::-1])

    def join(self, other: OpenLine) -> OpenLine | None:
        """Make one line of two that end at each other, which bends there; None where they do not."""
        for one in (self, self.reverse):
            for two in (other, other.reverse):
                if one.ends[1] == two.ends[0][::-1]:
                    return OpenLine(np.concatenate([one.vertices, two.vertices[1:]]), (one.ends[0], two.ends[1]))
        return None

    def list_vertices(self) -> Array:
        """Its vertices, (n_vertices, 2), pixels, with ends a little beyond the lines at which it ends."""
        vertices = self.vertices.copy()
        for (_, at), end, before in ((self.ends[0], 0, 1), (self.ends[1], -1, -2)):
            if at >= 0:
                ahead = vertices[end] - vertices[before]
                vertices[end] += BEYOND * ahead / np.linalg.norm(ahead)
        return vertices


def join_lines(lines: Sequence[OpenLine]) -> list[OpenLine]:
    """Join lines that end at each other."""
    joined: list[OpenLine] = []
    for line in lines:
        longer = line
        for other in list(joined):
            both = other.join(longer)
            if both is not None:
                joined.remove(other)
                longer = both
        joined.append(longer)
    return joined


def _cut_off(mesh: Mesh, straight: _Straight, number: int) -> OpenLine:
    """A straight line between the outermost of its pieces that open."""
    line, pieces = _clip_to_region(mesh, straight.line), straight.open_pieces
    ends = _measure_along(straight.line, line)
    places = [ends[0], *(at for at, _ in straight.crossings), ends[1]]
    others = [-1, *(other for _, other in straight.crossings), -1]
    first, last = pieces[0], pieces[-1] + 1
    along = (straight.line[1] - straight.line[0]) / np.linalg.norm(straight.line[1] - straight.line[0])
    vertices = np.stack([straight.line[0] + places[k] * along for k in (first, last)])
    return OpenLine(vertices, ((number, others[first]), (number, others[last])))


def _clip_to_region(mesh: Mesh, line: Array) -> Array:
    """The line from one side of the mesh's box to the other, a cell beyond."""
    size = measure_cell_size(mesh)
    low, high = mesh.nodes.min(axis=0) - size, mesh.nodes.max(axis=0) + size
    along = line[1] - line[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = (low - line[0]) / along, (high - line[0]) / along
    enter = float(np.nanmax(np.minimum(to_low, to_high)))
    leave = float(np.nanmin(np.maximum(to_low, to_high)))
    return np.stack([line[0] + enter * along, line[0] + leave * along])


def _describe(found: Sequence[_Straight], lines: Sequence[Array]) -> list[str]:
    """What is to be told of lines that were found."""
    if not found:
        return ["no line"]
    where = " and ".join(" to ".join(f"({x:.2f}, {y:.2f})" for x, y in line) for line in lines)
    scores = ", ".join(f"{one.score:.1f}" for one in found)
    moves = ", ".join(str(one.refined.n_moves) for one in found)
    return [f"{'line' if len(lines) == 1 else f'{len(lines)} lines'} from {where} px (score {scores}, moved {moves} "
            f"times)", _describe_residuals(found)]


def _describe_residuals(found: Sequence[_Straight]) -> str:
    pieces = [piece for one in found for piece in one.evidence]
    n_pixels = max(sum(piece.n_pixels for piece in pieces), 1)
    without, with_lines = (float(np.sqrt(sum(squares) / n_pixels)) for squares in
                           ([piece.without_line for piece in pieces], [piece.with_line for piece in pieces]))
    which = "it cuts" if len(found) == 1 else "each cuts away from the others"
    return f"residual in the elements that {which} {without:.3g} grey levels without it, {with_lines:.3g} with it"
