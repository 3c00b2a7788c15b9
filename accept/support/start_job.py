"""The MPI part of ``accept.large_pairs``: measures a case, prints from rank 0 how long its start took.

Usage: start_job CASE, a case file beside the truth of its images. It runs with older sources too.
"""

from __future__ import annotations

import json
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ddic.case.loader import load_case
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.publishing import gather
from ddic.synth.truth import load_truth

STAGES = (Phase.START, Phase.INDEPENDENT_START)
"""All that is done before Gauss-Newton on the whole mesh, but for reading and assembling what it needs itself; the
reading of both images to bin them is part of it."""


def _import_names() -> tuple[Any, Any]:
    """``open_inputs`` and the class of a session, which 73864c3, beside which starts are timed, names otherwise."""
    method = import_module("ddic.methods.dd_dic")
    if find_spec("ddic.inputs") is None:
        return import_module("ddic.problem.inputs").open_inputs, method.Session
    return import_module("ddic.inputs.inputs").open_inputs, method.DecomposedSession


def measure_start(team: Team, path: Path) -> None:
    """Measure a case; collective."""
    open_inputs, session_class = _import_names()
    clock = PhaseClock(waiting=team.waiting)
    inputs, frame = open_inputs(team, load_case(path))
    team.wait_for_all()
    with session_class(team, inputs, Silence(), clock, frame) as session:
        result = gather(session.measure(frame))
    truth = load_truth(path.with_name("truth.json")).displacement(result.mesh.nodes)
    largest = float(np.linalg.norm(result.displacement - truth, axis=1).max())
    of_ranks = team.gather_lists([[sum(seconds.get(stage, 0.0) for stage in STAGES)
                                   for seconds in (clock.wall, clock.busy)]])
    wall, busy = np.max(of_ranks, axis=0)
    if team.is_root:
        print(json.dumps({"wall": wall, "busy": busy, "largest": largest}), flush=True)


measure_start(Team(MPI.COMM_WORLD), Path(sys.argv[1]))
