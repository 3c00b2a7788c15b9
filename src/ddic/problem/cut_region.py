"""The mesh and its unknowns where the case's discontinuities cut it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.functionals.corner_weights import weigh_corners
from ddic.kinematics.discontinuities import Discontinuities
from ddic.kinematics.enriched import EnrichedRegion, enrich
from ddic.mesh.cut_mesh import CutMesh, cut_mesh, is_cut_by
from ddic.mesh.mesh import Mesh
from ddic.problem.inputs import Inputs


@dataclass(frozen=True, eq=False)
class CutRegion:
    """A mesh that discontinuities cut, with its unknowns.

    Attributes
    ----------
    cut : CutMesh
        The mesh.
    kinematics : EnrichedRegion
        Its unknowns.
    corner_weights : (len(connectivity),) array
        How firmly the pixels of each of its cells hold each of its nodes.
    """

    cut: CutMesh
    kinematics: EnrichedRegion
    corner_weights: NDArray[np.float64]

    def describe(self) -> str:
        """Say in a line how much is cut.

        Returns
        -------
        str
            For the log and ``ddic check``.
        """
        parts = self.cut.mesh.parts
        n_lines = 0 if parts is None else len(parts.lines.polylines)
        n_cut = 0 if parts is None else len(np.unique(self.cut.cell_of[parts.cells]))
        n_beyond = self.kinematics.n_unknowns - (int(self.cut.node_of.max()) + 1) * self.cut.mesh.dim
        lines = "1 line cuts" if n_lines == 1 else f"{n_lines} lines cut"
        return f"{lines} {n_cut} elements, {n_beyond} more unknowns"


def list_discontinuities(case: Case) -> Discontinuities:
    """Give the case's discontinuities.

    Parameters
    ----------
    case : Case
        With its discontinuities.

    Returns
    -------
    Discontinuities
        Those whose lines are known, pixels.
    """
    known = [section for section in case.discontinuity if section.vertices is not None]
    return Discontinuities(tuple(np.array(section.vertices) for section in known),
                           tuple(section.opening for section in known))


def cut_region(case: Case, mesh: Mesh) -> CutRegion | None:
    """Cut a mesh by the case's discontinuities.

    Parameters
    ----------
    case : Case
        With its discontinuities.
    mesh : Mesh
        The whole mesh, pixels.

    Returns
    -------
    CutRegion or None
        None where there are none.

    Raises
    ------
    InputError
        Where a line crosses no element from side to side.
    """
    discontinuities = list_discontinuities(case)
    if not discontinuities.n_lines:
        return None
    check_lines(case, mesh)
    cut = cut_mesh(mesh, discontinuities.lines)
    weights = weigh_corners(cut, case.correlation.spline_degree)
    return CutRegion(cut, enrich(cut, weights, discontinuities.openings), weights)


def refuse_kinematics(inputs: Inputs) -> None:
    """Refuse kinematics of one's own beside discontinuities.

    Parameters
    ----------
    inputs : Inputs
        Of a case with discontinuities.

    Raises
    ------
    InputError
        Where there are any.
    """
    if inputs.choose_kinematics is not None:
        raise InputError("kinematics: discontinuities have kinematics of their own; leave one of them out")


def check_lines(case: Case, mesh: Mesh) -> None:
    """Check that every discontinuity cuts the mesh.

    Parameters
    ----------
    case : Case
        With its discontinuities.
    mesh : Mesh
        The whole mesh, pixels.

    Raises
    ------
    InputError
        Where a line crosses no element from side to side.
    """
    idle = [k for k, line in enumerate(list_discontinuities(case).lines, start=1) if not is_cut_by(mesh, line)]
    if idle:
        raise InputError([f"discontinuity, entry {k}: its line crosses no element of the mesh from side to side; "
                          "correct discontinuity.vertices (px), or use smaller elements" for k in idle])
