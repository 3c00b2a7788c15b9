"""The acceptance table of the house: ``make accept-house``, a check alone with CHECK=NAME."""

from __future__ import annotations

import sys

from accept.recorded import recorded
from accept.table import Check, run_table

CHECKS: dict[str, Check] = {"recorded": recorded}

if __name__ == "__main__":
    sys.exit(run_table("house", CHECKS))
