"""Whether a frame turns or stretches the specimen so much that Gauss-Newton needs the gradient of its image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.moved_gradient import LARGE_SHARE, compute_inverse_deformations, find_large_gradients
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
    """Tell whether more than a few cells of the region turn or stretch by much; collective.

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
    n_pixels, n_large = 0, 0
    for of_subdomain, q_s in zip(views, q, strict=True):
        own = of_subdomain.views[0].view
        # By pixels: cells about a crack's tip are small and many.
        of_cells = own.count_pixels()
        is_large = find_large_gradients(own.correlation.mesh, own.kinematics.displacement(q_s))
        n_pixels += int(of_cells.sum())
        n_large += int(of_cells[is_large].sum())
    return bool(team.sum(n_large) > LARGE_SHARE * team.sum(n_pixels))
