"""Strains at the nodes of a measured field, as the result file has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.kinematics.strain import (
    compute_green_lagrange,
    compute_hencky,
    compute_infinitesimal,
    compute_von_mises_strain,
    find_principal_strains,
)
from ddic.mesh.mesh import join_meshes
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

Array = NDArray[np.float64]


def recover_nodal_gradients(team: Team, subdomains: Sequence[Subdomain], displacements: Sequence[Array]) -> list[Array]:
    """Recover the displacement gradient at the nodes of all subdomains; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        This rank's.
    displacements : sequence of (n_dofs,) array
        Of their nodes, the same at copies of a node, pixels.

    Returns
    -------
    list of (n_nodes, 2, 2) array
        du_c / dx_j, no unit; one value a node, whatever the partition.
    """
    mesh = join_meshes([subdomain.mesh for subdomain in subdomains])
    ends = np.cumsum([subdomain.mesh.n_nodes for subdomain in subdomains])[:-1]

    def sum_shared(sums: Sequence[Array]) -> list[Array]:
        return [np.concatenate(sum_shared_nodes(team, subdomains, np.split(sums[0], ends)))]

    gradients, = recover_gradients([mesh], [np.concatenate(displacements)], sum_shared)
    return np.split(gradients, ends)


def describe_nodal_strains(gradients: Array) -> dict[str, NDArray[Any]]:
    """Compute all strains that the result file has at points.

    Parameters
    ----------
    gradients : (n, 2, 2) array
        du_c / dx_j, no unit.

    Returns
    -------
    dict of (n,) or (n, 6) array
        By name of the field, no unit.
    """
    large = compute_green_lagrange(gradients)
    hencky = compute_hencky(large)
    first, second = find_principal_strains(hencky).T
    return {
        schema.NODAL_INFINITESIMAL: convert_to_six_components(compute_infinitesimal(gradients)),
        schema.NODAL_GREEN_LAGRANGE: convert_to_six_components(large),
        schema.NODAL_HENCKY: convert_to_six_components(hencky),
        schema.NODAL_PRINCIPAL_1: first,
        schema.NODAL_PRINCIPAL_2: second,
        schema.NODAL_VON_MISES: compute_von_mises_strain(hencky),
    }


def convert_to_six_components(tensor: Array) -> Array:
    """Write tensors in the plane as VTK does.

    Parameters
    ----------
    tensor : (n, 3) array
        xx, yy, xy.

    Returns
    -------
    (n, 6) array
        xx, yy, zz, xy, yz, xz.
    """
    zero = np.zeros(len(tensor))
    return np.stack([tensor[:, 0], tensor[:, 1], zero, tensor[:, 2], zero, zero], axis=1)
