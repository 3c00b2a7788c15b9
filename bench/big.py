"""A large image pair on 2 ranks: 22,000 x 22,000 px with about a million unknowns at 31 px, or a smaller square.

Usage: python -m bench.big [--size PIXELS], 5000 by default; ``make bench-big`` takes 22,000, and ``make accept-scale``
a gigapixel at 16 px. The reference texture and field, 8 bit, are rendered in bands into bench/data, once (0.4 CPU s a
megapixel). Time by phase, memory and error go
to bench/results/big.jsonl.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from bench.support.paper_case import TOLERANCE, BenchCase
from bench.support.paper_record import run_record, timed
from bench.support.rows import Row, append_result, show_all
from bench.support.runs import DATA, images
from ddic.synth.truth import load_truth

FULL = 22000
MARGIN, ELEMENT, WAVELENGTH = 32, 31, 124
SUBDOMAIN_SIDE = 1375
"""Pixels: 256 subdomains of 44 x 44 elements at full size."""

MEMORY_GIB = 24.0


def by_dual(size: int) -> str:
    """The dual method, keys of [solver]."""
    return f'method = "dual"\nsubdomains = {max(2, round((size / SUBDOMAIN_SIDE) ** 2))}'


def square(size: int, solver: str, element: int = ELEMENT, wavelength: int = WAVELENGTH) -> BenchCase:
    """Reference texture and field on size x size px, all but a margin of 32 px, rendered where missing."""
    folder = images("sinusoidal", "--size", f"{size}x{size}", folder=DATA / f"big_{size}")
    text = (f'[images]\nreference = "{folder}/reference.tif"\ndeformed = "{folder}/deformed.tif"\n'
            f"[mesh.structured]\nregion = [{MARGIN}, {MARGIN}, {size - MARGIN}, {size - MARGIN}]\n"
            f"element_size = {element}\n[regularization]\ncut_off_wavelength = {wavelength}\n"
            f"[gauss_newton]\ntolerance = {TOLERANCE}")
    return BenchCase(f"square_{size}", 8, folder, text, load_truth(folder / "truth.json"), element,
                     f"all but a margin of {MARGIN} px", solver)


def measure(size: int) -> list[Row]:
    """One run; below full size a second one at half the side, to extrapolate."""
    record = run(square(size, by_dual(size)))
    show(record, run(square(size // 2, by_dual(size // 2))) if size < FULL else None)
    memory = record["memory_total_bytes"] / 2**30
    row = Row(f"{size} x {size} px pair, {record['n_dofs']} unknowns at {ELEMENT} px, {record['n_subdomains']} "
              f"subdomains, 2 ranks, l_c = {WAVELENGTH} px", f"runs in one go in {MEMORY_GIB:g} GiB",
              f"{record['wall_s']:.0f} s wall, {record['cpu_s_of_phases']:.0f} CPU s, {memory:.2f} GiB; "
              f"RMS error {record['rms_error_px']:.5f} px", memory <= MEMORY_GIB)
    return [row]


def run(case: BenchCase) -> dict[str, Any]:
    """The record of one run, which is kept."""
    record = run_record(case, [timed(case.measured, case.folder, 2, case.name)])
    append_result("big", record)
    return record


def show(record: dict[str, Any], smaller: dict[str, Any] | None) -> None:
    """Print time by phase and memory; with a smaller run also the straight line through both at full size."""
    def line(name: str, value: float, before: float, unit: str, wall: float | None = None) -> None:
        there = value if smaller is None else value + (value - before) * (FULL**2 - n) / (n - smaller["n_pixels"])
        print(f"  {name:<20}" + (" " * 9 if wall is None else f"{wall:9.2f}") + f"{value:9.2f}" +
              ("" if smaller is None else f"{there:11.1f}") + f"  {unit}")

    n = record["n_pixels"]
    print(f"{record['case']}: {n / 1e6:.1f} Mpx, {record['n_dofs']} unknowns, 2 ranks" +
          ("" if smaller is None else f"; last column: {FULL} x {FULL} px, extrapolated from this and "
                                      f"{smaller['n_pixels'] / 1e6:.1f} Mpx, not measured"))
    print(f"  {'':<20}{'wall s':>9}{'CPU s':>9}")
    for phase, cpu in record["cpu_seconds"].items():
        line(phase, cpu, smaller["cpu_seconds"][phase] if smaller else 0.0, "CPU s", record["seconds"][phase])
    line("all phases", record["cpu_s_of_phases"], smaller["cpu_s_of_phases"] if smaller else 0.0, "CPU s",
         record["wall_s"])
    line("memory", record["memory_total_bytes"] / 2**30, smaller["memory_total_bytes"] / 2**30 if smaller else 0.0,
         "GiB, both ranks", None)
    sys.stdout.flush()


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=5000, help="side of the images, pixels")
    rows = measure(parser.parse_args(arguments).size)
    for row in rows:
        append_result("big", vars(row))
    return show_all(rows)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
