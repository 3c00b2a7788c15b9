"""The acceptance table of the core: ``make accept-core``, a check alone with CHECK=NAME, all small with --smoke."""

from __future__ import annotations

import sys

from accept import accuracy, demo_noise, full_size, linear_step, openhole, preconditioners, sample14
from accept.table import Check, run_table

CHECKS: dict[str, Check] = {
    "accuracy": accuracy.measure,
    "demo_noise": demo_noise.measure,
    "linear_step": linear_step.measure,
    "preconditioners": preconditioners.measure,
    "openhole": openhole.measure,
    "sample14": sample14.measure,
    "full_size": full_size.measure,
}

if __name__ == "__main__":
    sys.exit(run_table("core", CHECKS))
