"""Ranges of a field that several ranks own."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from ddic.mesh.structured import build_structured_mesh
from ddic.parallel.team import Team
from ddic.results.summary import find_field_ranges


@pytest.mark.parallel([1, 3])
def test_ranges_are_those_of_all_parts() -> None:
    team = Team(MPI.COMM_WORLD)
    parts = []
    for number in range(team.rank, 6, team.size):
        mesh = build_structured_mesh((0.0, 0.0, 20.0, 20.0), 10.0, "Q4")
        x, y = mesh.nodes.T
        # u = (n x, -n y) / 1000: the strain of a part is its number.
        parts.append((mesh, 1e-3 * number * np.column_stack([x, -y]).ravel()))
    found = find_field_ranges(team, parts)
    assert found.displacement_px == {"x": pytest.approx((0.0, 0.1)), "y": pytest.approx((-0.1, 0.0))}
    assert found.strain == {"xx": pytest.approx((0.0, 0.005)), "yy": pytest.approx((-0.005, 0.0)),
                            "xy": pytest.approx((0.0, 0.0), abs=1e-12)}


@pytest.mark.parallel([1, 3])
def test_ranges_are_those_of_what_was_measured() -> None:
    team = Team(MPI.COMM_WORLD)
    parts = []
    for number in range(team.rank, 6, team.size):
        mesh = build_structured_mesh((0.0, 0.0, 20.0, 20.0), 10.0, "Q4")
        x, y = mesh.nodes.T
        u = 1e-3 * number * np.column_stack([x, -y])
        # Of the last part nothing was measured, of the one before a row of nodes not.
        u[(x == 20.0) & (number >= 4) | (number == 5)] = np.nan
        parts.append((mesh, u.ravel()))
    found = find_field_ranges(team, parts)
    assert found.displacement_px == {"x": pytest.approx((0.0, 0.06)), "y": pytest.approx((-0.08, 0.0))}
    assert found.strain == {"xx": pytest.approx((0.0, 0.004)), "yy": pytest.approx((-0.004, 0.0)),
                            "xy": pytest.approx((0.0, 0.0), abs=1e-12)}


@pytest.mark.parallel([1, 3])
def test_there_are_no_ranges_where_nothing_was_measured() -> None:
    mesh = build_structured_mesh((0.0, 0.0, 20.0, 20.0), 10.0, "Q4")
    found = find_field_ranges(Team(MPI.COMM_WORLD), [(mesh, np.full(mesh.n_dofs, np.nan))])
    assert np.isnan([*found.displacement_px.values(), *found.strain.values()]).all()
