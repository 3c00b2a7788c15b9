"""Error of near-field and far-field measurements, and how much it oscillates at the interface."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from accept.support.near_far_case import Fields, rms
from ddic.mesh.mesh import Mesh

Exact = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def errors(fields: Fields, exact: Exact) -> list[NDArray[np.float64]]:
    """Error of each camera's field at its nodes, (n_c, 2) far px."""
    return [u - exact(fields.mesh.nodes[nodes]) for nodes, u in zip(fields.nodes, fields.u, strict=True)]


def error_rms(fields: Fields, exact: Exact) -> float:
    """RMS error per component over both fields; a node of both counts in each."""
    return rms(np.concatenate(errors(fields, exact)))


def interface(fields: Fields) -> NDArray[np.int64]:
    """Nodes of both cameras."""
    far, near = fields.nodes
    return np.asarray(np.intersect1d(far, near))


def interface_error(fields: Fields, exact: Exact) -> float:
    """RMS error per component of both fields at the nodes that they share."""
    shared = interface(fields)
    return rms(np.concatenate([e[np.isin(n, shared)] for e, n in zip(errors(fields, exact), fields.nodes,
                                                                     strict=True)]))


def largest_jump(fields: Fields) -> float:
    """Largest difference of a component between the two fields at the nodes that they share, far px."""
    shared = interface(fields)
    far, near = (u[np.searchsorted(n, shared)] for n, u in zip(fields.nodes, fields.u, strict=True))
    return float(np.abs(far - near).max())


def oscillation(fields: Fields, exact: Exact) -> float:
    """RMS of the second difference e_a - 2 e_b + e_c of the error, per component, far px.

    b runs over the nodes of both cameras, a and c over its two neighbours on each mesh line through b, along the
    interface as well as across it. Where fields jump, b and neighbours on the interface count once for each field,
    both in the same one; a neighbour inside has its camera's value.
    """
    nodal = []
    for e, nodes in zip(errors(fields, exact), fields.nodes, strict=True):
        values = np.full((fields.mesh.n_nodes, 2), np.nan)
        values[nodes] = e
        nodal.append(values)
    differences = []
    shared = interface(fields)
    for a, b, c in mesh_lines(fields.mesh, shared):
        for own, other in (nodal, nodal[::-1]):
            ends = [np.where(np.isnan(own[k]), other[k], own[k]) for k in (a, c)]
            differences.append(ends[0] - 2 * own[b] + ends[1])
    return rms(np.array(differences))


def mesh_lines(mesh: Mesh, nodes: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    """Neighbours a, c of node b on each mesh line through it, where four quadrilaterals meet at b."""
    wanted = set(nodes.tolist())
    cells_at: dict[int, list[list[int]]] = {node: [] for node in wanted}
    for cell in mesh.cells:
        corners = [int(k) for k in cell if k >= 0]
        for k, corner in enumerate(corners):
            if corner in wanted:
                cells_at[corner].append([corners[k - 1], corners[(k + 1) % len(corners)], len(corners)])
    for b, around in sorted(cells_at.items()):
        if len(around) != 4 or any(n != 4 for *_, n in around):
            continue
        next_to: dict[int, set[int]] = {}
        for one, two, _ in around:
            next_to.setdefault(one, set()).add(two)
            next_to.setdefault(two, set()).add(one)
        for a in sorted(next_to):
            opposite = set(next_to) - {a} - next_to[a]
            if len(opposite) == 1 and a < (c := opposite.pop()):
                yield a, b, c
