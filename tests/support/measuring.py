"""Measure case files as a run does, without writing results, and bring the field together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.inputs.inputs import open_inputs
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.mesh import Mesh
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Listener, Silence
from ddic.results.measurement import Measurement

Choice = Callable[[Mesh], RegionKinematics]
"""From the whole mesh to its kinematics."""


def measure(team: Team, path: Path, listener: Listener | None = None,
            choose_kinematics: Choice | None = None, clock: PhaseClock | None = None) -> Measurement:
    """Measure the case's one frame; collective."""
    clock = clock or PhaseClock()
    inputs, frame = open_inputs(team, load_case(path))
    inputs = replace(inputs, choose_kinematics=choose_kinematics)
    with DecomposedSession(team, inputs, listener or Silence(), clock, frame) as session:
        return session.measure(frame)


def whole_field(measurement: Measurement) -> NDArray[np.float64]:
    """Displacement of all nodes, (n_nodes, 2), on all ranks."""
    whole = np.full((measurement.region.n_nodes, 2), np.nan)
    mine = [(s.node_ids, u) for s, u in zip(measurement.subdomains, measurement.displacements, strict=True)]
    for node_ids, u in measurement.team.gather_lists(mine):
        whole[node_ids] = u.reshape(-1, 2)
    return whole


def field_on_one_rank(path: Path, choose_kinematics: Choice | None = None) -> NDArray[np.float64]:
    """The field that rank 0 finds by itself, (n_nodes, 2), on all ranks."""
    field = None
    if MPI.COMM_WORLD.rank == 0:
        field = whole_field(measure(Team.alone(), path, choose_kinematics=choose_kinematics))
    return np.asarray(MPI.COMM_WORLD.bcast(field))


def subdomain_numbers(measurement: Measurement) -> list[int]:
    """Of all ranks' subdomains, rank by rank."""
    return measurement.team.gather_lists([s.index for s in measurement.subdomains])
