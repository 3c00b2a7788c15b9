"""The acceptance table of PGD-DIC: ``make accept-pgd``, a check alone with CHECK=NAME."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from accept.first_example import measure_corrections, measure_sizes
from accept.pixel_elements import measure_against_dual, measure_million
from accept.separated_crack import measure_separated_crack
from accept.separated_openhole import measure_separated_openhole
from accept.separated_runs import measure_full_size, measure_ranks
from accept.table import Check, run_table

CHECKS: dict[str, Check] = {
    "corrections": measure_corrections,
    "sizes": measure_sizes,
    "crack": measure_separated_crack,
    "million": measure_million,
    "dual": measure_against_dual,
    "openhole": measure_separated_openhole,
    "ranks": measure_ranks,
    "full_size": measure_full_size,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the table; 1 where a bound is missed."""
    return run_table("pgd", CHECKS, arguments)


if __name__ == "__main__":
    sys.exit(main())
