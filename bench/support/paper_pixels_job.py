"""The pixel work of a case on some ranks, timed by kind: arguments are the case file, a result file and repeats.

The result gives the displacement at which residuals are taken, since pixels that stay on the grid would be easier than
any measurement. Rank 0 prints one JSON line: wall seconds between barriers, CPU seconds of all ranks and of the busiest
rank, medians over the repeats; the first repeat loads the compiled kernels and is left out.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.case.schema import Case
from ddic.images.spline import HALO, PADDING
from ddic.images.sub_image import read_reference
from ddic.images.window import shared_windows
from ddic.io.result_reader import read_result
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import own_parts, seen_parts
from ddic.problem.inputs import ImagePair, open_pair, share_out
from ddic.problem.mesh_source import build_mesh
from ddic.solvers.gauss_newton import evaluate, right_hand_sides

Times = dict[str, tuple[float, float]]


class Stopwatch:
    """Wall (between barriers) and CPU seconds of each kind of work on this rank."""

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self.times: Times = {}

    def __call__(self, kind: str, work: Callable[[], Any]) -> Any:
        """Do the work of all ranks and note what it took."""
        self._comm.Barrier()
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        spent = time.process_time() - cpu
        self._comm.Barrier()
        self.times[kind] = (time.perf_counter() - wall, spent)
        return result


def once(team: Team, case: Case, pair: ImagePair, subdomains: list[Subdomain], q: list[NDArray[np.float64]]) -> Times:
    """Each kind of work once, from files to right-hand sides, on all subdomains of this rank."""
    degree, correction = case.correlation.spline_degree, case.correlation.grey_correction
    watch = Stopwatch(team.comm)

    def residual_pass() -> None:
        residuals, grey = evaluate(team, parts, q, correction)
        right_hand_sides(parts, residuals, grey, correction)

    parts = watch("reference", lambda: own_parts(subdomains, pair, degree))
    watch("deformed", lambda: seen_parts(parts, q))
    rasters = [p.view.correlation.raster.window for p in parts]
    shared = shared_windows(rasters, HALO[degree] + PADDING[degree])
    watch("gradient", lambda: [read_reference(pair.reference, window, degree) for window, _ in shared])
    watch("M", lambda: [p.view.correlation.compute_cell_hessians() for p in parts])
    watch("residual", residual_pass)
    return watch.times


def main(case_file: str, result_file: str, repeats: str) -> None:
    team = Team(MPI.COMM_WORLD)
    case = load_case(Path(case_file)).case
    pair = open_pair(case)
    image = pair.reference.image
    mesh = build_mesh(case, image.width, image.height) if team.is_root else None
    subdomains, _ = share_out(team, case, mesh)
    displacement = read_result(Path(result_file)).displacement
    q = [displacement[s.node_ids].ravel() for s in subdomains]
    runs = [once(team, case, pair, subdomains, q) for _ in range(int(repeats) + 1)][1:]
    pixels = [p.view.correlation.n_usable_pixels for p in own_parts(subdomains, pair, case.correlation.spline_degree)]
    n_pixels = sum(team.gather_lists(pixels))
    record: dict[str, Any] = {"n_ranks": team.size, "n_pixels": n_pixels}
    for kind in runs[0]:
        wall = float(np.median([run[kind][0] for run in runs]))
        cpus = team.gather_lists([float(np.median([run[kind][1] for run in runs]))])
        record[kind] = {"wall": wall, "cpu": sum(cpus), "busiest": max(cpus)}
    if team.is_root:
        print(json.dumps(record))


main(*sys.argv[1:])
