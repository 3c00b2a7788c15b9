"""The acceptance table of numbers that hold, or are nan, where something is off: ``make accept-trust``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from accept.line_off import measure_line_off, measure_tip_off
from accept.stated_errors import CHECKS as OF_ERRORS
from accept.table import Check, run_table

CHECKS: dict[str, Check] = {"line_off": measure_line_off, "tip_off": measure_tip_off, **OF_ERRORS}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the table; 1 where a bound is missed."""
    return run_table("trust", CHECKS, arguments)


if __name__ == "__main__":
    sys.exit(main())
