"""The acceptance table of the start and of spoilt images: ``make accept-start``, a check alone with CHECK=NAME.

Pairs are exact and settings are defaults: no start key in any case but those of the check ``initial_fields``.
"""

from __future__ import annotations

import sys

from accept.hard_starts import CHECKS as HARD
from accept.initial_fields import CHECKS as INITIAL
from accept.large_motions import CHECKS as LARGE
from accept.large_pairs import CHECKS as SECONDS
from accept.neck_series import CHECKS as SERIES
from accept.small_region import CHECKS as SMALL
from accept.spoilt_images import CHECKS as SPOILT
from accept.table import Check, run_table

CHECKS: dict[str, Check] = {**LARGE, **HARD, **INITIAL, **SPOILT, **SERIES, **SECONDS, **SMALL}


if __name__ == "__main__":
    sys.exit(run_table("start", CHECKS))
