"""For daily work: series of images, clusters, uncertainty, settings, reports.

Usage: python -m accept.practice [--smoke] [CHECK ...]: all checks, or the named ones; exit code 1 where a bound is
missed.
"""

from __future__ import annotations

import sys

from accept.series_runs import CHECKS as SERIES
from accept.table import Check, run_table
from accept.uncertainty_fields import measure_uncertainty

CHECKS: dict[str, Check] = {**SERIES, "uncertainty": measure_uncertainty}

if __name__ == "__main__":
    sys.exit(run_table("practice", CHECKS))
