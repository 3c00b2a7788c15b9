"""First impressions: what is chosen by default, strains and pictures as a user sees them.

Usage: python -m accept.impressions [--smoke] [CHECK ...]: all checks, or the named ones; exit code 1 where a bound is
missed.
"""

from __future__ import annotations

import sys

from accept.absent_packages import measure_absent_packages
from accept.chosen_solver import measure_choice
from accept.followed_pages import measure_followed_pages
from accept.jpeg_pairs import measure_jpeg_pairs
from accept.nodal_strains import measure_nodal_strain
from accept.paper_pictures import measure_pictures
from accept.refused_runs import measure_refused_runs
from accept.table import Check, run_table

CHECKS: dict[str, Check] = {
    "auto": measure_choice,
    "nodal_strain": measure_nodal_strain,
    "pictures": measure_pictures,
    "absent_packages": measure_absent_packages,
    "followed_pages": measure_followed_pages,
    "refused_runs": measure_refused_runs,
    "jpeg": measure_jpeg_pairs,
}

if __name__ == "__main__":
    sys.exit(run_table("impressions", CHECKS))
