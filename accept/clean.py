"""The acceptance table of clean pairs, which pay nothing for what is looked for in spoilt ones: ``make accept-clean``.

A check alone with CHECK=NAME. Whole commands beside an older commit, and other programs, are measured on a quiet
machine alone: these rows compare times.
"""

from __future__ import annotations

import sys

from accept.beside_others import measure_pyvale, measure_whole_commands
from accept.few_passes import measure_real_pairs, measure_tension
from accept.series_runs import measure_beside_pyvale
from accept.source_rules import measure_frame_code
from accept.support.clean_pairs import (
    EQUAL_PX,
    HELD_OFF,
    LARGE,
    MORE_ITERATIONS,
    MOST_PIXELS,
    SMALL,
    WORSE,
    Compared,
    compare_all,
    list_cases,
)
from accept.table import Check, Scale, run_table
from bench.support.rows import Row, append_result

SMOKE_PAIRS = (("waves", 64.0, 2.0), ("hole", None, 0.0), ("neck", 128.0, 2.0))
"""Field, l_c and noise of the pairs of a smoke run."""


def measure_pairs(scale: Scale) -> list[Row]:
    """Measure clean pairs by defaults and with every pixel kept.

    Parameters
    ----------
    scale : Scale
        A smoke run takes three small ones.

    Returns
    -------
    list of Row
        One row.
    """
    cases = list_cases(SMALL if scale.smoke else LARGE)
    if scale.smoke:
        cases = [case for case in cases if (case.field, case.cut_off, case.noise) in SMOKE_PAIRS]
    found = list(compare_all(cases))
    for compared in found:
        append_result("clean_runs", {**vars(compared), "misses": compared.misses})
    missed = [compared.tell() for compared in found if compared.misses]
    what = ("waves, a plate with a hole, beside a crack, a neck, waves turned by 10 degrees; l_c none, 64, 80, 128 px; "
            "noise 0, 2, 5; three speckles")
    bound = (f"no cell excluded, at most {MOST_PIXELS:g} of the pixels; equal to {EQUAL_PX:g} px where keeping is off "
             f"by less than {HELD_OFF:g} px everywhere, else RMS error at most {WORSE} times; iterations at most "
             f"{MORE_ITERATIONS} times and 3 more")
    return [Row(f"{len(cases)} clean pairs, by defaults and with every pixel kept: {what}", bound,
                "; ".join([_sum_up(found), *missed]), not missed)]


def _sum_up(found: list[Compared]) -> str:
    measured = [compared for compared in found if not compared.refusal]
    n_held_off = sum(compared.largest_keep >= HELD_OFF for compared in measured)
    n_hold = sum(not compared.misses for compared in found)
    n_cells = sum(compared.n_excluded for compared in measured)
    n_pixels = sum(compared.n_pixels_lost for compared in measured)
    most = max((compared.iterations for compared in measured), default=0)
    return (f"{n_hold} of {len(found)} hold, {len(found) - len(measured)} could not be measured; {n_held_off} are held "
            f"off by {HELD_OFF:g} px or more; {n_cells} cells and {n_pixels} pixels excluded in all; at most {most} "
            "iterations")


CHECKS: dict[str, Check] = {
    "pairs": measure_pairs,
    "tension": measure_tension,
    "real_pairs": measure_real_pairs,
    "whole_commands": measure_whole_commands,
    "pyvale": measure_pyvale,
    "series": measure_beside_pyvale,
    "frame_code": measure_frame_code,
}

if __name__ == "__main__":
    sys.exit(run_table("clean", CHECKS))
