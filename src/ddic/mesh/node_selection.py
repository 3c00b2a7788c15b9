"""Nodes chosen by name or by box."""

from collections.abc import Sequence
from difflib import get_close_matches

import numpy as np

from ddic.arrays import IntArray
from ddic.errors import InputError
from ddic.mesh.mesh import Mesh


def find_named_nodes(mesh: Mesh, name: str) -> IntArray:
    """Look up a node set: sorted numbers of its nodes.

    Raises InputError where the mesh has no such set, with the nearest name, or where the set is empty.
    """
    if name not in mesh.node_sets:
        near = get_close_matches(name, list(mesh.node_sets), n=1)
        known = ", ".join(f'"{key}"' for key in sorted(mesh.node_sets)) or "none"
        hint = f'did you mean "{near[0]}"?' if near else f"the mesh has: {known}"
        raise InputError(f'no node set is named "{name}"; {hint}')
    if len(mesh.node_sets[name]) == 0:
        raise InputError(f'the node set "{name}" holds no node of the mesh; leave it out')
    return mesh.node_sets[name]


def find_nodes_in_box(mesh: Mesh, box: Sequence[float]) -> IntArray:
    """Find the nodes in a closed box, its lowest corner, then its highest, pixels; sorted.

    Raises InputError where the box holds no node.
    """
    low, high = np.array(box[:mesh.dim]), np.array(box[mesh.dim:])
    within = ((mesh.nodes >= low) & (mesh.nodes <= high)).all(axis=1)
    if not within.any():
        raise InputError(f"the box {list(box)} (x0, y0, x1, y1 in pixels) holds no node of the mesh")
    return np.flatnonzero(within).astype(np.int64)
