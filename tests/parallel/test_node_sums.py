"""Sums at shared nodes do not depend on who owns which subdomain."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from ddic.kinematics.nodal import NodalRegion
from ddic.parallel.distribution import split_evenly, sum_shared_nodes
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Subdomain
from support.pictures import square_mesh

MESH = square_mesh(0.0, 144.0)


def split(n_subdomains: int) -> list[Subdomain]:
    # Cells of one subdomain lie apart: nodes are shared by up to four.
    parts = np.arange(MESH.n_cells) % n_subdomains
    return build_subdomains(NodalRegion(MESH), parts, np.zeros(MESH.n_dofs, dtype=bool))


@pytest.mark.parallel([1, 2, 3, 4])
@pytest.mark.parametrize("n_subdomains", [4, 7])
def test_sums_are_those_in_the_order_of_subdomains_to_the_last_bit(n_subdomains: int) -> None:
    team, subdomains = Team(MPI.COMM_WORLD), split(n_subdomains)
    values = [np.random.default_rng(s.index).normal(size=(s.mesh.n_nodes, 3)) for s in subdomains]
    expected = np.zeros((MESH.n_nodes, 3))
    for subdomain, of_subdomain in zip(subdomains, values, strict=True):
        expected[subdomain.node_ids] += of_subdomain
    own = split_evenly(np.ones(n_subdomains), team.size)[team.rank]
    kept = [values[k].copy() for k in own]
    found = sum_shared_nodes(team, [subdomains[k] for k in own], [values[k] for k in own])
    for k, of_subdomain, before in zip(own, found, kept, strict=True):
        np.testing.assert_array_equal(of_subdomain, expected[subdomains[k].node_ids])
        np.testing.assert_array_equal(values[k], before)


@pytest.mark.parallel(1)
def test_one_subdomain_shares_nothing() -> None:
    subdomain, = split(1)
    values = np.arange(2.0 * subdomain.mesh.n_nodes).reshape(-1, 2)
    np.testing.assert_array_equal(sum_shared_nodes(Team.alone(), [subdomain], [values])[0], values)
