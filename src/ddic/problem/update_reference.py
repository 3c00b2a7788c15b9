"""Comparing later frames with one that was measured, in the place of the reference image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.problem.cameras import Frame
from ddic.problem.inputs import Inputs
from ddic.problem.reference_problem import ReferenceProblem
from ddic.problem.updated_reference import UpdatedReference

Array = NDArray[np.float64]


def update_reference(team: Team, problem: ReferenceProblem, frame: Frame, displacement: Array) -> Inputs:
    """Put a frame in the place of the reference image, and the mesh where the frame shows it; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    problem : ReferenceProblem
        Of the reference image in use, of one camera, without discontinuities.
    frame : Frame
        One that was measured.
    displacement : (n_nodes, 2) array
        Of all nodes since the first reference image, finite, pixels.

    Returns
    -------
    Inputs
        Whose mesh is refused where it has left the image.
    """
    inputs = problem.inputs
    first = _describe_first(team, problem) if inputs.updated is None else inputs.updated
    updated = replace(first, displacement=displacement)
    image = frame[0].image
    # What a case gives of the displacement is said of the first reference image.
    start = inputs.case.start.model_copy(update={"from_result": None, "frame": None, "from_points": None,
                                                 "points": None})
    camera = replace(inputs.cameras[0], reference=frame[0])
    return replace(inputs, case=inputs.case.model_copy(update={"start": start}), cameras=(camera,),
                   build_mesh=lambda: (updated.build_moved_mesh(image.width, image.height), None),
                   updated=updated, notes=())


def _describe_first(team: Team, problem: ReferenceProblem) -> UpdatedReference:
    """The mesh and its parts in the first reference image; collective."""
    region = problem.region
    nodes, parts = np.empty((region.n_nodes, 2)), np.empty(region.n_cells, dtype=np.int64)
    for index, node_ids, of_nodes, cell_ids in team.gather_lists(
            [(s.index, s.node_ids, s.mesh.nodes, s.cell_ids) for s in problem.subdomains]):
        nodes[node_ids], parts[cell_ids] = of_nodes, index
    inputs = problem.inputs
    first_image = inputs.cameras[0].reference.image
    return UpdatedReference(nodes, np.zeros(nodes.shape), parts, first_image, inputs.build_mesh)
