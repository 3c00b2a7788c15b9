"""What the log says of cells and pixels that are excluded, and where they lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ddic.mesh.mesh import pad_cells
from ddic.parallel.team import Team
from ddic.problem.exclusions import BLANK, HELD_OFF, SPOILT, UNSEEN, Exclusions
from ddic.problem.views import FrameViews

Array = NDArray[np.float64]

MOST_PLACES = 3
"""Places that are named; the result file has all of them."""

OTHER_THAN_REFERENCE = "show something else than the reference"
REASONS = {SPOILT: f"{OTHER_THAN_REFERENCE} and are excluded", BLANK: "have no texture and are excluded",
           UNSEEN: "hold no or too few pixels that both images show and are excluded",
           HELD_OFF: "are held by the regularization beside where the images show them; a shorter "
                     "regularization.cut_off_wavelength follows these"}


def describe_exclusions(team: Team, views: Sequence[FrameViews], excluded: Exclusions) -> tuple[str, ...]:
    """Say how many cells and pixels are excluded, why and where; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    views : sequence of FrameViews
        Owned subdomains.
    excluded : Exclusions
        Of them.

    Returns
    -------
    tuple of str
        For the log; nothing where nothing is.
    """
    n_cells = team.sum(sum(of_subdomain.subdomain.mesh.n_cells for of_subdomain in views))
    lines = []
    for reason, why in REASONS.items():
        found = team.gather_lists([_bound_cells(of_subdomain, states[0] == reason)
                                   for of_subdomain, states in zip(views, excluded.cells, strict=True)])
        boxes, corners = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if len(boxes):
            lines.append(f"{len(boxes)} of {n_cells} cells {why} (cell field \"excluded\"): "
                         + "; ".join(_name_places(boxes, corners)))
    n_pixels = team.sum(sum(len(spots) for of_subdomain in excluded.pixels for spots in of_subdomain))
    if n_pixels:
        lines.append(f"{n_pixels} pixels of other cells {OTHER_THAN_REFERENCE} and are excluded")
    return tuple(lines)


def _bound_cells(of_subdomain: FrameViews, chosen: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int64]]:
    """Of some cells: first and last column, first and last row, (n, 4), pixels; and their nodes' numbers, (n, 4)."""
    mesh = of_subdomain.subdomain.mesh
    nodes = pad_cells(mesh)[chosen]
    corners = mesh.nodes[nodes]
    low, high = corners.min(axis=1), corners.max(axis=1)
    boxes = np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]])
    return boxes, of_subdomain.subdomain.node_ids[nodes]


def _name_places(boxes: Array, corners: NDArray[np.int64]) -> list[str]:
    """Boxes of cells that share nodes, the largest first."""
    _, nodes = np.unique(corners, return_inverse=True)
    cells = np.repeat(np.arange(len(boxes)), corners.shape[1])
    n_all = len(boxes) + int(nodes.max()) + 1
    graph = coo_matrix((np.ones(len(cells)), (cells, len(boxes) + nodes.ravel())), (n_all, n_all))
    # Of cells and nodes.
    place = connected_components(graph, directed=False)[1][:len(boxes)]
    n_places = int(place.max()) + 1
    members = np.bincount(place, minlength=n_places)
    named = []
    for k in np.argsort(-members, kind="stable")[:MOST_PLACES]:
        of_place = boxes[place == k]
        named.append(f"columns {of_place[:, 0].min():.0f} to {of_place[:, 1].max():.0f}, rows "
                     f"{of_place[:, 2].min():.0f} to {of_place[:, 3].max():.0f}")
    if n_places > MOST_PLACES:
        named.append(f"{n_places - MOST_PLACES} more places")
    return named
