"""The whole command, pixel kernels and speed-up, beside other programs and older commits, and on the paper's beam.

What a check ran goes to bench/results/paper.jsonl, kernels.jsonl, peers.jsonl and accuracy_runs.jsonl. A smoke run of
the peers measures with ddic alone, unless their environment is there already.
"""

from __future__ import annotations

from accept.accuracy import BOUNDS, Field, measure_errors
from accept.table import Scale
from bench import kernel_rates, peers
from bench import kernels as pixel_kernels
from bench import paper as megapixels
from bench.before import compare_starts
from bench.paper import find_summary
from bench.support.before import checkout_before
from bench.support.paper_case import CASES, MEASURED
from bench.support.paper_record import pixel_record
from bench.support.peer_environment import peers_are_there
from bench.support.rows import Row, append_result
from bench.support.runs import ROOT

BEFORE = {(0, 0): {3: 0.0022063, 5: 0.0019515}, (0, 64): {3: 0.0011295, 5: 0.0005963},
          (2, 0): {3: 0.0123402, 5: 0.0122960}, (2, 64): {3: 0.0031624, 5: 0.0029959}}
"""RMS errors before the work on performance, px, by (noise, l_c) and spline degree (commit 7dab11f)."""

LAST_DIGIT = 1e-5
"""Errors are compared as the tables give them, to 1e-5 px: sums in another order change what is behind."""

SMALLER_SINCE = "f43a80d"
"""Commit since which the source has become smaller."""

MOST_OF_START, STARTS = 0.7, 11
"""Of the time that commit took up to its first line; runs of each."""

SPEEDUP_CASES = ("beam_16", "full_16")
"""Cases of ``bench.paper`` whose pixel work is measured on one and two ranks."""

SMOKE_CASE = "tiny"
"""A case of ``bench.paper`` that takes a second."""


def measure_paper(scale: Scale) -> list[Row]:
    """Measure the whole command on every 29-megapixel case, records kept as by ``make bench-paper``."""
    if scale.smoke:
        return megapixels.measure_case(SMOKE_CASE, repeats=1, with_kernels=False)[:1]
    return [row for name in MEASURED for row in megapixels.measure_case(name)[:1]]


def measure_startup(scale: Scale) -> list[Row]:
    """Compare what a run takes before it says its first word."""
    # Compiling that commit's kernels takes a minute.
    earlier = ROOT if scale.smoke else checkout_before(SMALLER_SINCE)
    then, now = compare_starts(earlier, rounds=1 if scale.smoke else STARTS)
    return [Row(f"`ddic run` of the demo up to its first line of output, one rank, CPU, in turn with {SMALLER_SINCE}",
                f"at most {MOST_OF_START:g} times", f"{now / then:.2f} times ({now:.2f} beside {then:.2f} s)",
                now <= MOST_OF_START * then, judged_small=False)]


def measure_speedup(scale: Scale) -> list[Row]:
    """Measure the pixel work on one and two ranks."""
    if scale.smoke:
        return [megapixels.speedup(SMOKE_CASE, repeats=1)[0]]
    return [megapixels.speedup(name)[0] for name in SPEEDUP_CASES]


def measure_kernels(scale: Scale) -> list[Row]:
    """Measure both pixel kernels against their bounds and against C."""
    return pixel_kernels.measure(pixel_kernels.SMALL if scale.smoke else pixel_kernels.SIZE)


def measure_pyxel(scale: Scale) -> list[Row]:
    """Measure CPU and error against pyxel-dic."""
    return _measure_peer("pyxel", scale)


def measure_pyvale(scale: Scale) -> list[Row]:
    """Measure CPU and error against pyvale."""
    return _measure_peer("pyvale", scale)


def _measure_peer(name: str, scale: Scale) -> list[Row]:
    """Rows of a peer; without its environment a smoke run measures with ddic alone."""
    if not scale.smoke:
        return peers.measure(name)
    if peers_are_there():
        return list(peers.rows(name, ("tiny",), 1))
    run = peers.measure_ddic(peers.warm_up_pair(), peers.WAVELENGTH, 1, peers.METHODS[name])
    return [Row(f"{name}: ddic alone", "runs", f"{run.seconds:.2f} CPU s, RMS error {run.error:.5f} px", True,
                judged_small=False)]


def measure_accuracy(scale: Scale) -> list[Row]:
    """Compare the reference field's errors, quintic and cubic, with what they were before and with their bounds."""
    fields = [Field(*key) for key in BEFORE]
    return [_compare_errors(field, scale) for field in (fields[-1:] if scale.smoke else fields)]


def _compare_errors(field: Field, scale: Scale) -> Row:
    errors = measure_errors(field, scale)
    before, bound = BEFORE[field.noise, field.wavelength], BOUNDS[field.noise, field.wavelength]
    return Row(f"{field.what}: RMS error",
               f"no worse than before, to {LAST_DIGIT:.0e} px: quintic {before[5]:.5f}, cubic {before[3]:.5f} px; "
               f"quintic at most {bound} px",
               f"quintic {errors[5]:.6f} px, cubic {errors[3]:.6f} px",
               errors[5] <= bound and all(errors[d] <= before[d] + LAST_DIGIT / 2 for d in errors))


SMALL_PROBLEM = "16-px Q4, 33,000 px"
"""Of ``bench.kernel_rates``, for a smoke run."""


def measure_kernel_rates(scale: Scale) -> list[Row]:
    """Measure the rates of pixel kernels before and after, alternated."""
    return list(kernel_rates.measure(names=(SMALL_PROBLEM,) if scale.smoke else ()))


BEAM_CASE, SMOKE_BEAM = "beam_16", "tiny"
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
    """
    case = CASES[SMOKE_BEAM if scale.smoke else BEAM_CASE]()
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
