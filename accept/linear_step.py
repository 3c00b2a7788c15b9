"""Is one linear step of the dual solver the one-domain step: same b and q, Krylov tolerance 1e-12.

Under MPI, as python -m accept.linear_step FOLDER SIZE VARIANT ..., with the folder of an image pair, the side of its
images in pixels and variants, rank 0 prints a JSON line for each variant and partition.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse.linalg import splu

from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import images, run_job
from bench.support.step_problem import (
    StepProblem,
    correct_monolithically,
    find_relative_difference,
    prepare_step,
    prepare_whole,
    solve_dual,
)
from ddic.case.schema import Case
from ddic.parallel.team import Team
from ddic.problem.linear_solver import choose_preconditioner
from ddic.solvers.dual.dual_step import DualSettings

BOUND = 1e-9
"""Largest relative difference."""

SIZE, SMOKE_SIZE = 512, 192
"""Side of the images, pixels."""

TWO_LEVEL_BOUND, MOST_FLOORS = 1e-8, 10
"""Largest relative difference of two levels, or rounding floors, whichever is larger: two orderings of one LU differ
by a floor."""

TWO_LEVEL_SIZE, TWO_LEVEL_RANKS = 1024, (2, 3, 4)
"""Side of the images, pixels; numbers of ranks."""

JOB = "accept.linear_step"

RANKS = (1, 2, 3, 4)
ORACLES = {
    "consistent": "consistent weighting against monolithic",
    "paper": "the paper's weighting against monolithic with interface rows weighted 1/sqrt(m)",
    "unregularized": "without regularization against monolithic",
}
"""Variants and what they are compared with."""


def measure(scale: Scale) -> list[Row]:
    """Measure a row for each variant: 4, 9, 16 subdomains, blocks and METIS, 1 to 4 ranks."""
    size = SMOKE_SIZE if scale.smoke else SIZE
    folder = images("sinusoidal", "--size", f"{size}x{size}", "--noise", "2", folder=scale.folder("linear_step"))
    found: dict[str, list[float]] = {variant: [] for variant in ORACLES}
    for n_ranks in (2,) if scale.smoke else RANKS:
        for record in run_job(n_ranks, JOB, str(folder), str(size), *ORACLES):
            append_result("linear_step_runs", record)
            found[record["variant"]].append(record["relative_difference"])
    return [Row(f"one linear step, dual with {oracle}; 4, 9, 16 subdomains, blocks and METIS, 1-4 ranks",
                f"relative difference <= {BOUND:.0e}",
                f"largest of {len(found[variant])}: {max(found[variant]):.1e}", max(found[variant]) <= BOUND)
            for variant, oracle in ORACLES.items()]


def measure_two_levels(scale: Scale) -> list[Row]:
    """Measure a row for 16 and for 64 METIS subdomains at l_c = 8 H, by the default of two levels, on 2 to 4 ranks."""
    size = SMOKE_SIZE if scale.smoke else TWO_LEVEL_SIZE
    folder = images("sinusoidal", "--size", f"{size}x{size}", "--noise", "2", folder=scale.folder("two_levels"))
    records = [record for n_ranks in ((2,) if scale.smoke else TWO_LEVEL_RANKS)
               for record in run_job(n_ranks, JOB, str(folder), str(size), "two_levels")]
    rows = []
    for n_subdomains in sorted({record["subdomains"] for record in records}):
        of_partition = [record for record in records if record["subdomains"] == n_subdomains]
        for record in of_partition:
            append_result("linear_step_runs", record)
        largest = max(record["relative_difference"] for record in of_partition)
        floor = max(record["rounding_floor"] for record in of_partition)
        bound = max(TWO_LEVEL_BOUND, MOST_FLOORS * floor)
        iterations = max(record["iterations"] for record in of_partition)
        rows.append(Row(f"one linear step by two levels, l_c = 8 H, {n_subdomains} METIS subdomains, 2-4 ranks, "
                        "against the assembled operator", f"<= {TWO_LEVEL_BOUND:.0e}, or {MOST_FLOORS} rounding floors",
                        f"{largest:.1e}; rounding floor {floor:.1e}; at most {iterations} iterations",
                        largest <= bound))
    return rows


PARTITIONS: dict[str, dict[int, Any]] = {"blocks": {4: [2, 2], 9: [3, 3], 16: [4, 4]}, "metis": {4: 4, 9: 9, 16: 16}}
"""Values of solver.blocks and solver.subdomains by number of subdomains."""

TWO_LEVELS = "two_levels"
TWO_LEVEL_PARTITIONS: dict[str, dict[int, Any]] = {"metis": {16: 16, 64: 64}}
"""The same for two levels, which the default preconditioner takes where l_c is long."""

WAVELENGTHS = {"consistent": 64.0, "paper": 64.0, "unregularized": None}
"""Cut-off wavelengths of the other variants, pixels."""

LONG = 8.0
"""Cut-off wavelength of two levels, sides H of a subdomain."""

MARGIN, ELEMENT = 20, 10
"""Edge without elements and side of the elements, pixels."""


def base_case(folder: str, size: int, wavelength: float | None) -> dict[str, Any]:
    """Give the case of a variant, without ``[solver]``.

    Parameters
    ----------
    folder : str
        Of the image pair.
    size : int
        Side of the images, pixels.
    wavelength : float, optional
        Cut-off wavelength, pixels.

    Returns
    -------
    dict
        Sections.
    """
    end = MARGIN + ELEMENT * ((size - 2 * MARGIN) // ELEMENT)
    base: dict[str, Any] = {
        "images": {"reference": f"{folder}/reference.tif", "deformed": f"{folder}/deformed.tif"},
        "mesh": {"structured": {"region": [MARGIN, MARGIN, end, end], "element_size": ELEMENT}},
    }
    if wavelength is not None:
        base["regularization"] = {"cut_off_wavelength": wavelength}
    return base


def compare_step(team: Team, case: Case, whole: StepProblem) -> tuple[float, int]:
    """Solve one linear step by subdomains and on one domain, from the same random q and b."""
    (subdomain,), (hessians,) = whole.subdomains, whole.hessians
    rng = np.random.default_rng(0)
    q = rng.normal(scale=0.1, size=subdomain.n_unknowns)
    b = hessians[0] @ rng.normal(size=subdomain.n_unknowns)
    problem = prepare_step(team, case)
    shared = problem.count_subdomains()
    weights = shared if case.solver.weighting == "paper" else None
    reference = correct_monolithically(whole, q, b, weights)
    preconditioner = choose_preconditioner(team, case, problem.subdomains)
    settings = DualSettings(preconditioner, case.solver.tolerance, case.solver.max_iterations)
    result = solve_dual(problem, settings, q, b / shared)
    return find_relative_difference(problem, result.dq, reference), result.krylov_iterations


def find_rounding_floor(whole: StepProblem) -> float:
    """Find by how much two orderings of a sparse LU of the same operator differ."""
    (system,) = whole.assemble().systems
    b = system.hessian @ np.random.default_rng(0).normal(size=system.hessian.shape[0])
    operator = system.operator.tocsc()
    one, other = (splu(operator, permc_spec=ordering).solve(b) for ordering in ("COLAMD", "MMD_AT_PLUS_A"))
    return float(np.abs(one - other).max() / np.abs(one).max())


def find_wavelength(variant: str, size: int, n_subdomains: int) -> float | None:
    """Find the cut-off wavelength of a variant.

    Parameters
    ----------
    variant : str
        One of WAVELENGTHS, or TWO_LEVELS.
    size : int
        Side of the images, pixels.
    n_subdomains : int
        Of the partition.

    Returns
    -------
    float or None
        Pixels; None without regularization.
    """
    if variant != TWO_LEVELS:
        return WAVELENGTHS[variant]
    side = (size - 2 * MARGIN) / np.sqrt(n_subdomains)
    return float(LONG * side)


def main(folder: str, size: str, *variants: str) -> None:
    """Compare variants on all of their partitions with at least a subdomain for each rank."""
    team = Team(MPI.COMM_WORLD)
    for variant in variants:
        partitions = TWO_LEVEL_PARTITIONS if variant == TWO_LEVELS else PARTITIONS
        for kind, splits in partitions.items():
            for count, split in splits.items():
                if count < team.size:
                    continue
                base = base_case(folder, int(size), find_wavelength(variant, int(size), count))
                whole = prepare_whole(Case.model_validate(base))
                key = "blocks" if kind == "blocks" else "subdomains"
                solver = {"partition": kind, "tolerance": 1e-12, key: split,
                          "weighting": "paper" if variant == "paper" else "consistent"}
                case = Case.model_validate({**base, "solver": solver})
                difference, iterations = compare_step(team, case, whole)
                if team.is_root:
                    record = {"variant": variant, "partition": kind, "subdomains": count, "ranks": team.size,
                              "relative_difference": difference, "iterations": iterations}
                    if variant == TWO_LEVELS:
                        record["rounding_floor"] = find_rounding_floor(whole)
                    print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
