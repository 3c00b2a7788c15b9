"""The mesh and its unknowns where the case's discontinuities cut it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.functionals.line_band import weigh_corners
from ddic.inputs.cameras import MeasuredCells, collect_measured_cells
from ddic.inputs.inputs import Inputs
from ddic.kinematics.enriched import Discontinuities, EnrichedRegion, enrich
from ddic.kinematics.tip_functions import TipPatch, enrich_at_tips, find_bends_at_tips, find_tips
from ddic.mesh.cut_mesh import CutMesh, cut_mesh, is_cut_by
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.partition.determined import CutSides, keep_cameras_determined


@dataclass(frozen=True, eq=False)
class CutRegion:
    """A mesh that discontinuities cut, with its unknowns.

    Attributes
    ----------
    whole : Mesh
        The mesh before it was cut.
    sides : CutSides
        The mesh, cut, with unknowns on both sides of the lines.
    cameras : (whole.n_cells,) array of int64
        Camera that measures each cell.
    kinematics : EnrichedRegion
        The same unknowns and those of tip functions, with small cells about the tips.
    cell_of : (kinematics.mesh.n_cells,) array of int64
        Cell of the whole mesh that each cell is, or lies in.
    """

    whole: Mesh
    sides: CutSides
    cameras: IntArray
    kinematics: EnrichedRegion
    cell_of: IntArray

    @property
    def cut(self) -> CutMesh:
        """The mesh cut by lines, without small cells."""
        return self.sides.cut

    def find_nodes_away_from_lines(self) -> BoolArray:
        """Tell which nodes are no corners of cut cells or of small ones, (kinematics.mesh.n_nodes,)."""
        cut, n_nodes = self.cut, self.kinematics.mesh.n_nodes
        away = np.ones(n_nodes, dtype=bool)
        away[cut.find_with_phantoms(cut.node_of[cut.find_cut_nodes()])] = False
        for cells in self.sides.around_tips:
            away[cut.find_with_phantoms(self.whole.cells[cells].ravel())] = False
        away[cut.mesh.n_nodes:] = False
        return away

    def describe(self) -> str:
        """Say in a line of the log how much is cut."""
        n_beyond = self.kinematics.n_unknowns - (int(self.cut.node_of.max()) + 1) * self.cut.mesh.dim
        return f"{describe_cut(self.cut)}, {n_beyond} more unknowns"


def describe_cut(cut: CutMesh) -> str:
    """Say in a line of ``ddic check`` how much of a mesh is cut."""
    parts = cut.mesh.parts
    n_lines = 0 if parts is None else len(parts.lines.polylines)
    n_cut = 0 if parts is None else len(np.unique(cut.cell_of[parts.cells]))
    lines = "1 line cuts" if n_lines == 1 else f"{n_lines} lines cut"
    return f"{lines} {n_cut} elements"


def list_discontinuities(case: Case) -> Discontinuities:
    """Give the case's discontinuities whose lines are known, pixels."""
    known = [section for section in case.discontinuity if section.vertices is not None]
    return Discontinuities(tuple(np.array(section.vertices) for section in known),
                           tuple(section.opening for section in known))


def cut_region(inputs: Inputs, mesh: Mesh, labels: IntArray) -> CutRegion | None:
    """Cut a mesh by the case's discontinuities; None where there are none.

    ``labels``, (n_cells,), give the camera that measures each cell. Cells of a near camera whose pixels do not tell
    what is beyond a line go to the first one, together with those that do. Raises InputError where a line crosses no
    element from side to side.
    """
    discontinuities = list_discontinuities(inputs.case)
    if not discontinuities.n_lines:
        return None
    check_lines(inputs.case, mesh)
    cut, patch = cut_by_lines(inputs.case, mesh)
    around_tips = () if patch is None else tuple(tip.cells for tip in patch.tips)
    while True:
        measured = collect_measured_cells(inputs.cameras, cut.mesh, labels[cut.cell_of])
        weights = _weigh_corners(cut, measured, inputs.case.correlation.spline_degree)
        sides = CutSides(cut, enrich(cut, weights, discontinuities.openings), weights, around_tips)
        kept = keep_cameras_determined(sides, labels)
        if np.array_equal(kept, labels):
            break
        labels = kept
    if patch is None:
        return CutRegion(mesh, sides, labels, sides.kinematics, cut.cell_of)
    return CutRegion(mesh, sides, labels, *enrich_at_tips(cut, sides.kinematics, patch))


def cut_by_lines(case: Case, mesh: Mesh) -> tuple[CutMesh, TipPatch | None]:
    """Cut a mesh by the case's lines; beside it, small cells about tips, whose nodes these are kept clear of too."""
    lines = list_discontinuities(case).lines
    patch = find_tips(mesh, lines, list_tip_functions(case))
    return cut_mesh(mesh, lines, None if patch is None else patch.small.nodes), patch


def list_tip_functions(case: Case) -> list[bool]:
    """List by line of ``list_discontinuities`` whether the case asks for tip functions about the line's ends."""
    return [section.tip_functions for section in case.discontinuity if section.vertices is not None]


def _weigh_corners(cut: CutMesh, measured: Sequence[MeasuredCells], degree: int) -> Array:
    """How firmly the pixels of cells hold their nodes, (len(connectivity),).

    In square pixels of the first camera, so that cameras of different magnification compare.
    """
    mesh = cut.mesh
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    beside = cut.find_cells_at_phantoms()
    weights = np.zeros(len(mesh.connectivity))
    for of_camera in measured:
        own = np.flatnonzero(np.isin(of_camera.cells, beside)).astype(np.int64)
        seen = weigh_corners(of_camera.seen, own, degree)
        scale = measure_areas(of_camera.mesh) / measure_areas(of_camera.seen)
        corners = np.isin(cell_of_corner, of_camera.cells)
        weights[corners] = seen * np.repeat(scale, np.diff(of_camera.seen.offsets))
    return weights


def refuse_kinematics(inputs: Inputs) -> None:
    """Refuse, with an InputError, kinematics of one's own beside discontinuities."""
    if inputs.choose_kinematics is not None:
        raise InputError("kinematics: discontinuities have kinematics of their own; leave one of them out")


def check_lines(case: Case, mesh: Mesh) -> None:
    """Check that every discontinuity cuts the mesh, and that one with tip functions ends in it.

    Raises InputError where a line crosses no element from side to side, or has no tip.
    """
    idle = [k for k, line in enumerate(list_discontinuities(case).lines, start=1) if not is_cut_by(mesh, line)]
    problems = [f"discontinuity, entry {k}: its line crosses no element of the mesh from side to side; correct "
                "discontinuity.vertices (px), or use smaller elements" for k in idle]
    for k, section in enumerate(case.discontinuity, start=1):
        if section.tip_functions:
            problems += _check_tips(f"discontinuity, entry {k}", mesh, np.array(section.vertices))
    if problems:
        raise InputError(problems)


def _check_tips(entry: str, mesh: Mesh, line: Array) -> list[str]:
    """What is wrong with a line about whose ends there are to be tip functions."""
    if find_tips(mesh, [line], [True]) is None:
        return [f"{entry}: tip_functions = true, but neither end of its line lies in the mesh; give the line up to the "
                "crack's tip, or leave tip_functions out"]
    bends = find_bends_at_tips(mesh, line)
    if len(bends):
        x, y = bends[0]
        return [f"{entry}: tip_functions = true, but its line bends at ({x:g}, {y:g}) px, next to the tip; give a line "
                "that is straight for two elements behind it, or leave tip_functions out"]
    return []
