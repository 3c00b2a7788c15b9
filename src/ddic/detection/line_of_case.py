"""The line that a case asks for, looked for in its images; and the lines and tips that it gives, refined.

Where a line is, the strain of a continuous field stands out in a straight band, found by a Radon transform over cells
[RHR08]. It is refined, and kept where the images speak for it.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ddic.arrays import Array
from ddic.case.schema import Case, DiscontinuitySection
from ddic.detection.refine_line import SEARCHED, Squares, UncertainLine, find_move, measure_residuals, refine_line
from ddic.detection.refine_tip import LEAST_PX, choose_radius, find_tip_move
from ddic.errors import ConvergenceError, FactorizationError, SingularSubdomainError
from ddic.fracture.crack_tip import find_kolosov_constant
from ddic.functionals.regularization import Material
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.kinematics.enriched import Discontinuities
from ddic.kinematics.strain import compute_strain
from ddic.kinematics.tip_functions import Tip, find_tips
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree, measure_distance
from ddic.mesh.quality import measure_cell_size
from ddic.problem.region_mesh import cut_by_lines, list_discontinuities, list_tip_functions
from ddic.start.coarse_displacement import CutField
from ddic.start.given_start import extrapolate
from ddic.start.independent import Images

UNMEASURABLE = (ConvergenceError, SingularSubdomainError, FactorizationError)
"""What is raised where images do not tell a line, or the displacement along it."""

NEIGHBOURHOOD = 3.6
"""Radius, elements, of the cells with whose plane of least squares a cell's strain is compared. A larger one takes
smooth fields for bands, in a smaller one the plane follows the band."""

FEWEST_CELLS = 6
"""Cells that a band must have. Fewer stand out by chance."""

OF_NORMAL = 1.4826
"""Standard deviation of normal numbers over the median of their absolute values."""

FLAT = 1e-6
"""Weight of a slope of 0, which decides where a few points leave it open."""

TINY = 1e-300
"""A spread below any that is not 0."""


@dataclass(frozen=True, eq=False)
class StrainBand:
    """A straight band.

    Attributes
    ----------
    line : (2, 2) array
        Its middle from one side of all points to the other, pixels.
    score : float
        Sum of what stands out in it, in standard deviations of such sums where nothing does.
    """

    line: Array
    score: float


def compute_tresca_strain(strain: Array) -> Array:
    """Compute |e1 - e2| / 2, half the difference of the principal strains, (n,), of tensors exx, eyy, exy, (n, 3)."""
    exx, eyy, exy = strain.T
    return np.asarray(np.hypot((exx - eyy) / 2, exy))


def find_band(points: Array, strain: Array, size: float) -> StrainBand:
    """Find the straight band in which an equivalent strain exceeds that of its surroundings most.

    ``points`` are cells' centres, (n, 2), pixels, ``strain`` their equivalent strain, (n,), ``size`` theirs, pixels.
    """
    excess = strain - _fit_planes(points, strain, NEIGHBOURHOOD * size)
    spread = OF_NORMAL * float(np.median(np.abs(excess - np.median(excess))))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    length = float(np.linalg.norm(np.ptp(points, axis=0))) + size
    n_bands = int(np.ceil(length / size)) + 1
    best = StrainBand(np.stack([middle, middle]), 0.0)
    for angle in np.arange(0.0, np.pi, size / length / 2):
        along = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-along[1], along[0]])
        places = ((points - middle) @ normal + length / 2) / size
        # Bands lie half a cell apart: two sets of bands, a cell apart each.
        for shift in (0.0, 0.5):
            scores = _sum_bands(places + shift, excess, n_bands + 1) / max(spread, TINY)
            # A line through the mesh alone: bands at its edge reach half a cell beyond the last centres.
            at = np.arange(n_bands + 1) - shift
            scores[(at < places.min()) | (at > places.max())] = 0.0
            k = int(scores.argmax())
            if scores[k] > best.score:
                foot = middle + ((k - shift) * size - length / 2) * normal
                best = StrainBand(np.stack([foot - length * along, foot + length * along]), float(scores[k]))
    return best


def _fit_planes(points: Array, values: Array, radius: float) -> Array:
    """Value at each point of the plane that fits the values about it: edges of a smooth field do not stand out."""
    pairs = build_tree(points).query_pairs(radius, output_type="ndarray")
    one, other = np.concatenate([pairs, pairs[:, ::-1], np.arange(len(points))[:, None].repeat(2, axis=1)]).T
    away = (points[other] - points[one]) / radius
    basis = np.column_stack([np.ones(len(away)), away])
    normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(normal, one, basis[:, :, None] * basis[:, None, :])
    np.add.at(right, one, basis * values[other][:, None])
    # Points in a row do not tell the slope across it.
    normal += FLAT * np.diag([0.0, 1.0, 1.0])
    return np.asarray(np.linalg.solve(normal, right[..., None])[:, 0, 0])


def _sum_bands(places: Array, excess: Array, n_bands: int) -> Array:
    """Sums over bands at 0, 1, ..., by the root of the sum of the weights' squares; 0 where a band has few cells.

    Weights fall linearly to 0 at a distance of 1: a jump is smeared over two cells.
    """
    low = np.floor(places).astype(np.int64)
    bands = np.concatenate([low, low + 1])
    weights = np.concatenate([low + 1 - places, places - low])
    total = np.bincount(bands, weights * np.tile(excess, 2), n_bands)
    norm = np.sqrt(np.bincount(bands, weights**2, n_bands))
    is_long = np.bincount(bands, weights, n_bands) >= FEWEST_CELLS
    return np.asarray(np.where(is_long, total / np.maximum(norm, TINY), 0.0))


LEAST_SCORE = 8.0
"""Score of a band of strain from which on a line is looked for there: noise alone reaches 5. A larger one misses small
jumps."""

TIMES_CHANCE = 3.0
"""How often a line must lower the sum of squared residuals by what its unknowns would lower it by chance. A larger one
misses small jumps, a smaller one takes what elements do not resolve for a line."""

UNCERTAIN = 0.2
"""Standard deviation of the place of a band of strain, elements: of what a Radon transform may be off."""

STILL = 0.11
"""Pixels: a line that moves by no more has been found: two of the finer steps of its search, within which noise lets it
waver."""

OUTLIERS = 5.0
"""Standard deviations by which chance may exceed its mean."""


def find_line_of_case(inputs: Inputs, frame: Frame, displacement: Array) -> tuple[Array | None, str]:
    """Find the straight line across which a displacement jumps, across the region, (2, 2), pixels; or None and why.

    On one rank; the first camera sees the whole region. ``displacement`` is that of a continuous field, (n_nodes, 2),
    pixels; nan where it was not measured, there it follows by equilibrium. The text says what the user should know.
    """
    images, (mesh, _) = _view_images(inputs, frame), inputs.build_mesh()
    displacement = _fill(mesh, displacement)
    strain = compute_strain(mesh, displacement.ravel()).infinitesimal
    size = measure_cell_size(mesh)
    band = find_band(mesh.centroids, compute_tresca_strain(strain), size)
    if band.score < LEAST_SCORE:
        return None, (f"detection: no line; no band of strain stands out (score {band.score:.1f}, {LEAST_SCORE:g} "
                      "asked for)")
    among = Discontinuities((band.line,), (inputs.case.discontinuity[0].opening,))
    try:
        refined = refine_line(images, mesh, CutField(mesh, displacement), UncertainLine(among, 0, UNCERTAIN * size),
                              STILL)
        before, after = measure_residuals(images, mesh, displacement, refined)
    except UNMEASURABLE as error:
        return None, (f"detection: no line; where strain stands out (score {band.score:.1f}) no line could be "
                      f"measured: {error}")
    told = f"residual in the elements that it cuts {before.rms:.3g} grey levels without it, {after.rms:.3g} with it"
    if not _speaks_for_line(before, after):
        return None, (f"detection: no line; where strain stands out (score {band.score:.1f}) a line explains no more "
                      f"than chance: {told}")
    line = _clip_to_region(mesh, refined.line)
    (x0, y0), (x1, y1) = line
    return line, (f"detection: line from ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f}) px (score {band.score:.1f}, "
                  f"moved {refined.n_moves} times); {told}")


def _speaks_for_line(before: Squares, after: Squares) -> bool:
    """Whether residuals fall by far more than by chance: noise lets each unknown explain its variance once."""
    n_more = after.n_unknowns - before.n_unknowns
    if n_more <= 0 or after.n_pixels <= n_more:
        return False
    variance = after.total / max(after.n_pixels - n_more, 1)
    by_chance = (n_more + OUTLIERS * np.sqrt(2 * n_more)) * variance
    return bool(before.total - after.total > TIMES_CHANCE * by_chance)


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


OFF, SETTLED = 0.5, 0.25
"""Pixels: a line that is no farther off is in its place, since pixels within 2 of it do not count anyway; and one that
is refined has been found when it moves by no more. In the gap of an open crack it wavers by 0.15."""

LEAST_GAIN = 1000.0
"""Fall of the sum of squared residuals, in variances of the residual, from which on a line is moved: noise makes 20,
and a torn edge that no straight line follows 600. A larger one leaves lines that hardly open where they are."""

TIP_OFF, CERTAIN = 1.0, 5.0
"""Pixels, and standard deviations of what noise makes of its place, from which on a tip is moved along its line: a
Poisson's ratio that is wrong by 0.15 moves it by 0.7 px, and the field about it is no better for less."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """The lines of a case, refined.

    Attributes
    ----------
    sections : tuple of DiscontinuitySection
        All lines, those that were off at their new places.
    notes : tuple of str
        How far each was moved, or why it could not be; nothing where all are in their places.
    is_any : bool
        Whether one was moved.
    """

    sections: tuple[DiscontinuitySection, ...]
    notes: tuple[str, ...]
    is_any: bool


def refine_lines_of_case(inputs: Inputs, frame: Frame, displacement: Array) -> Refinement:
    """Refine the lines that a case gives, and tips with tip functions along them, where the residual says they are off.

    On one rank, one after the other. A line that is in its place costs a look at the pixels about it. The first camera
    sees the whole region. ``displacement`` is that of the mesh cut by these lines, (n_nodes, 2), pixels; nan where it
    was not measured.
    """
    images, given = _view_images(inputs, frame), list_discontinuities(inputs.case)
    mesh, _ = inputs.build_mesh()
    cut, _ = cut_by_lines(inputs.case, mesh)
    # Nodes of small cells about tips come last.
    field = CutField(cut.mesh, _fill(cut.mesh, displacement[:cut.mesh.n_nodes]))
    sections, among = list(inputs.case.discontinuity), given
    notes: list[str] = []
    for number, section in enumerate(sections):
        line = UncertainLine(given, number, section.uncertainty)
        if section.uncertainty > 0 and _is_off(images, cut, field, line):
            among, note = _refine(images, mesh, field, replace(line, among=among))
            notes.append(f"discontinuity, entry {number + 1}: {note}")
    tips = find_tips(mesh, among.lines, list_tip_functions(inputs.case))
    for tip in () if tips is None else tips.tips:
        deviation = sections[tip.line].uncertainty
        if deviation > 0:
            line = UncertainLine(among, tip.line, deviation)
            among, of_tip = _refine_tip(inputs.case, images, mesh, field, tip, line)
            notes += [f"discontinuity, entry {tip.line + 1}: {note}" for note in of_tip]
    sections = [section if among.lines[number] is given.lines[number]
                else section.model_copy(update={"vertices": tuple(map(tuple, among.lines[number].tolist()))})
                for number, section in enumerate(sections)]
    return Refinement(tuple(sections), tuple(notes), sections != list(inputs.case.discontinuity))


def _refine(images: Images, mesh: Mesh, field: CutField, line: UncertainLine) -> tuple[Discontinuities, str]:
    """All lines, this one where it fits the images best, and what is to be told of it."""
    try:
        found = refine_line(images, mesh, field, line, SETTLED).best
    except UNMEASURABLE as error:
        return line.among, ("the residual says that its line is off, but where it belongs is not found: "
                            f"{error}; correct discontinuity.vertices")
    moved = _measure_move(mesh, line.vertices, found)
    if moved > line.reach:
        return line.among, _describe_limit("line", f"{moved:.1f}", line.deviation)
    return line.move_to(found).among, (
        f"its line was off, and was refined by the residual: moved by up to {moved:.2f} px, turned by "
        f"{_describe_turns(line.vertices, found)} degrees; now {_describe_vertices(found)} px")


def _refine_tip(case: Case, images: Images, mesh: Mesh, field: CutField, tip: Tip,
                line: UncertainLine) -> tuple[Discontinuities, list[str]]:
    """All lines, a tip where Williams' series fits the images best, and what is to be told if it was off."""
    elastic = case.regularization or Material()
    kappa = find_kolosov_constant(elastic.poisson_ratio, elastic.plane)
    radius, limit = choose_radius(mesh, tip, line)
    if radius < LEAST_PX:
        return line.among, [f"its tip was not looked at: {limit} leaves Williams' series {radius:.0f} px, and it needs "
                            f"{LEAST_PX:g}"]
    try:
        move = find_tip_move(images, mesh, field, tip, line, kappa)
    except ConvergenceError:
        # No crack as the series has it: nothing is known of the tip's place.
        return line.among, []
    if abs(move.ahead) <= max(TIP_OFF, CERTAIN * move.deviation):
        return line.among, []
    if abs(move.ahead) > line.reach:
        return line.among, [_describe_limit("tip", f"{move.ahead:+.1f}", line.deviation)]
    vertices = line.vertices.copy()
    vertices[tip.vertex] = tip.position + move.ahead * tip.ahead
    x, y = vertices[tip.vertex]
    return line.move_to(vertices).among, [
        f"its tip was off, and was refined by the residual: moved by {move.ahead:+.2f} px along the line, ahead where "
        f"positive; now ({x:.2f}, {y:.2f}) px (Williams' series within {radius:.0f} px: {limit})"]


def _describe_limit(what: str, moved: str, uncertainty: float) -> str:
    return (f"the residual would move its {what} by {moved} px, more than {SEARCHED:g} times discontinuity.uncertainty "
            f"= {uncertainty:g} px: it stays; look at its place, or raise that")


def _is_off(images: Images, cut: CutMesh, field: CutField, line: UncertainLine) -> bool:
    """Whether a line is off by the field that was measured."""
    try:
        move = find_move(images, cut, field.displacement, line)
    except (ConvergenceError, ValueError):
        # No pixel about it counts, or it crosses no element by itself.
        return False
    return move.distance > OFF and move.gain > LEAST_GAIN


def _measure_move(mesh: Mesh, before: Array, after: Array) -> float:
    """How far a line was moved at most inside the mesh's box, pixels."""
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    shares, largest = np.linspace(0.0, 1.0, 1001)[:, None], 0.0
    for start, end in pairwise(before):
        points = start + shares * (end - start)
        inside = points[((points >= low) & (points <= high)).all(axis=1)]
        largest = max(largest, float(measure_distance(inside, after).max(initial=0.0)))
    return largest


def _describe_turns(before: Array, after: Array) -> str:
    """By how much the segments were turned, from +x to +y, degrees."""
    angles = [np.arctan2(*np.diff(line, axis=0).T[::-1]) for line in (before, after)]
    turns = np.rad2deg(np.angle(np.exp(1j * (angles[1] - angles[0]))))
    return ", ".join(f"{turn:+.2f}" for turn in turns)


def _describe_vertices(line: Array) -> str:
    return ", ".join(f"({x:.2f}, {y:.2f})" for x, y in line)


def _view_images(inputs: Inputs, frame: Frame) -> Images:
    """The first camera's pair, on one rank."""
    case, camera = inputs.case, inputs.cameras[0]
    extent = camera.reference.extent
    usable = camera.reference.find_usable(extent)
    active = np.ones((extent.height, extent.width), dtype=np.uint8) if usable is None else usable
    return Images(camera.reference, frame[0], active, case.correlation.spline_degree,
                  case.correlation.correction_of_start)


def _fill(mesh: Mesh, displacement: Array) -> Array:
    """The displacement with what follows by equilibrium where it was not measured."""
    is_measured = np.isfinite(displacement).all(axis=1)
    if is_measured.all() or not is_measured.any():
        return displacement
    return extrapolate(mesh, displacement, is_measured).displacement
