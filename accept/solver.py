"""The acceptance table of the interface solver: every check measured here and now; exit 1 where one falls short.

Usage: accept_solver.py [--jobs N] [NAME ...], with the names of CHECKS; all by default. The preconditioner is two_level
where none is named. What a check ran goes to bench/results/accept_solver_runs.jsonl, its row to accept_solver.jsonl.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any

import iterations as grid
import local_inverse
import numpy as np
from bench.support.rows import Row, append_result
from bench.support.runs import DATA, ddic_run
from openhole import case

from ddic.io.result_reader import read_result

RUNS = "accept_solver_runs"
MOST, MOST_ADDED, MOST_CONTRAST, MOST_MIXED = 20, 3, 25, 20
ROUNDING, FLOORS = 1e-8, 10
LEAST_SAVING, SAME_FIELD = 2.0, 1e-4
RECYCLING_SUBDOMAINS, RECYCLING_WAVELENGTH, RECYCLING_RANKS = 24, 200, 2
LARGE, GIBIBYTES = 300, 2


def iterations(n_jobs: int) -> Row:
    """GMRES iterations to 1e-6 over the grid l_c/H x number of subdomains x size, and what 256 subdomains add to 64."""
    records = _grid(n_jobs)
    worst = _most(records)
    counts = {(r["elements_per_side"], r["lc_over_H"], r["n_subdomains"]): r["iterations"] for r in records}
    added = [_added(counts[n, ratio, 64], counts[n, ratio, 256]) for n in grid.ELEMENTS for ratio in grid.RATIOS]
    holds = _at_most(records, MOST) and max(added) <= MOST_ADDED
    return Row(f"GMRES iterations to 1e-6 on {len(records)} cells: l_c/H {_listed(grid.RATIOS)}; "
               f"{_listed(s**2 for s in grid.SIDES)} METIS subdomains; {_listed(grid.ELEMENTS)} elements a side",
               f"<= {MOST} in every cell; 64 -> 256 subdomains adds <= {MOST_ADDED}",
               f"most {worst}; 64 -> 256 adds {max(added):g} at most", holds)


def accuracy(n_jobs: int) -> Row:
    """Distance of the dual solution at tolerance 1e-10 from the one-domain solution over the same grid."""
    records = _grid(n_jobs)
    shares = [_share(r) for r in records]
    worst = records[int(np.argmax(shares))]
    reached = worst["relative_difference"]
    return Row(f"dual solution at tolerance 1e-10 against monolithic on the same {len(records)} cells",
               f"relative difference <= max({ROUNDING:.0e}, {FLOORS} x the difference of two factorisations)",
               f"largest {max(shares):.2f} of the bound: {'not reached' if reached is None else f'{reached:.1e}'}, "
               f"floor {worst['rounding_floor']:.1e}, {_cell(worst)}", max(shares) <= 1)


def contrast(n_jobs: int) -> Row:
    """Iterations where every second subdomain has a tenth of the texture's contrast."""
    records = _run(grid.contrast_tasks(grid.ELEMENTS, grid.SIDES, ("two_level",)), n_jobs)
    return Row(f"GMRES iterations to 1e-6, grad f 10 times lower in every second subdomain, l_c/H = "
               f"{grid.CONTRAST_RATIO}, {len(records)} cells", f"<= {MOST_CONTRAST}", f"most {_most(records)}",
               _at_most(records, MOST_CONTRAST))


def mixed(n_jobs: int) -> Row:
    """Iterations on an unstructured mesh of T3 and Q4 with a hole, the paper's and plain GMRES beside."""
    records = _run(grid.mixed_tasks(("two_level", "paper", "none")), n_jobs)
    two_level = [r for r in records if r["preconditioner"] == "two_level"]
    counts = "; ".join(f"l_c/H = {ratio:g}: " + ", ".join(f"{r['preconditioner']} {count(r)}" for r in records
                                                         if r["lc_over_H"] == ratio) for ratio in grid.MIXED_RATIOS)
    return Row(f"GMRES iterations to 1e-6, unstructured T3/Q4 mesh with a hole, {two_level[0]['n_dofs']} dofs, "
               f"{grid.MIXED_SUBDOMAINS} subdomains", f"two_level <= {MOST_MIXED}", counts,
               _at_most(two_level, MOST_MIXED))


def recycling(_: int) -> Row:
    """Krylov iterations of a whole run on real images with and without recycling and inexact tolerances."""
    totals, fields = {}, []
    for name, on in (("kept", "true"), ("fixed", "false")):
        keys = (f'subdomains = {RECYCLING_SUBDOMAINS}\npreconditioner = "two_level"\ntolerance = 1e-6\n'
                f"recycle = {on}\ninexact = {on}\n[regularization]\ncut_off_wavelength = {RECYCLING_WAVELENGTH}\n")
        summary = ddic_run(case(keys), DATA / "accept_solver", RECYCLING_RANKS, f"recycling_{name}")
        append_result(RUNS, {"name": "recycling", "variant": name, **summary})
        totals[name] = summary["krylov_iterations"]
        fields.append(read_result(DATA / "accept_solver" / f"recycling_{name}.vtkhdf").displacement)
    difference = float(np.abs(fields[0] - fields[1]).max())
    kept, fixed = sum(totals["kept"]), sum(totals["fixed"])
    return Row(f"openhole 53 -> 70, {RECYCLING_SUBDOMAINS} subdomains, l_c = {RECYCLING_WAVELENGTH} px, "
               f"{RECYCLING_RANKS} ranks: Krylov iterations of the whole run, recycling and inexact tolerance against "
               "warm start at fixed 1e-6", f"at most 1/{LEAST_SAVING:g}; same field to {SAME_FIELD:.0e} px",
               f"{kept} {totals['kept']} against {fixed} {totals['fixed']}; largest difference {difference:.1e} px",
               LEAST_SAVING * kept <= fixed and difference <= SAME_FIELD)


def large_subdomain(_: int) -> Row:
    """Memory of a rank whose subdomain has 300 x 300 elements, with the local inverse that ddic chooses by itself."""
    record = local_inverse.run(LARGE, "auto")
    peak, before = record["peak_bytes"], record["before_factorization_bytes"]
    return Row(f"peak memory of a rank with one subdomain of {LARGE} x {LARGE} Q4, two-level set-up included, "
               'local_inverse = "auto"', f"< {GIBIBYTES} GiB",
               f"{peak / 2**30:.2f} GiB, of which factorisation and set-up {(peak - before) / 2**30:.2f} GiB; "
               f"{record['n_interface']} interface unknowns", peak < GIBIBYTES * 2**30)


CHECKS = {check.__name__: check for check in (iterations, accuracy, contrast, mixed, recycling, large_subdomain)}


def count(record: dict[str, Any]) -> str:
    """Iterations, or the number that they exceed."""
    return f"> {record['more_than']}" if record["iterations"] is None else str(record["iterations"])


@cache
def _grid(n_jobs: int) -> tuple[dict[str, Any], ...]:
    return tuple(_run(grid.grid_tasks(grid.ELEMENTS, grid.SIDES, ("two_level",)), n_jobs))


def _run(tasks: Sequence[grid.Task], n_jobs: int) -> list[dict[str, Any]]:
    def report(found: list[dict[str, Any]]) -> None:
        for record in found:
            append_result(RUNS, record)

    return sorted(grid.measure(tasks, n_jobs, report),
                  key=lambda r: (r["elements_per_side"], r["n_subdomains"], r["lc_over_H"]))


def _at_most(records: Sequence[dict[str, Any]], bound: int) -> bool:
    return all(r["iterations"] is not None and r["iterations"] <= bound for r in records)


def _most(records: Sequence[dict[str, Any]]) -> str:
    worst = max(records, key=lambda r: float("inf") if r["iterations"] is None else r["iterations"])
    return f"{count(worst)} ({_cell(worst)})"


def _added(few: int | None, many: int | None) -> float:
    return float("inf") if few is None or many is None else many - few


def _share(record: dict[str, Any]) -> float:
    """Difference relative to its bound; infinite where the tolerance was not reached."""
    if record["relative_difference"] is None:
        return float("inf")
    return float(record["relative_difference"] / max(ROUNDING, FLOORS * record["rounding_floor"]))


def _cell(record: dict[str, Any]) -> str:
    return (f"{record['n_subdomains']} subdomains of {record['elements_per_side']} x {record['elements_per_side']}, "
            f"l_c/H = {record['lc_over_H']:g}")


def _listed(values: Any) -> str:
    return ", ".join(f"{value:g}" for value in values)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CHECKS))
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time on the grids")
    chosen = parser.parse_args()
    return accept("solver", chosen.names, CHECKS, lambda name: [CHECKS[name](chosen.jobs)], RUNS)


if __name__ == "__main__":
    sys.exit(main())
