"""The line that a case asks for, looked for in its images; and the lines that it gives, refined by their residual."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import DiscontinuitySection
from ddic.detection.find_line import Detection, find_line
from ddic.detection.refine_line import SEARCHED, find_move, refine_line
from ddic.errors import ConvergenceError, FactorizationError, SingularSubdomainError
from ddic.kinematics.discontinuities import Discontinuities
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.polyline import measure_distance
from ddic.problem.cameras import Frame
from ddic.problem.cut_region import cut_by_lines, list_discontinuities
from ddic.problem.inputs import Inputs
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
    """Find the line that a case asks for; on one rank.

    Parameters
    ----------
    inputs : Inputs
        Its first camera sees the whole region.
    frame : Frame
        The deformed images.
    displacement : (n_nodes, 2) array
        Of a continuous field, pixels; nan where it was not measured, there it follows by equilibrium.

    Returns
    -------
    Detection
        The line, or why there is none.
    """
    mesh, _ = inputs.build_mesh()
    return find_line(_view_images(inputs, frame), mesh, _fill(mesh, displacement), inputs.case.discontinuity[0].opening)


def refine_lines_of_case(inputs: Inputs, frame: Frame, displacement: Array) -> Refinement:
    """Refine the lines that a case gives, those that the residual says are off; on one rank.

    A line that is in its place costs a look at the pixels about it.

    Parameters
    ----------
    inputs : Inputs
        Its first camera sees the whole region.
    frame : Frame
        The deformed images.
    displacement : (n_nodes, 2) array
        Of the mesh cut by these lines, pixels; nan where it was not measured.

    Returns
    -------
    Refinement
        One after the other.
    """
    images, given = _view_images(inputs, frame), list_discontinuities(inputs.case)
    mesh, _ = inputs.build_mesh()
    cut, _ = cut_by_lines(inputs.case, mesh)
    # Nodes of small cells about tips come last.
    field = CutField(cut.mesh, _fill(cut.mesh, displacement[:cut.mesh.n_nodes]))
    sections, notes, among = list(inputs.case.discontinuity), [], given
    for number, section in enumerate(sections):
        of_line = number, section.uncertainty
        if not (section.uncertainty > 0 and _is_off(images, cut, field, given, of_line)):
            continue
        line = among.lines[number]
        try:
            found = refine_line(images, mesh, field, among, number, section.uncertainty, SETTLED).best
        except (ConvergenceError, SingularSubdomainError, FactorizationError) as error:
            notes.append(f"discontinuity, entry {number + 1}: the residual says that its line is off, but where it "
                         f"belongs is not found: {error}; correct discontinuity.vertices")
            continue
        moved = _measure_move(mesh, line, found)
        if moved > SEARCHED * section.uncertainty:
            notes.append(f"discontinuity, entry {number + 1}: the residual would move its line by {moved:.1f} px, more "
                         f"than {SEARCHED:g} times discontinuity.uncertainty = {section.uncertainty:g} px: it stays; "
                         "look at its place, or raise that")
            continue
        among = among.with_line(number, found)
        sections[number] = section.model_copy(update={"vertices": tuple(map(tuple, found.tolist()))})
        notes.append(f"discontinuity, entry {number + 1}: its line was off, and was refined by the residual: moved by "
                     f"up to {moved:.2f} px, turned by {_describe_turns(line, found)} degrees; now "
                     f"{_describe_vertices(found)} px")
    return Refinement(tuple(sections), tuple(notes), sections != list(inputs.case.discontinuity))


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
