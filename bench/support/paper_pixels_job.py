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
from ddic.images.spline import HALO, PADDING
from ddic.images.sub_image import read_reference
from ddic.images.window import merge_windows
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.io.result_reader import read_result
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.reference_problem import read_reference_views
from ddic.problem.region_mesh import build_region_mesh, scatter_region, split_region
from ddic.problem.residual_model import ResidualModel, open_frame_views, read_frame_windows

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


def do_once(team: Team, inputs: Inputs, frame: Frame, subdomains: list[Subdomain],
            q: list[NDArray[np.float64]]) -> Times:
    """Do each kind of work once, from files to right-hand sides, on all subdomains of this rank.

    Parameters
    ----------
    team : Team
        Ranks.
    inputs : Inputs
        Reference images and settings.
    frame : Frame
        Deformed images.
    subdomains : list of Subdomain
        Of this rank.
    q : list of (n_unknowns,) arrays
        Their unknowns, pixels.

    Returns
    -------
    dict
        Wall and CPU seconds by kind.
    """
    case, (camera,) = inputs.case, inputs.cameras
    degree = case.correlation.spline_degree
    watch = Stopwatch(team.comm)
    references = watch("reference", lambda: read_reference_views(case, inputs.cameras, subdomains))
    views = open_frame_views(case, frame, references)
    watch("deformed", lambda: read_frame_windows(views, q))
    rasters = [own.correlation.raster.window for own, *_ in references]
    shared = merge_windows(rasters, HALO[degree] + PADDING[degree])
    watch("gradient", lambda: [read_reference(camera.reference, window, degree) for window, _ in shared])
    watch("M", lambda: [own.correlation.compute_cell_hessians() for own, *_ in references])
    model = ResidualModel(team, subdomains, views, case.correlation.correction_of_start)
    watch("residual", lambda: model.linearize(Field(team, subdomains, q)))
    return watch.times


def main(case_file: str, result_file: str, repeats: str) -> None:
    """Time the pixel work of a case, kind by kind.

    Parameters
    ----------
    case_file, result_file, repeats : str
        Of the command line.
    """
    team = Team(MPI.COMM_WORLD)
    inputs, frame = open_inputs(team, load_case(Path(case_file)))
    whole = team.build_on_root(lambda: build_region_mesh(inputs))
    parts = None if whole is None else split_region(whole, team.size)
    subdomains, _ = scatter_region(team, inputs, whole, parts)
    displacement = read_result(Path(result_file)).displacement
    q = [displacement[s.node_ids].ravel() for s in subdomains]
    runs = [do_once(team, inputs, frame, subdomains, q) for _ in range(int(repeats) + 1)][1:]
    pixels = [own.n_pixels for own, *_ in read_reference_views(inputs.case, inputs.cameras, subdomains)]
    n_pixels = sum(team.gather_lists(pixels))
    record: dict[str, Any] = {"n_ranks": team.size, "n_pixels": n_pixels}
    for kind in runs[0]:
        wall = float(np.median([run[kind][0] for run in runs]))
        cpus = team.gather_lists([float(np.median([run[kind][1] for run in runs]))])
        record[kind] = {"wall": wall, "cpu": sum(cpus), "busiest": max(cpus)}
    if team.is_root:
        print(json.dumps(record))


main(*sys.argv[1:])
