"""The MPI part of ``accept.linear_step``: prints a JSON line for each variant and partition from rank 0.

Usage: linear_step_job FOLDER SIZE VARIANT ...: the folder of an image pair, the side of its images in pixels, variants.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse.linalg import splu

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
    """Solve one linear step by subdomains and on one domain, from the same random q and b.

    Parameters
    ----------
    team : Team
        Ranks.
    case : Case
        With the partition.
    whole : StepProblem
        The one-domain problem.

    Returns
    -------
    difference : float
        Relative to the largest correction.
    iterations : int
        Of the Krylov solver.
    """
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
    """Find by how much two orderings of a sparse LU of the same operator differ.

    Parameters
    ----------
    whole : StepProblem
        The one-domain problem.

    Returns
    -------
    float
        Relative to the largest entry of the correction.
    """
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
    """Compare variants on all of their partitions with at least a subdomain for each rank.

    Parameters
    ----------
    folder, size : str
        Of the command line.
    *variants : str
        Of WAVELENGTHS, or TWO_LEVELS.
    """
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


main(*sys.argv[1:])
