"""The 29-megapixel case on 2 ranks, from the start of the command to the written file.

Usage: python -m bench.paper [--repeats N] [--without-kernels] [CASE ...]; cases: beam_8, beam_16 (the paper's
open-hole beam, about 62,500 unknowns in 180 subdomains) and full_16 (the whole image, 221,136 unknowns,
by conjugate gradients); all by default. Every case is one record of bench/results/paper.jsonl.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any

from bench import kernels
from bench.support.paper_case import CASES, MEASURED, TOLERANCE, BenchCase
from bench.support.paper_record import monolithic_record, pixel_record, run_record, timed_runs
from bench.support.rows import RESULTS, Row, append_result, show_all

LONGEST_S, GIBIBYTES = 8.0, 2.5
LEAST_SPEEDUP = 1.85
MOST_DISTURBED = 1.1
"""Wall over CPU seconds of the busiest rank from which the machine counts as busy with something else: then a ratio of
wall times says nothing, in either direction."""
REPEATS = 3
KERNEL_PROBLEMS = {"beam": "15-px T3/Q4", "full": "16-px Q4"}
KERNEL_KEYS = ("rhs_mpx_per_s_core", "rhs_fraction_of_c_kernel", "lhs_mpx_per_s_core")


def whole_command(name: str, repeats: int = REPEATS) -> tuple[Row, dict[str, Any]]:
    """Run a case from start to written file; its row of the acceptance table, and what it found."""
    case = CASES[name]()
    record = run_record(case, timed_runs(case, repeats))
    wall, memory = record["wall_s"], record["memory_total_bytes"] / 2**30
    row = Row(f"29-Mpx case {name} ({record['n_dofs']} unknowns, {case.solver.replace(chr(10), ', ')}, "
              f"{record['n_pixels'] / 1e6:.1f} Mpx: {case.covered}), {case.bits} bit, 2 ranks, l_c = "
              f"{record['cut_off_wavelength']:g} px, tolerance {TOLERANCE:g}: whole command, warm cache",
              f"at most {LONGEST_S:g} s wall; both ranks' memory at most {GIBIBYTES} GiB",
              f"{wall:.1f} s wall (median of {repeats}; {record['cpu_s_of_phases']:.1f} CPU s in the phases), "
              f"{memory:.2f} GiB; {record['iterations']} iterations, RMS error {record['rms_error_px']:.5f} px",
              wall <= LONGEST_S and memory <= GIBIBYTES, judged_small=False)
    return row, record


def find_summary(case: BenchCase) -> dict[str, Any]:
    """What a case's last run on disk says of itself; run now where there is none.

    Parameters
    ----------
    case : BenchCase
        The case.

    Returns
    -------
    dict
        The summary; the result lies beside it.
    """
    file = case.folder / f"{case.name}.json"
    if not file.is_file():
        timed_runs(case, 0)
    summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return summary


@cache
def speedup(name: str, repeats: int = REPEATS) -> tuple[Row, dict[str, Any]]:
    """Pixel work on 1 and 2 ranks, at the field that ``whole_command`` has left on disk."""
    case = CASES[name]()
    record = pixel_record(case, find_summary(case)["iterations"], repeats)
    ratio, disturbed = record["pixel_speedup_2_ranks"], record["pixel_wall_over_cpu"]
    by_kind = ", ".join(f"{kind} {value:.2f}" for kind, value in record["pixel_speedup_by_kind"].items())
    quiet = max(disturbed) <= MOST_DISTURBED
    return Row(f"pixel work of {name}, 1 -> 2 ranks, wall", f"at least {LEAST_SPEEDUP} times faster",
               f"{ratio:.2f} ({by_kind}); CPU of 1 rank over the busier of 2: "
               f"{record['pixel_speedup_2_ranks_cpu']:.2f}; wall over CPU {disturbed[0]:.2f} and {disturbed[1]:.2f}"
               + ("" if quiet else f": above {MOST_DISTURBED}, the machine is busy with something else"),
               ratio >= LEAST_SPEEDUP and quiet, judged_small=False), record


@cache
def measured_kernels() -> tuple[dict[str, Any], ...]:
    """Records of bench/kernels.py, run now."""
    before = _kernel_lines()
    kernels.measure()
    return tuple(map(json.loads, _kernel_lines()[len(before):]))


def _kernel_lines() -> list[str]:
    file = RESULTS / "kernels.jsonl"
    return file.read_text(encoding="utf-8").splitlines() if file.is_file() else []


def kernel_rates(name: str, records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Rates of the kernels and their ratio to C on its problem most like a case: same cells, many parts."""
    wanted = KERNEL_PROBLEMS[name.split("_", maxsplit=1)[0]]
    like = [r for r in records if r.get("problem", "").startswith(wanted) and r["n_parts"] > 1 and r["degree"] == 3]
    if len(like) != 1:
        raise RuntimeError(f"bench/kernels.py measured {len(like)} problems {wanted!r} in many parts with degree 3")
    return {f"kernels_{key}": like[0][key] for key in KERNEL_KEYS}


def show(record: dict[str, Any]) -> None:
    """Print a record phase by phase."""
    print(f"{record['case']}: {record['n_dofs']} unknowns, {record['n_subdomains']} subdomains, "
          f"{record['n_pixels'] / 1e6:.2f} Mpx ({record['covered']}), {record['bits']} bit, {record['n_ranks']} ranks")
    print(f"  {'phase':<20}{'wall s':>9}{'CPU s':>9}")
    for phase, seconds in record["seconds"].items():
        print(f"  {phase:<20}{seconds:9.2f}{record['cpu_seconds'][phase]:9.2f}")
    inside = sum(record["seconds"].values())
    print(f"  {'start and end':<20}{record['wall_s'] - inside:9.2f}\n  {'whole command':<20}{record['wall_s']:9.2f}"
          f"{record['cpu_s_of_phases']:9.2f}  (CPU without start and end)")
    print(f"  memory by rank       {', '.join(f'{m / 2**20:.0f} MiB' for m in record['memory_bytes'])}")
    print(f"  iterations           {record['iterations']}, Krylov {record['krylov_iterations']}")
    print(f"  RMS error            {record['rms_error_px']:.5f} px ({record['rms_error_all_nodes_px']:.5f} px with the "
          "nodes within an element of the boundary)")
    print(f"  against monolithic   {record['monolithic_relative_difference']:.1e} relative, RMS "
          f"{record['monolithic_rms_difference_px']:.1e} px, largest "
          f"{record['monolithic_largest_difference_px']:.1e} px ({record['monolithic_wall_s']:.1f} s on 1 rank)")
    print(f"  residual passes      {record['rhs_mpx_per_s_core']:.0f} Mpx/s per core on this mesh; whole phase of the "
          f"run {record['rhs_mpx_per_s_core_in_run']:.0f}")
    print(f"  M with gradient      {record['lhs_mpx_per_s_core']:.0f} Mpx/s per core on this mesh, windows read")
    print("  kernels alone        " + ", ".join(f"{key} {_rate(record[f'kernels_{key}'])}" for key in KERNEL_KEYS),
          flush=True)


def _rate(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.2f}"


def measure_case(name: str, repeats: int = REPEATS, *, with_kernels: bool = True) -> list[Row]:
    """All that a record holds of a case; the rows of the whole command and of the speed-up.

    with_kernels: also measure the kernels by themselves and against C; without, these numbers are null.
    """
    nothing = dict.fromkeys(f"kernels_{key}" for key in KERNEL_KEYS)
    rates_alone = kernel_rates(name, measured_kernels()) if with_kernels else nothing
    row, record = whole_command(name, repeats)
    faster, rates = speedup(name, repeats)
    record |= monolithic_record(CASES[name]()) | rates | rates_alone
    record["rhs_fraction_of_c_kernel"] = rates_alone["kernels_rhs_fraction_of_c_kernel"]
    append_result("paper", record)
    show(record)
    return [row, faster]


def measure(names: Sequence[str] = MEASURED, repeats: int = REPEATS, *, with_kernels: bool = True) -> list[Row]:
    """The rows of every named case."""
    return [row for name in names for row in measure_case(name, repeats, with_kernels=with_kernels)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--repeats", type=int, default=REPEATS, help="timed runs, of which the median counts")
    parser.add_argument("--without-kernels", action="store_true",
                        help="leave out bench/kernels.py; its numbers are null")
    chosen = parser.parse_args()
    unknown = sorted(set(chosen.cases) - set(CASES))
    if unknown or chosen.repeats < 1:
        parser.error(f"no such case: {', '.join(unknown)}" if unknown else "--repeats must be at least 1")
    rows = measure(chosen.cases or MEASURED, chosen.repeats, with_kernels=not chosen.without_kernels)
    return show_all(rows)


if __name__ == "__main__":
    sys.exit(main())
