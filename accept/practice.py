"""For daily work: series of images, clusters, uncertainty, settings, reports.

Usage: python -m accept.practice [--smoke] [CHECK ...]: all checks, or the named ones; exit code 1 where a bound is
missed.
"""

from __future__ import annotations

import sys

from accept.report_page import measure_report
from accept.series_runs import CHECKS as SERIES
from accept.slurm_job import measure_slurm_job
from accept.sweep_choice import measure_sweep
from accept.table import Check, run_table
from accept.uncertainty_fields import measure_uncertainty

CHECKS: dict[str, Check] = {
    **SERIES, "uncertainty": measure_uncertainty, "sweep": measure_sweep, "report": measure_report,
    "slurm": measure_slurm_job,
}

if __name__ == "__main__":
    sys.exit(run_table("practice", CHECKS))
