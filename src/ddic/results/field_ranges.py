"""Between which values a field lies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.strain import compute_strain
from ddic.mesh.mesh import Mesh, join_meshes
from ddic.parallel.team import Team
from ddic.results.summary import FieldRanges

Array = NDArray[np.float64]


def find_field_ranges(team: Team, fields: Sequence[tuple[Mesh, Array]]) -> FieldRanges:
    """Find the least and largest displacement of nodes and strain of cells; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    fields : sequence of (Mesh, (n_dofs,) array)
        Meshes that this rank owns and the displacement of their nodes, node by node, pixels; nan where it was not
        measured.

    Returns
    -------
    FieldRanges
        Of what was measured, the same on all ranks; nan where nothing was.
    """
    meshes, displacements = zip(*fields, strict=True)
    limits = team.gather_lists([_find_limits(join_meshes(meshes), np.concatenate(displacements))])
    # fmin and fmax take the number of a number and nan.
    least = np.fmin.reduce([low for low, _ in limits], axis=0).tolist()
    largest = np.fmax.reduce([high for _, high in limits], axis=0).tolist()
    by_component = list(zip(least, largest, strict=True))
    return FieldRanges(dict(zip(("x", "y"), by_component[:2], strict=True)),
                       dict(zip(("xx", "yy", "xy"), by_component[2:], strict=True)))


def _find_limits(mesh: Mesh, u: Array) -> tuple[Array, Array]:
    """Least and largest of (u_x, u_y, e_xx, e_yy, e_xy), (5,) each; nan where nothing was measured."""
    displacement, strain = u.reshape(-1, mesh.dim), compute_strain(mesh, u).infinitesimal
    return (np.concatenate([np.fmin.reduce(displacement, axis=0), np.fmin.reduce(strain, axis=0)]),
            np.concatenate([np.fmax.reduce(displacement, axis=0), np.fmax.reduce(strain, axis=0)]))
