"""Whether every unknown is held by pixels that a frame shows, or by mechanics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.errors import SingularSubdomainError, as_collective
from ddic.functionals.view import View
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.views import FrameViews
from ddic.solvers.singularity import describe_singular


def refuse_undetermined(team: Team, views: Sequence[FrameViews], shown: Sequence[Sequence[View]]) -> None:
    """Refuse a frame that leaves an unknown to nothing: such a one would keep what it started from; collective.

    An unknown is held by a pixel in a cell of a node that it displaces, in any subdomain, or by its row of equilibrium,
    where that is controlled.

    Parameters
    ----------
    team : Team
        All ranks.
    views : sequence of FrameViews
        Owned subdomains in the frame.
    shown : sequence of sequence of View
        Views of each, without the pixels that the frame hides.

    Raises
    ------
    SingularSubdomainError
        On all ranks, with the place.
    """
    candidates = []
    for of_subdomain, of_shown in zip(views, shown, strict=True):
        subdomain = of_subdomain.subdomain
        n_shown = sum(view.n_pixels for view in of_shown)
        if n_shown == sum(view.view.n_pixels for view in of_subdomain.views):
            # Nothing is hidden: the factor of the reference said what holds it.
            continue
        unheld = ~_is_held(subdomain, of_shown) & ~subdomain.controlled
        for place in np.flatnonzero(unheld):
            number = int(subdomain.kinematics.numbers[place])
            candidates.append((number, int(subdomain.multiplicity[place]), _find_position(subdomain, int(place))))
    gathered = team.gather_lists(candidates)
    n_copies = Counter(number for number, _, _ in gathered)
    for number, multiplicity, (x, y) in gathered:
        # Held in none of the subdomains that share it.
        if n_copies[number] == multiplicity:
            raise as_collective(SingularSubdomainError(
                describe_singular(f"the region around column {x:.0f}, row {y:.0f}")))


def _is_held(subdomain: Subdomain, views: Sequence[View]) -> NDArray[np.bool_]:
    """Whether a pixel shown lies in a cell of a node that each unknown of the field displaces, (n_field,)."""
    mesh = subdomain.mesh
    n_pixels = np.sum([view.count_pixels() for view in views], axis=0)
    cell_of_node = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    node_sees = np.zeros(mesh.n_nodes, dtype=bool)
    node_sees[mesh.connectivity[n_pixels[cell_of_node] > 0]] = True
    by_component = np.repeat(node_sees, mesh.dim).astype(np.float64)
    return np.asarray(abs(subdomain.kinematics.tangent).T @ by_component > 0)


def _find_position(subdomain: Subdomain, place: int) -> NDArray[np.float64]:
    """Position of the node that an unknown displaces most, pixels."""
    column = abs(subdomain.kinematics.tangent[:, [place]]).toarray().ravel()
    position: NDArray[np.float64] = subdomain.mesh.nodes[int(column.argmax()) // subdomain.mesh.dim]
    return position
