"""The acceptance table of the house: ``make accept-house``, a check alone with CHECK=NAME."""

from __future__ import annotations

import sys

from accept.documents import measure_docs, measure_equations
from accept.frames import measure_leaving_frames, measure_many_frames
from accept.kinematics import measure_fixed_components, measure_integrated
from accept.recorded import recorded
from accept.source_rules import measure_source
from accept.table import Check, Scale, run_table
from bench import kernel_rates
from bench.support.rows import Row

SMALL_PROBLEM = "16-px Q4, 33,000 px"
"""Of ``bench.kernel_rates``, for a smoke run."""


def measure_kernel_rates(scale: Scale) -> list[Row]:
    """Measure the rates of pixel kernels before and after, alternated.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one small problem.

    Returns
    -------
    list of Row
        One for each problem.
    """
    return list(kernel_rates.measure(names=(SMALL_PROBLEM,) if scale.smoke else ()))


CHECKS: dict[str, Check] = {
    "recorded": recorded,
    "kernel_rates": measure_kernel_rates,
    "integrated": measure_integrated,
    "fixed_components": measure_fixed_components,
    "frames": measure_many_frames,
    "leaving_frames": measure_leaving_frames,
    "equations": measure_equations,
    "source": measure_source,
    "docs": measure_docs,
}

if __name__ == "__main__":
    sys.exit(run_table("house", CHECKS))
