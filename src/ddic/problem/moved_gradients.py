"""Whether a frame turns or stretches the specimen so much that Gauss-Newton needs the gradient of its image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.moved_gradient import LARGE, compute_inverse_deformations, find_largest_gradient
from ddic.parallel.team import Team
from ddic.problem.views import FrameViews

Array = NDArray[np.float64]

ByView = tuple[Array | None, ...]
"""F^-1 of the cells of a subdomain, as each of its cameras sees them; None for the identity."""


def find_inverse_deformations(of_subdomain: FrameViews, q: Array) -> ByView:
    """Compute F^-1 of the cells of a subdomain.

    Parameters
    ----------
    of_subdomain : FrameViews
        In a frame.
    q : (n_unknowns,) array
        Its unknowns.

    Returns
    -------
    tuple of (n_cells, 2, 2) array
        By camera.
    """
    return tuple(compute_inverse_deformations(view.view.correlation.mesh, view.view.kinematics.displacement(q))
                 for view in of_subdomain.views)


def is_deformation_large(team: Team, views: Sequence[FrameViews], q: Sequence[Array]) -> bool:
    """Tell whether any cell of the region turns or stretches by much; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    views : sequence of FrameViews
        Owned subdomains in a frame.
    q : sequence of (n_unknowns,) array
        Their unknowns.

    Returns
    -------
    bool
        The same on all ranks.
    """
    largest = [find_largest_gradient(view.view.correlation.mesh, view.view.kinematics.displacement(q_s))
               for of_subdomain, q_s in zip(views, q, strict=True) for view in of_subdomain.views]
    return bool(team.maximum(max(largest, default=0.0)) > LARGE)
