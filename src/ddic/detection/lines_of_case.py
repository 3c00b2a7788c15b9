"""The lines that a case gives, and tips along them, moved to where the images say that they lie."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ddic.arrays import Array
from ddic.case.schema import Case, DiscontinuitySection
from ddic.detection.refine_line import SEARCHED, UncertainLine, find_move, refine_line
from ddic.detection.refine_tip import LEAST_PX, choose_radius, find_tip_move
from ddic.errors import ConvergenceError, FactorizationError, SingularSubdomainError
from ddic.fracture.crack_tip import find_kolosov_constant
from ddic.functionals.regularization import Material
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.kinematics.enriched import Discontinuities
from ddic.kinematics.tip_functions import Tip, find_tips
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import measure_distance
from ddic.problem.region_mesh import cut_by_lines, list_discontinuities, list_tip_functions
from ddic.start.coarse_displacement import CutField
from ddic.start.given_start import extrapolate
from ddic.start.independent import Images

UNMEASURABLE = (ConvergenceError, SingularSubdomainError, FactorizationError)
"""What is raised where images do not tell a line, or the displacement along it."""

OFF, SETTLED = 0.5, 0.25
"""Pixels: a line that is no farther off is in its place, since pixels within 2 of it do not count anyway; and one that
is refined has been found when it moves by no more. In the gap of an open crack it wavers by 0.15."""

LEAST_FALL = 1000.0
"""Fall of the sum of squared residuals, in variances of the residual, from which on a line is moved: noise makes 20,
and a torn edge that no straight line follows 600. A larger one leaves lines that hardly open where they are."""

TIP_OFF, CERTAIN = 1.0, 5.0
"""Pixels, and standard deviations of what noise makes of its place, from which on a tip is moved along its line: a
Poisson's ratio that is wrong by 0.15 moves it by 0.6 px, and the field about it is no better for less."""


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
    images, given = view_first_camera(inputs, frame), list_discontinuities(inputs.case)
    mesh, _ = inputs.build_mesh()
    cut, _ = cut_by_lines(inputs.case, mesh)
    # Nodes of small cells about tips come last.
    field = CutField(cut.mesh, fill_unmeasured(cut.mesh, displacement[:cut.mesh.n_nodes]))
    sections, among = list(inputs.case.discontinuity), given
    notes: list[str] = []
    for number, section in enumerate(sections):
        line = UncertainLine(given, number, section.uncertainty)
        if section.may_be_off and _is_off(images, cut, field, line):
            among, note = _refine(images, mesh, field, replace(line, among=among))
            notes.append(f"discontinuity, entry {number + 1}: {note}")
    tips = find_tips(mesh, among.lines, list_tip_functions(inputs.case))
    for tip in () if tips is None else tips.tips:
        section = sections[tip.line]
        if section.may_be_off:
            line = UncertainLine(among, tip.line, section.uncertainty)
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
    except ConvergenceError:
        # No pixel about it counts, or it crosses no element by itself.
        return False
    return move.distance > OFF and move.fall > LEAST_FALL


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


def view_first_camera(inputs: Inputs, frame: Frame) -> Images:
    """The first camera's pair, on one rank."""
    case, camera = inputs.case, inputs.cameras[0]
    extent = camera.reference.extent
    usable = camera.reference.find_usable(extent)
    active = np.ones((extent.height, extent.width), dtype=np.uint8) if usable is None else usable
    return Images(camera.reference, frame[0], active, case.correlation.spline_degree,
                  case.correlation.correction_of_start)


def fill_unmeasured(mesh: Mesh, displacement: Array) -> Array:
    """The displacement with what follows by equilibrium where it was not measured."""
    is_measured = np.isfinite(displacement).all(axis=1)
    if is_measured.all() or not is_measured.any():
        return displacement
    return extrapolate(mesh, displacement, is_measured).displacement
