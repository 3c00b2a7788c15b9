"""Nodes that regularization leaves free: loaded and clamped edges, where forces are unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.mesh.node_selection import find_named_nodes, find_nodes_in_box
from ddic.mesh.topology import find_boundary_nodes

BOUNDARY = "boundary"
"""Stands for all nodes of the mesh's boundary, whatever the mesh's own node sets are."""


def find_not_controlled_nodes(mesh: Mesh, names: Sequence[str], boxes: Sequence[Sequence[float]],
                         boundary: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    """Find the nodes that are not mechanically controlled.

    Parameters
    ----------
    mesh : Mesh
        Any.
    names : sequence of str
        Node sets, or "boundary".
    boxes : sequence of (x0, y0, x1, y1)
        Pixels.
    boundary : (n,) int64 array, optional
        Nodes of the boundary; by default those on facets of one cell.

    Returns
    -------
    (n,) int64 array
        Their sorted numbers.

    Raises
    ------
    InputError
        A line for each unknown name, empty set and box without nodes.
    """
    chosen, problems = [np.zeros(0, np.int64)], []
    for name in names:
        try:
            if name == BOUNDARY:
                chosen.append(find_boundary_nodes(mesh) if boundary is None else boundary)
            else:
                chosen.append(find_named_nodes(mesh, name))
        except InputError as error:
            problems += [f"regularization.not_controlled: {line}" for line in error.problems]
    for box in boxes:
        try:
            chosen.append(find_nodes_in_box(mesh, box))
        except InputError as error:
            problems += [f"regularization.boxes: {line}" for line in error.problems]
    if problems:
        raise InputError(problems)
    return np.unique(np.concatenate(chosen))
