"""Is one linear step of the dual solver the one-domain step: same b and q, Krylov tolerance 1e-12."""

from __future__ import annotations

from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import images, run_job

BOUND = 1e-9
"""Largest relative difference."""

SIZE, SMOKE_SIZE = 512, 192
"""Side of the images, pixels."""

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
        for record in run_job(n_ranks, "accept.support.linear_step_job", str(folder), str(size)):
            append_result("linear_step_runs", record)
            found[record["variant"]].append(record["relative_difference"])
    return [Row(f"one linear step, dual with {oracle}; 4, 9, 16 subdomains, blocks and METIS, 1-4 ranks",
                f"relative difference <= {BOUND:.0e}",
                f"largest of {len(found[variant])}: {max(found[variant]):.1e}", max(found[variant]) <= BOUND)
            for variant, oracle in ORACLES.items()]
