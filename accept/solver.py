"""The acceptance table of the interface solver: ``make accept-solver``, a check alone with CHECK=NAME.

The preconditioner is two_level where none is named.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np

from accept.real_images import case_text
from accept.table import Scale, runs_name
from bench import iterations as grid
from bench import local_inverse
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run
from ddic.io.result_reader import read_result

TABLE = "solver"
MOST, MOST_ADDED, MOST_CONTRAST, MOST_MIXED = 20, 3, 25, 20
"""GMRES iterations: on the grid, added from 64 to 256 subdomains, at low contrast, on a mixed mesh."""

ROUNDING, FLOORS = 1e-8, 10
"""Relative difference to one domain that always passes, and differences of two factorisations that pass too."""

LEAST_SAVING, SAME_FIELD = 2.0, 1e-4
"""Times fewer Krylov iterations by recycling; difference of the fields, pixels."""

RECYCLING_SUBDOMAINS, RECYCLING_WAVELENGTH, RECYCLING_RANKS = 24, 200, 2
LARGE, SMOKE_LARGE = 300, 20
"""Elements a side of the large subdomain."""

GIBIBYTES = 2
"""Memory of its rank."""

FEW, MANY = 64, 256
"""Subdomains between which iterations may grow by MOST_ADDED."""

SMOKE_ELEMENTS, SMOKE_SIDES, SMOKE_RATIOS = (4,), (2,), (2, 8)
"""The grid of a smoke run."""

Record = dict[str, Any]


def measure_iterations(scale: Scale) -> list[Row]:
    """Count GMRES iterations to 1e-6 over the grid l_c/H x subdomains x size, and what 256 subdomains add to 64."""
    records = _grid(scale)
    counts = {(r["elements_per_side"], r["lc_over_H"], r["n_subdomains"]): r["iterations"] for r in records}
    added = [_added(count, counts[n, ratio, MANY]) for (n, ratio, subdomains), count in counts.items()
             if subdomains == FEW]
    most_added = max(added, default=0.0)
    return [Row(f"GMRES iterations to 1e-6 on {len(records)} cells: l_c/H {_listed(grid.RATIOS)}; "
                f"{_listed(s**2 for s in grid.SIDES)} METIS subdomains; {_listed(grid.ELEMENTS)} elements a side",
                f"<= {MOST} in every cell; {FEW} -> {MANY} subdomains adds <= {MOST_ADDED}",
                f"most {_most(records)}; {FEW} -> {MANY} adds {most_added:g} at most",
                _at_most(records, MOST) and most_added <= MOST_ADDED, judged_small=False)]


def measure_accuracy(scale: Scale) -> list[Row]:
    """Measure the distance of the dual solution at tolerance 1e-10 from the one-domain solution over the same grid."""
    records = _grid(scale)
    shares = [_share(r) for r in records]
    worst = records[int(np.argmax(shares))]
    reached = worst["relative_difference"]
    return [Row(f"dual solution at tolerance 1e-10 against monolithic on the same {len(records)} cells",
                f"relative difference <= max({ROUNDING:.0e}, {FLOORS} x the difference of two factorisations)",
                f"largest {max(shares):.2f} of the bound: {'not reached' if reached is None else f'{reached:.1e}'}, "
                f"floor {worst['rounding_floor']:.1e}, {_cell(worst)}", max(shares) <= 1)]


def measure_contrast(scale: Scale) -> list[Row]:
    """Count iterations where every second subdomain has a tenth of the texture's contrast."""
    sizes = (SMOKE_ELEMENTS, SMOKE_SIDES) if scale.smoke else (grid.ELEMENTS, grid.SIDES)
    elements, sides = sizes
    records = _run(grid.contrast_tasks(elements, sides, ("two_level",)), scale.jobs)
    return [Row(f"GMRES iterations to 1e-6, grad f 10 times lower in every second subdomain, l_c/H = "
                f"{grid.CONTRAST_RATIO}, {len(records)} cells", f"<= {MOST_CONTRAST}", f"most {_most(records)}",
                _at_most(records, MOST_CONTRAST), judged_small=False)]


def measure_mixed(scale: Scale) -> list[Row]:
    """Count iterations on an unstructured mesh of T3 and Q4 with a hole, the paper's and plain GMRES beside."""
    plate = grid.SMALL_PLATE if scale.smoke else grid.PLATE
    records = _run(grid.mixed_tasks(("two_level", "paper", "none"), plate), scale.jobs)
    two_level = [r for r in records if r["preconditioner"] == "two_level"]
    counts = "; ".join(
        f"l_c/H = {ratio:g}: "
        + ", ".join(f"{r['preconditioner']} {_count(r)}" for r in records if r["lc_over_H"] == ratio)
        for ratio in grid.MIXED_RATIOS)
    return [Row(f"GMRES iterations to 1e-6, unstructured T3/Q4 mesh with a hole, {two_level[0]['n_dofs']} dofs, "
                f"{plate.subdomains} subdomains", f"two_level <= {MOST_MIXED}", counts,
                _at_most(two_level, MOST_MIXED), judged_small=False)]


def measure_recycling(scale: Scale) -> list[Row]:
    """Count Krylov iterations of a whole run on real images with and without recycling and inexact tolerances."""
    folder = scale.folder("accept_solver")
    totals, fields = {}, []
    for name, on in (("kept", "true"), ("fixed", "false")):
        keys = (f'subdomains = {RECYCLING_SUBDOMAINS}\npreconditioner = "two_level"\ntolerance = 1e-6\n'
                f"recycle = {on}\ninexact = {on}\n[regularization]\ncut_off_wavelength = {RECYCLING_WAVELENGTH}\n")
        summary = ddic_run(case_text(keys), folder, RECYCLING_RANKS, f"recycling_{name}")
        append_result(runs_name(TABLE), {"name": "recycling", "variant": name, **summary})
        totals[name] = summary["krylov_iterations"]
        fields.append(read_result(folder / f"recycling_{name}.vtkhdf").displacement)
    difference = float(np.abs(fields[0] - fields[1]).max())
    kept, fixed = sum(totals["kept"]), sum(totals["fixed"])
    return [Row(f'openhole 53 -> 70, quintic spline, method = "dual", {RECYCLING_SUBDOMAINS} subdomains, two levels, '
                f"l_c = {RECYCLING_WAVELENGTH} px, {RECYCLING_RANKS} ranks: Krylov iterations of the whole run, "
                "recycling and inexact tolerance against warm start at fixed 1e-6",
                f"at most 1/{LEAST_SAVING:g}; same field to {SAME_FIELD:.0e} px",
                f"{kept} {totals['kept']} against {fixed} {totals['fixed']}; largest difference {difference:.1e} px",
                LEAST_SAVING * kept <= fixed and difference <= SAME_FIELD)]


def measure_large_subdomain(scale: Scale) -> list[Row]:
    """Measure the memory of a rank whose subdomain is large, with the local inverse that ddic chooses by itself."""
    side = SMOKE_LARGE if scale.smoke else LARGE
    record = local_inverse.measure_one(side, "auto")
    peak, before = record["peak_bytes"], record["before_factorization_bytes"]
    return [Row(f"peak memory of a rank with one subdomain of {side} x {side} Q4, l_c = {local_inverse.LONG} H, "
                'two-level set-up included, local_inverse = "auto"', f"< {GIBIBYTES} GiB",
                f"{peak / 2**30:.2f} GiB, of which factorisation and set-up {(peak - before) / 2**30:.2f} GiB; "
                f"{record['n_interface']} interface unknowns", peak < GIBIBYTES * 2**30, judged_small=False)]


@cache
def _grid(scale: Scale) -> tuple[Record, ...]:
    """The grid's records, which two checks look at, measured once."""
    if scale.smoke:
        tasks = grid.grid_tasks(SMOKE_ELEMENTS, SMOKE_SIDES, ("two_level",), SMOKE_RATIOS)
    else:
        tasks = grid.grid_tasks(grid.ELEMENTS, grid.SIDES, ("two_level",))
    return tuple(_run(tasks, scale.jobs))


def _run(tasks: Sequence[grid.Task], n_jobs: int) -> list[Record]:
    """Records of all tasks, in the order of their cells."""
    def report(found: list[Record]) -> None:
        for record in found:
            append_result(runs_name(TABLE), record)

    def cell(record: Record) -> tuple[float, int, float]:
        return record["elements_per_side"], record["n_subdomains"], record["lc_over_H"]

    return sorted(grid.measure(tasks, n_jobs, report), key=cell)


def _count(record: Record) -> str:
    """Iterations, or the number that they exceed."""
    return f"> {record['more_than']}" if record["iterations"] is None else str(record["iterations"])


def _at_most(records: Iterable[Record], bound: int) -> bool:
    return all(r["iterations"] is not None and r["iterations"] <= bound for r in records)


def _most(records: Iterable[Record]) -> str:
    worst = max(records, key=lambda r: float("inf") if r["iterations"] is None else r["iterations"])
    return f"{_count(worst)} ({_cell(worst)})"


def _added(few: int | None, many: int | None) -> float:
    return float("inf") if few is None or many is None else many - few


def _share(record: Record) -> float:
    """Difference relative to its bound; infinite where the tolerance was not reached."""
    if record["relative_difference"] is None:
        return float("inf")
    return float(record["relative_difference"] / max(ROUNDING, FLOORS * record["rounding_floor"]))


def _cell(record: Record) -> str:
    return (f"{record['n_subdomains']} subdomains of {record['elements_per_side']} x {record['elements_per_side']}, "
            f"l_c/H = {record['lc_over_H']:g}")


def _listed(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
