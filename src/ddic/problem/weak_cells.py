"""Cells beside what is excluded that hold one of their nodes by a few pixels only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.shapes import pad_cells
from ddic.problem.exclusions import UNSEEN, Exclusions, exclude, find_excluded
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews

Array = NDArray[np.float64]

LEAST_HELD = 0.1
"""Diagonal of M of a node beside what is excluded, relative to that of a node of the region in the mean, below which
the cells about it are excluded as well. A larger share loses more of them, a smaller one leaves nodes to noise."""


def exclude_weak_cells(whole: ResidualModel, excluded: Exclusions) -> Exclusions:
    """Exclude also the cells beside that hold one of their nodes by a few pixels only; collective.

    Parameters
    ----------
    whole : ResidualModel
        With all pixels that the frame shows.
    excluded : Exclusions
        Of its subdomains.

    Returns
    -------
    Exclusions
        With at most one row of cells more.
    """
    team, views = whole.team, whole.views
    used = exclude(whole, excluded).views
    diagonals = team.together(lambda: [_sum_diagonals(of_subdomain, states)
                                       for of_subdomain, states in zip(used, excluded.cells, strict=True)])
    totals = team.sum(np.array([sum(d.sum() for d in diagonals), sum((d > 0).sum() for d in diagonals)], dtype=float))
    mean = totals[0] / max(totals[1], 1.0)
    beside = set(np.concatenate(team.gather_lists(
        [np.unique(_nodes_of(of_subdomain, _find_lost(of_subdomain, states)))
         for of_subdomain, states in zip(views, excluded.cells, strict=True)])).tolist())
    copies = team.gather_lists([
        (int(number), float(diagonal)) for of_subdomain, of_nodes in zip(views, diagonals, strict=True)
        for number, diagonal in zip(of_subdomain.subdomain.node_ids, of_nodes, strict=True) if int(number) in beside])
    held: dict[int, float] = {}
    for number, diagonal in copies:
        held[number] = held.get(number, 0.0) + diagonal
    weak = np.array(sorted(number for number, diagonal in held.items() if diagonal < LEAST_HELD * mean))
    cells = []
    for of_subdomain, states in zip(views, excluded.cells, strict=True):
        subdomain = of_subdomain.subdomain
        is_weak = np.isin(subdomain.node_ids, weak)[pad_cells(subdomain.mesh)].any(axis=1)
        cells.append(tuple(np.where(is_weak & ~find_excluded(state), UNSEEN, state).astype(np.uint8)
                           for state in states))
    return replace(excluded, cells=cells)


def _find_lost(of_subdomain: FrameViews, states: Sequence[NDArray[np.uint8]]) -> NDArray[np.bool_]:
    """Cells that the reference images show and no camera sees: what they leave out holds no node in any frame."""
    in_reference = np.sum([view.count_pixels() for view in of_subdomain.reference.views], axis=0)
    return np.asarray(np.all([find_excluded(state) for state in states], axis=0) & (in_reference > 0))


def _nodes_of(of_subdomain: FrameViews, cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    subdomain = of_subdomain.subdomain
    return np.asarray(subdomain.node_ids[pad_cells(subdomain.mesh)[cells]]).ravel()


def _sum_diagonals(of_subdomain: FrameViews, states: Sequence[NDArray[np.uint8]]) -> Array:
    """Diagonal of M at the nodes of a subdomain, over components and cameras, (n_nodes,)."""
    mesh = of_subdomain.subdomain.mesh
    total = np.zeros(mesh.n_nodes)
    for view, state in zip(of_subdomain.views, states, strict=True):
        diagonal = np.einsum("cii->ci", view.view.correlation.compute_cell_hessians())
        of_corners = view.view.weight * diagonal.reshape(mesh.n_cells, -1, mesh.dim).sum(axis=2)
        is_used = ~find_excluded(state)
        np.add.at(total, pad_cells(mesh)[is_used], of_corners[is_used])
    return total
