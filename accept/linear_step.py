"""Is one linear step of the dual solver the one-domain step: same b and q, Krylov tolerance 1e-12."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA, images, mpirun

JOB = Path(__file__).parent / "support" / "linear_step_job.py"
BOUND = 1e-9
ORACLES = {
    "consistent": "consistent weighting against monolithic",
    "paper": "the paper's weighting against monolithic with interface rows weighted 1/sqrt(m)",
    "unregularized": "without regularization against monolithic",
}


def measure() -> list[Row]:
    """One row per variant over 4, 9, 16 subdomains, blocks and METIS, 1 to 4 ranks."""
    folder = images("sinusoidal", "--size", "512x512", "--noise", "2", folder=DATA / "linear_step")
    found: dict[str, list[float]] = {variant: [] for variant in ORACLES}
    for ranks in (1, 2, 3, 4):
        for line in mpirun(ranks, sys.executable, "-m", "mpi4py", str(JOB), str(folder)).splitlines():
            record = json.loads(line)
            append_result("linear_step_runs", record)
            found[record["variant"]].append(record["relative_difference"])
    return [Row(f"one linear step, dual with {oracle}; 4, 9, 16 subdomains, blocks and METIS, 1-4 ranks",
                f"relative difference <= {BOUND:.0e}",
                f"largest of {len(found[variant])}: {max(found[variant]):.1e}", max(found[variant]) <= BOUND)
            for variant, oracle in ORACLES.items()]


if __name__ == "__main__":
    main("linear_step", measure)
