"""Memory and time of the two-level set-up of one subdomain, with a dense and with a sparse inverse of S_s.

Usage: python -m bench.local_inverse [ELEMENTS_PER_SIDE ...]; 20 50 100 200 300 by default. The subdomain has
neighbours on all sides and a rank of its own, every measurement a process of its own. The cut-off wavelength is four
times the subdomain's side, from where on two levels are the default.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA, images, run_job

JOB = "bench.support.local_inverse_job"
CELL = 8
RING = 10
LONG = 4
"""Cut-off wavelength, sides of the subdomain."""
BOUND = 2 * 2**30
JUDGED = 300


def measure_one(elements: int, kind: str) -> dict[str, Any]:
    """One measurement in fresh processes."""
    n = elements + 2 * RING
    size = n * CELL + 64
    folder = images("sinusoidal", "--size", f"{size}x{size}", "--noise", "2", folder=DATA / f"local_inverse_{elements}")
    job = {
        "case": {
            "images": {"reference": f"{folder}/reference.tif", "deformed": f"{folder}/deformed.tif"},
            "mesh": {"structured": {"region": [32, 32, 32 + n * CELL, 32 + n * CELL], "element_size": CELL}},
            "regularization": {"cut_off_wavelength": LONG * elements * CELL},
        },
        "elements": elements, "ring": RING, "kind": kind,
    }
    record = {"elements_per_side": elements, "local_inverse": kind, **run_job(2, JOB, json.dumps(job))[-1]}
    append_result("local_inverse_runs", record)
    return record


def row(record: dict[str, Any]) -> Row:
    """One line of the table; the bound holds for the sparse inverse of the largest subdomain."""
    peak, before = record["peak_bytes"], record["before_factorization_bytes"]
    judged = record["elements_per_side"] == JUDGED and record["local_inverse"] == "sparse"
    return Row(
        f"{record['elements_per_side']} x {record['elements_per_side']} elements, {record['local_inverse']}",
        f"peak memory of the rank below {BOUND / 2**30:.0f} GiB" if judged else "recorded",
        f"{record['n_interface']} interface unknowns; peak {peak / 2**20:.0f} MiB, of which factorisation and set-up "
        f"{(peak - before) / 2**20:.0f} MiB; set-up {record['set_up_seconds']:.2f} s; {record['iterations']} "
        f"iterations of {1e3 * record['seconds_per_iteration']:.1f} ms",
        peak < BOUND if judged else True)


def measure(sides: list[int]) -> list[Row]:
    """Dense and sparse for all sizes."""
    return [row(measure_one(elements, kind)) for elements in sides for kind in ("dense", "sparse")]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("elements", nargs="*", type=int, default=[20, 50, 100, 200, 300])
    arguments = parser.parse_args()
    main("local_inverse", lambda: measure(arguments.elements))
