"""The line that a case asks for, looked for in its images; and the lines and tips that it gives, refined."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case, DiscontinuitySection
from ddic.detection.find_line import Detection, find_line
from ddic.detection.refine_line import SEARCHED, find_move, refine_line
from ddic.detection.refine_tip import find_tip_move
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
from ddic.problem.cut_region import cut_by_lines, list_discontinuities, list_tip_functions
from ddic.start.coarse_displacement import CutField
from ddic.start.given_start import extrapolate
from ddic.start.independent import Images

Array = NDArray[np.float64]

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


def find_line_of_case(inputs: Inputs, frame: Frame, displacement: Array) -> Detection:
    """Find the line that a case asks for, or say why there is none; on one rank.

    The first camera sees the whole region. ``displacement`` is that of a continuous field, (n_nodes, 2), pixels; nan
    where it was not measured, there it follows by equilibrium.
    """
    mesh, _ = inputs.build_mesh()
    return find_line(_view_images(inputs, frame), mesh, _fill(mesh, displacement), inputs.case.discontinuity[0].opening)


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
        of_line = number, section.uncertainty
        if section.uncertainty > 0 and _is_off(images, cut, field, given, of_line):
            among, note = _refine(images, mesh, field, among, of_line)
            notes.append(f"discontinuity, entry {number + 1}: {note}")
    tips = find_tips(mesh, among.lines, list_tip_functions(inputs.case))
    for tip in () if tips is None else tips.tips:
        if (uncertainty := sections[tip.line].uncertainty) > 0:
            among, found_tip = _refine_tip(inputs.case, images, mesh, field, among, (tip, uncertainty))
            notes += [f"discontinuity, entry {tip.line + 1}: {note}" for note in found_tip]
    sections = [section if among.lines[number] is given.lines[number]
                else section.model_copy(update={"vertices": tuple(map(tuple, among.lines[number].tolist()))})
                for number, section in enumerate(sections)]
    return Refinement(tuple(sections), tuple(notes), sections != list(inputs.case.discontinuity))


def _refine(images: Images, mesh: Mesh, field: CutField, among: Discontinuities,
            of_line: tuple[int, float]) -> tuple[Discontinuities, str]:
    """A line, of some number and uncertainty, where it fits the images best, and what is to be told of it."""
    number, uncertainty = of_line
    line = among.lines[number]
    try:
        found = refine_line(images, mesh, field, among, number, uncertainty, SETTLED).best
    except (ConvergenceError, SingularSubdomainError, FactorizationError) as error:
        return among, ("the residual says that its line is off, but where it belongs is not found: "
                       f"{error}; correct discontinuity.vertices")
    moved = _measure_move(mesh, line, found)
    if moved > SEARCHED * uncertainty:
        return among, _describe_limit("line", f"{moved:.1f}", uncertainty)
    return among.with_line(number, found), (
        f"its line was off, and was refined by the residual: moved by up to {moved:.2f} px, turned by "
        f"{_describe_turns(line, found)} degrees; now {_describe_vertices(found)} px")


def _refine_tip(case: Case, images: Images, mesh: Mesh, field: CutField, among: Discontinuities,
                of_tip: tuple[Tip, float]) -> tuple[Discontinuities, list[str]]:
    """A tip, of some uncertainty, where Williams' series fits the images best, and what is to be told if it was off."""
    tip, uncertainty = of_tip
    elastic = case.regularization or Material()
    kappa = find_kolosov_constant(elastic.poisson_ratio, elastic.plane)
    try:
        move = find_tip_move(images, mesh, field, tip, among.lines, uncertainty, kappa)
    except ConvergenceError:
        # No room, or no crack as the series has it: nothing is known of the tip's place.
        return among, []
    if abs(move.ahead) <= max(TIP_OFF, CERTAIN * move.deviation):
        return among, []
    if abs(move.ahead) > SEARCHED * uncertainty:
        return among, [_describe_limit("tip", f"{move.ahead:+.1f}", uncertainty)]
    line = among.lines[tip.line].copy()
    line[tip.vertex] = tip.position + move.ahead * tip.ahead
    x, y = line[tip.vertex]
    return among.with_line(tip.line, line), [
        f"its tip was off, and was refined by the residual: moved by {move.ahead:+.2f} px along the line, ahead where "
        f"positive; now ({x:.2f}, {y:.2f}) px"]


def _describe_limit(what: str, moved: str, uncertainty: float) -> str:
    return (f"the residual would move its {what} by {moved} px, more than {SEARCHED:g} times discontinuity.uncertainty "
            f"= {uncertainty:g} px: it stays; look at its place, or raise that")


def _is_off(images: Images, cut: CutMesh, field: CutField, given: Discontinuities,
            of_line: tuple[int, float]) -> bool:
    """Whether a line, of some number and uncertainty, is off by the field that was measured."""
    try:
        move = find_move(images, cut, field.displacement, given, *of_line)
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
