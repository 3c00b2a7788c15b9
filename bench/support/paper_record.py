"""One record of a 29-megapixel case: whole command, phases, memory, errors, rates of the pixel work."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bench.support.paper_case import BenchCase
from bench.support.runs import ddic_run, run_job
from ddic.io.result_reader import Result, read_result
from ddic.mesh.topology import find_boundary_nodes

JOB = "bench.support.paper_pixels_job"
RANKS = 2
PIXEL_KINDS = ("reference", "deformed", "M", "residual")
"""What a run does with pixels; "gradient" is a part of "reference"."""


@dataclass(frozen=True)
class Timed:
    """A run of the command line; wall_s: from the start of mpiexec until it has ended, seconds."""

    summary: dict[str, Any]
    wall_s: float


def timed(text: str, folder: Path, n_ranks: int, name: str) -> Timed:
    """Run a case and look at the clock outside."""
    begin = time.perf_counter()
    summary = ddic_run(text, folder, n_ranks, name)
    return Timed(summary, time.perf_counter() - begin)


def timed_runs(case: BenchCase, repeats: int) -> list[Timed]:
    """Runs on RANKS ranks, quickest first, after one that fills the caches of files and compiled kernels."""
    timed(case.measured, case.folder, RANKS, case.name)
    return sorted((timed(case.measured, case.folder, RANKS, case.name) for _ in range(repeats)), key=lambda r: r.wall_s)


def run_record(case: BenchCase, runs: list[Timed]) -> dict[str, Any]:
    """What the run of median wall time says of itself, and what it measured against the known field."""
    chosen = runs[len(runs) // 2]
    summary = chosen.summary
    result = read_result(case.folder / f"{case.name}.vtkhdf")
    rms, everywhere = errors(case, result)
    passes = summary["iterations"] * summary["n_pixels"]
    return {
        "case": case.name, "bits": case.bits, "covered": case.covered, "n_ranks": RANKS,
        "wall_s": chosen.wall_s, "wall_s_of_runs": [run.wall_s for run in runs],
        "cpu_s_of_phases": sum(summary["cpu_seconds"].values()),
        "memory_total_bytes": sum(summary["peak_memory_bytes"]), "memory_bytes": summary["peak_memory_bytes"],
        "seconds": summary["seconds"], "cpu_seconds": summary["cpu_seconds"],
        "result_bytes": (case.folder / f"{case.name}.vtkhdf").stat().st_size,
        "n_dofs": summary["n_dofs"], "n_subdomains": summary["n_subdomains"], "n_pixels": summary["n_pixels"],
        "iterations": summary["iterations"], "krylov_iterations": summary["krylov_iterations"],
        "cut_off_wavelength": summary["cut_off_wavelength"], "rms_error_px": rms, "rms_error_all_nodes_px": everywhere,
        "largest_jump_px": summary["largest_jump_px"],
        "rhs_mpx_per_s_core_in_run": passes / summary["cpu_seconds"]["residual"] / 1e6,
    }


def errors(case: BenchCase, result: Result) -> tuple[float, float]:
    """RMS error per component, pixels: at nodes more than one element from the mesh's boundary, and at all nodes."""
    nodes = result.mesh.nodes
    error = result.displacement - case.field.displacement(nodes)
    distance, _ = cKDTree(nodes[find_boundary_nodes(result.mesh)]).query(nodes)
    inner = distance > 1.01 * case.element_size
    return _rms(error[inner]), _rms(error)


def monolithic_record(case: BenchCase) -> dict[str, Any]:
    """Difference of the last run's field to the monolithic one, measured now on one rank."""
    name = f"{case.name}_monolithic"
    whole = timed(case.monolithic, case.folder, 1, name)
    one, many = (read_result(case.folder / f"{n}.vtkhdf").displacement for n in (name, case.name))
    return {"monolithic_rms_difference_px": _rms(many - one),
            "monolithic_largest_difference_px": float(np.abs(many - one).max()),
            "monolithic_relative_difference": float(np.linalg.norm(many - one) / np.linalg.norm(one)),
            "monolithic_iterations": whole.summary["iterations"], "monolithic_wall_s": whole.wall_s,
            "monolithic_seconds": whole.summary["seconds"],
            "monolithic_memory_bytes": sum(whole.summary["peak_memory_bytes"])}


def pixel_record(case: BenchCase, iterations: int, repeats: int, passes: int = 1) -> dict[str, Any]:
    """Rates of the pixel work at the measured field, and how much faster two ranks are than one.

    Ranks alternate. The speed-up is that of all pixel work of a run with this many Gauss-Newton iterations: windows of
    f once, windows of g once with a pass, M once, a pass per iteration. Needs the files of ``run_record``'s run.
    passes: how often each job does the work, of which it gives the median. Beside it, what two unrelated runs at once
    do of this work relative to one: cores that share a cache, or have other work, keep two ranks below that.
    """
    found: dict[int, list[dict[str, Any]]] = {1: [], RANKS: []}
    for _ in range(repeats):
        for n_ranks, records in found.items():
            files = (str(case.folder / f"{case.name}{suffix}") for suffix in (".toml", ".vtkhdf"))
            records.extend(run_job(n_ranks, JOB, *files, str(passes)))
    kinds = (*PIXEL_KINDS, "gradient")
    one, two = ({kind: {clock: median(r[kind][clock] for r in records) for clock in ("wall", "cpu", "busiest")}
                 for kind in kinds} for records in found.values())
    n_pixels = found[1][0]["n_pixels"]
    weights = dict(zip(PIXEL_KINDS, (1, 1, 1, iterations), strict=True))

    def total(times: dict[str, dict[str, float]], clock: str) -> float:
        return sum(weights[kind] * times[kind][clock] for kind in PIXEL_KINDS)

    at_once = _run_at_once(case, passes)
    return {
        "pixel_work_of_2_runs_at_once": 2 * total(one, "cpu") / median(total(record, "cpu") for record in at_once),
        "rhs_mpx_per_s_core": n_pixels / two["residual"]["cpu"] / 1e6,
        "lhs_mpx_per_s_core": n_pixels / (two["gradient"]["cpu"] + two["M"]["cpu"]) / 1e6,
        "mpx_per_s_1_rank": {kind: n_pixels / one[kind]["cpu"] / 1e6 for kind in kinds},
        "best_mpx_per_s_1_rank": {kind: n_pixels / min(r[kind]["cpu"] for r in found[1]) / 1e6 for kind in kinds},
        "pixel_speedup_2_ranks": total(one, "wall") / total(two, "wall"),
        "pixel_speedup_2_ranks_cpu": total(one, "cpu") / total(two, "busiest"),
        "pixel_wall_over_cpu": [total(times, "wall") / total(times, "busiest") for times in (one, two)],
        "pixel_speedup_by_kind": {kind: one[kind]["wall"] / two[kind]["wall"] for kind in kinds},
        "pixel_speedup_by_kind_cpu": {kind: one[kind]["cpu"] / two[kind]["busiest"] for kind in kinds},
        "pixel_seconds_1_rank": one, "pixel_seconds_2_ranks": two,
    }


def _run_at_once(case: BenchCase, passes: int) -> list[dict[str, Any]]:
    """Records of RANKS unrelated jobs of one rank that run at the same time: what the machine's cores allow."""
    files = [str(case.folder / f"{case.name}{suffix}") for suffix in (".toml", ".vtkhdf")]
    with ThreadPoolExecutor(RANKS) as pool:
        jobs = [pool.submit(run_job, 1, JOB, *files, str(passes)) for _ in range(RANKS)]
        return [record for job in jobs for record in job.result()]


def _rms(error: NDArray[np.float64]) -> float:
    return float(np.sqrt((error**2).mean()))
