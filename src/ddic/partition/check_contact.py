"""Whether near meshes and the far one touch along whole edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, list_first
from ddic.mesh.interpolation import find_cells_with_points
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import Facets, find_facets
from ddic.partition.contact import COVERED, Contact, FarSide, NearSide


def check_contact(contact: Contact) -> None:
    """Check that the outline of each near mesh follows far edges from node to node.

    Parameters
    ----------
    contact : Contact
        The meshes and where they touch.

    Raises
    ------
    InputError
        Where an outline cuts far cells, or an edge touches the other side only in part, or twice.
    """
    _refuse_cut_cells(contact)
    _refuse_far_edges_in_part(contact)
    for near in contact.near:
        _refuse_near_edges_in_part(near)


def _refuse_cut_cells(contact: Contact) -> None:
    """Raise InputError, with the far cells' numbers, where a near mesh's outline does not follow far edges."""
    far = contact.far
    beside_gap = _cells_beside_gap(contact)
    problems = []
    for near in contact.near:
        cut = _find_cut_cells(far, near)
        if not len(cut):
            # The near mesh cuts no cell that is kept, but it may end inside one that it replaces.
            cut = beside_gap[far.replaced_by[beside_gap] == near.number]
        if len(cut):
            x, y = far.whole.centroids[cut[0]]
            problems.append(f"near, entry {near.number}: the outline of its mesh cuts {len(cut)} far elements "
                            f"(numbered from 0: {list_first(cut)}; the first around column {x:.0f}, row {y:.0f}); "
                            "align the near mesh with edges of far elements")
    if problems:
        raise InputError(problems)


def _find_cut_cells(far: FarSide, near: NearSide) -> NDArray[np.int64]:
    """Kept far cells that hold points of a near edge which should touch nothing; numbers in the whole far mesh."""
    ends = near.mesh.nodes[near.free_edges]
    midpoints = ends.mean(axis=1)
    points = np.concatenate([midpoints, ends.reshape(-1, 2)])
    found = np.unique(find_cells_with_points(far.rest, points, far.tolerance))
    return far.kept_cells[found]


def _cells_beside_gap(contact: Contact) -> NDArray[np.int64]:
    """Far cells at edges between a kept and a replaced cell that no near edge covers; sorted numbers."""
    far = contact.far
    facets = find_facets(far.whole)
    uncovered_edges = far.edges[contact.far_cover < 1.0 - COVERED]
    uncovered = _inner_facets_among(facets, far.node_ids[uncovered_edges])
    is_at_gap = np.isin(facets.side_facets, uncovered)
    return np.asarray(np.unique(facets.side_cells[is_at_gap]))


def _inner_facets_among(facets: Facets, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Facets of several cells that are among edges given by their nodes, (n, 2)."""
    inner = np.flatnonzero(facets.n_cells > 1)
    nodes = facets.nodes[:, :2]
    # One number for each pair of nodes, whatever their order.
    factors = np.array([int(nodes.max()) + 1, 1])
    numbers = np.sort(nodes[inner], axis=1) @ factors
    wanted = np.sort(edges, axis=1) @ factors
    return np.asarray(inner[np.isin(numbers, wanted)], dtype=np.int64)


def _refuse_far_edges_in_part(contact: Contact) -> None:
    far = contact.far
    partly = _covered_in_part(contact.far_cover)
    if partly.any():
        x, y = _first_midpoint(far.rest, far.edges[partly])
        raise InputError(f"near.mesh: the edge of a far element around column {x:.0f}, row {y:.0f} touches a near mesh "
                         "in part only; let the common boundary end at nodes of both meshes")


def _refuse_near_edges_in_part(near: NearSide) -> None:
    partly = _covered_in_part(near.cover)
    if partly.any():
        x, y = _first_midpoint(near.mesh, near.edges[partly])
        raise InputError(f"near, entry {near.number}: an edge of its mesh around column {x:.1f}, row {y:.1f} touches "
                         "far elements in part only; let the common boundary end at nodes of both meshes")


def _covered_in_part(cover: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether an edge is covered neither not at all nor once, (n_edges,)."""
    is_covered = cover > COVERED
    is_whole = np.abs(cover - 1.0) <= COVERED
    return np.asarray(is_covered & ~is_whole)


def _first_midpoint(mesh: Mesh, edges: NDArray[np.int64]) -> NDArray[np.float64]:
    """Midpoint of the first of some edges, (2,)."""
    return np.asarray(mesh.nodes[edges[0]].mean(axis=0))
