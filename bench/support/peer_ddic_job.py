"""The ddic side of bench/peers.py: CPU seconds from images on disk to the field in memory, all ranks summed."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import cv2
from ddic.results.publish import publish
from mpi4py import MPI

from ddic.case.loader import LoadedCase, load_case
from ddic.methods.dd_dic import dd_dic
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.phase_times import gather_phase_times


def measured_seconds(team: Team, loaded: LoadedCase) -> tuple[float, dict[str, float], int]:
    """CPU seconds of all ranks together, the same by phase, and Gauss-Newton iterations; the field goes to its file.

    The clock stops before the file.
    """
    clock = PhaseClock()
    team.comm.Barrier()
    start = time.process_time()
    measurement = dd_dic(team, loaded.case, Silence(), clock)
    seconds = time.process_time() - start
    publish(team, loaded, measurement, gather_phase_times(team, clock))
    by_rank = team.gather_lists([clock.cpu])
    phases = {name: sum(cpu.get(name, 0.0) for cpu in by_rank) for name in clock.cpu}
    return sum(team.gather_lists([seconds])), phases, len(measurement.records)


def main(warm_up: str, case: str) -> None:
    cv2.setNumThreads(1)
    team = Team(MPI.COMM_WORLD)
    # A tiny pair first: it compiles the kernels, or loads those that were compiled before.
    measured_seconds(team, load_case(Path(warm_up)))
    seconds, phases, iterations = measured_seconds(team, load_case(Path(case)))
    if team.is_root:
        print(json.dumps({"cpu_seconds": seconds, "phases": phases, "iterations": iterations}), flush=True)


main(*sys.argv[1:])
