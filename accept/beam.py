"""Pixel kernels and speed-up on the paper's beam: subdomains of 33,000 px, triangles and quadrangles of 15 px."""

from __future__ import annotations

from accept.table import Scale
from bench.paper import find_summary
from bench.support.paper_case import CASES
from bench.support.paper_record import pixel_record
from bench.support.rows import Row, append_result

CASE, SMOKE_CASE = "beam_16", "tiny"
"""Cases of ``bench.paper``: the beam in 180 subdomains, and one that takes a second."""

RIGHT_BOUND, LEFT_BOUND = 90.0, 65.0
"""Mpx/s a core: residuals with the right-hand side; grad f from the file with M."""

LEAST_SPEEDUP = 1.85
"""CPU of one rank over that of the busier of two, of all pixel work of a run."""

REPEATS, PASSES = 5, 5
"""Jobs on one rank and on two in turns, and how often each does the work. A job gives medians over its passes; a rate
is the best job's, since others on the machine only ever slow it (by 1.4 on one that looked idle), a speed-up the
ratio of the jobs' medians."""


def measure_beam_kernels(scale: Scale) -> list[Row]:
    """Measure both pixel kernels on the beam as a run calls them, and how much faster two ranks are than one.

    CPU time, since a machine that has other work to do as well spoils ratios of wall times; those are shown beside.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image, one job on each number of ranks and one pass.

    Returns
    -------
    list of Row
        Right-hand side, left-hand side and speed-up.
    """
    case = CASES[SMOKE_CASE if scale.smoke else CASE]()
    summary = find_summary(case)
    repeats, passes = (1, 1) if scale.smoke else (REPEATS, PASSES)
    record = pixel_record(case, summary["iterations"], repeats, passes)
    append_result("beam_kernels", {"case": case.name, **record})
    best, usual = record["best_mpx_per_s_1_rank"], record["mpx_per_s_1_rank"]
    right, left, usual_left = best["residual"], _of_both(best), _of_both(usual)
    faster, by_kind = record["pixel_speedup_2_ranks_cpu"], record["pixel_speedup_by_kind_cpu"]
    where = f"{case.name}, {summary['n_pixels'] / summary['n_subdomains']:,.0f} px a subdomain"
    disturbed = " and ".join(f"{ratio:.2f}" for ratio in record["pixel_wall_over_cpu"])
    return [
        Row(f"right-hand side, {where}, one rank, best of {repeats} jobs", f">= {RIGHT_BOUND:.0f} Mpx/s a core",
            f"{right:.0f} Mpx/s; median {usual['residual']:.0f}, on 2 ranks {record['rhs_mpx_per_s_core']:.0f}",
            right >= RIGHT_BOUND, judged_small=False),
        Row(f"left-hand side, {where}, one rank, best of {repeats} jobs", f">= {LEFT_BOUND:.0f} Mpx/s a core",
            f"{left:.0f} Mpx/s: gradient {best['gradient']:.0f}, cell sums {best['M']:.0f}; median {usual_left:.0f}, "
            f"on 2 ranks {record['lhs_mpx_per_s_core']:.0f}", left >= LEFT_BOUND, judged_small=False),
        Row(f"pixel work, {where}: CPU of 1 rank over the busier of 2", f">= {LEAST_SPEEDUP}",
            f"{faster:.2f} (" + ", ".join(f"{kind} {value:.2f}" for kind, value in by_kind.items())
            + f"), two unrelated runs at once {record['pixel_work_of_2_runs_at_once']:.2f}; "
            f"wall {record['pixel_speedup_2_ranks']:.2f}, wall over CPU on 1 and 2 ranks {disturbed}",
            faster >= LEAST_SPEEDUP, judged_small=False)]


def _of_both(rates: dict[str, float]) -> float:
    """Rate of grad f and M one after the other, Mpx/s."""
    return 1 / (1 / rates["gradient"] + 1 / rates["M"])
