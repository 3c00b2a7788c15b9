"""The ddic side of bench/peers.py: CPU seconds from images on disk to the field in memory, all ranks summed."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import cv2
from mpi4py import MPI

from ddic.case.loader import LoadedCase, load_case
from ddic.inputs.inputs import open_inputs
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.run import gather_phase_times, write_times
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.publishing import publish


def measure_seconds(team: Team, loaded: LoadedCase) -> tuple[float, dict[str, float], int]:
    """Measure a case; its field goes to its file, before which the clock stops.

    Parameters
    ----------
    team : Team
        Ranks.
    loaded : LoadedCase
        The case.

    Returns
    -------
    seconds : float
        CPU seconds of all ranks together.
    phases : dict
        The same by phase.
    iterations : int
        Of Gauss-Newton.
    """
    clock = PhaseClock()
    team.wait_for_all()
    start = time.process_time()
    inputs, frame = open_inputs(team, loaded)
    with DecomposedSession(team, inputs, Silence(), clock, frame) as session:
        measurement = session.measure(frame)
        seconds = time.process_time() - start
    times = gather_phase_times(team, clock)
    publish(measurement, loaded.case.output.file, add=lambda writer: write_times(writer, times))
    by_rank = team.gather_lists([clock.cpu])
    phases = {str(phase): float(sum(cpu.get(phase, 0.0) for cpu in by_rank)) for phase in clock.cpu}
    return float(sum(team.gather_lists([seconds]))), phases, len(measurement.records)


def main(warm_up: str, case: str) -> None:
    cv2.setNumThreads(1)
    team = Team(MPI.COMM_WORLD)
    # A tiny pair first: it compiles the kernels, or loads those that were compiled before.
    measure_seconds(team, load_case(Path(warm_up)))
    seconds, phases, iterations = measure_seconds(team, load_case(Path(case)))
    if team.is_root:
        print(json.dumps({"cpu_seconds": seconds, "phases": phases, "iterations": iterations}), flush=True)


main(*sys.argv[1:])
