"""What the log says of cells and pixels that are excluded, and where they lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ddic.mesh.shapes import pad_cells
from ddic.parallel.team import Team
from ddic.problem.exclusions import BLANK, SPOILT, UNSEEN, Exclusions
from ddic.problem.views import FrameViews

Array = NDArray[np.float64]

MOST_PLACES = 3
"""Places that are named; the result file has all of them."""

REASONS = {SPOILT: "show something else than the reference", BLANK: "have no texture",
           UNSEEN: "hold no or too few pixels that both images show"}


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
        boxes = np.concatenate(team.gather_lists([
            _bound_cells(of_subdomain, states[0] == reason)
            for of_subdomain, states in zip(views, excluded.cells, strict=True)]))
        if len(boxes):
            lines.append(f"{len(boxes)} of {n_cells} cells {why} and are excluded (cell field \"excluded\"): "
                         + "; ".join(_name_places(boxes)))
    n_pixels = team.sum(sum(len(spots) for of_subdomain in excluded.pixels for spots in of_subdomain))
    if n_pixels:
        lines.append(f"{n_pixels} pixels of other cells {REASONS[SPOILT]} and are excluded")
    return tuple(lines)


def _bound_cells(of_subdomain: FrameViews, chosen: NDArray[np.bool_]) -> Array:
    """First and last column, first and last row of some cells, (n, 4), pixels."""
    mesh = of_subdomain.subdomain.mesh
    corners = mesh.nodes[pad_cells(mesh)[chosen]]
    low, high = corners.min(axis=1), corners.max(axis=1)
    return np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]])


def _name_places(boxes: Array) -> list[str]:
    """Boxes of cells that touch each other, the largest first."""
    centres = np.column_stack([boxes[:, :2].mean(axis=1), boxes[:, 2:].mean(axis=1)])
    size = float(np.ptp(boxes[:, :2], axis=1).max())
    pairs = cKDTree(centres).query_pairs(1.5 * size, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(boxes), len(boxes)))
    n_places, place = connected_components(graph, directed=False)
    members = np.bincount(place, minlength=n_places)
    named = []
    for k in np.argsort(-members, kind="stable")[:MOST_PLACES]:
        of_place = boxes[place == k]
        named.append(f"columns {of_place[:, 0].min():.0f} to {of_place[:, 1].max():.0f}, rows "
                     f"{of_place[:, 2].min():.0f} to {of_place[:, 3].max():.0f}")
    if n_places > MOST_PLACES:
        named.append(f"{n_places - MOST_PLACES} more places")
    return named
