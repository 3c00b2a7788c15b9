"""Is one linear step of the dual solver the one-domain step: same b and q, Krylov tolerance 1e-12."""

from __future__ import annotations

from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import images, run_job

BOUND = 1e-9
"""Largest relative difference."""

SIZE, SMOKE_SIZE = 512, 192
"""Side of the images, pixels."""

TWO_LEVEL_BOUND, MOST_FLOORS = 1e-8, 10
"""Largest relative difference of two levels, or rounding floors, whichever is larger: two orderings of one LU differ
by a floor."""

TWO_LEVEL_SIZE, TWO_LEVEL_RANKS = 1024, (2, 3, 4)
"""Side of the images, pixels; numbers of ranks."""

JOB = "accept.support.linear_step_job"

RANKS = (1, 2, 3, 4)
ORACLES = {
    "consistent": "consistent weighting against monolithic",
    "paper": "the paper's weighting against monolithic with interface rows weighted 1/sqrt(m)",
    "unregularized": "without regularization against monolithic",
}
"""Variants of ``accept.support.linear_step_job`` and what they are compared with."""


def measure(scale: Scale) -> list[Row]:
    """Measure a row for each variant: 4, 9, 16 subdomains, blocks and METIS, 1 to 4 ranks.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image and two ranks.

    Returns
    -------
    list of Row
        Largest relative differences.
    """
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
    """Measure a row for 16 and for 64 METIS subdomains at l_c = 8 H, where the default is two levels, on 2 to 4 ranks.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image and two ranks.

    Returns
    -------
    list of Row
        Largest relative differences, beside the rounding floor of the same operator.
    """
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
