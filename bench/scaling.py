"""What grows with the number of ranks: oversubscribed runs with 4 to 144 ranks, and what they say about 1,000.

Usage: python -m bench.scaling [KIND ...] [--ranks N ...]. Weak runs have one subdomain of about 320 x 320 px a
rank, strong runs share the same subdomains whatever the number of ranks, both at a short and at a long cut-off
wavelength, with CPU seconds of work that communicates with nobody, and counted messages and bytes; coarse is the
coarse problem of 64 to 1,024 subdomains on one rank. Records go to bench/results/scaling.jsonl; the tables of
docs/scaling.md are what this prints of the last record of each case. The model takes its rates a pixel from the
largest run of ``make bench-big``. MPIEXEC=srun runs on all nodes of a Slurm job: bench/cluster.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from bench.support.paper_scaling_model import build_models, coarse_table, measured_table, model_table
from bench.support.rows import RESULTS, append_result
from bench.support.runs import DATA, images, run_job

JOB = "bench.support.paper_scaling_job"
RANKS = (4, 16, 64, 144)
RANK_MIB = 120
"""Memory that a rank of these runs takes beside what it shares with the others."""
MOST_OF_MEMORY = 0.8
"""Of what is free, that a run may take."""
MARGIN = 32
SIDE, ELEMENT = 320, 16
SHORT, LONG = 64, 4 * SIDE
LEVELS = (("short", SHORT, "scaled"), ("long", LONG, "two_level"))
"""Name, cut-off wavelength in pixels, and preconditioner."""
STRONG_SIDE, STRONG_SUBDOMAINS = 32 * SIDE, 1024
"""Side of the square in pixels and number of subdomains that all ranks share: as large as weak ones of 1,024 ranks."""
COARSE_SIDES, COARSE_ELEMENT, COARSE_ELEMENTS = (8, 16, 32), 8, 10
WAVES = 8192
"""Pixels: l_c of the long case must not flatten the field, or ranks look for what spoils the images."""


def case(folder: Path, side: int, element: int, wavelength: float, solver: str, name: str) -> Path:
    """A case file of a square of side x side pixels; solver: keys of its section."""
    end = MARGIN + side
    file = folder / f"{name}.toml"
    file.write_text(f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [{MARGIN}, {MARGIN}, {end}, {end}]
element_size = {element}
[regularization]
cut_off_wavelength = {wavelength}
[solver]
{solver}
[output]
file = "{name}.vtkhdf"
""", encoding="utf-8")
    return file


def counted(n_ranks: int, files: list[str], n_jobs: int = 1) -> list[dict[str, Any]]:
    """Run case files in some jobs of so many ranks at the same time, and keep their records."""
    records = run_job(n_jobs * n_ranks, JOB, str(n_jobs), *files)
    for record in records:
        append_result("scaling", record)
    return records


def weak(n_ranks: int, n_jobs: int = 1) -> list[dict[str, Any]]:
    """One subdomain a rank, one level at the short wavelength and two at the long one; images as large as all ranks.

    With several jobs so many ranks each run their own case at the same time, as crowded as one job of them all.
    """
    blocks = round(n_ranks**0.5)
    if blocks**2 != n_ranks or blocks < 2:
        raise RuntimeError(f"--ranks {n_ranks}: must be a square from 4 on")
    # Without swap the system would end programs, and not necessarily this one.
    gib = n_jobs * n_ranks * RANK_MIB / 1024 / int(os.environ.get("SLURM_JOB_NUM_NODES", "1"))
    free = psutil.virtual_memory().available / 2**30
    if gib > MOST_OF_MEMORY * free:
        raise RuntimeError(f"--ranks {n_ranks}: takes {gib:.0f} GiB, too much of the "
                           f"{free:.0f} that are free; leave out the largest numbers of ranks")
    folder = pair(blocks * SIDE)
    files = []
    for name, wavelength, kind in LEVELS:
        keys = f'method = "dual"\nsubdomains = {n_ranks}\npreconditioner = "{kind}"'
        of_jobs = f"weak_{n_ranks}_{name}" if n_jobs == 1 else f"beside_{n_ranks}_{name}_{{job}}"
        for job in range(n_jobs):
            case(folder, blocks * SIDE, ELEMENT, wavelength, keys, of_jobs.format(job=job))
        files.append(str(folder / f"{of_jobs}.toml"))
    return counted(n_ranks, files, n_jobs)


def strong(n_ranks: int) -> list[dict[str, Any]]:
    """The same images and subdomains whatever the number of ranks."""
    folder = pair(STRONG_SIDE)
    return counted(n_ranks, [
        str(case(folder, STRONG_SIDE, ELEMENT, wavelength, f'method = "dual"\nsubdomains = {STRONG_SUBDOMAINS}\n'
                 f'preconditioner = "{kind}"', f"strong_{n_ranks}_{name}"))
        for name, wavelength, kind in LEVELS])


def pair(side: int) -> Path:
    """Images of a region of side x side pixels."""
    size = 2 * MARGIN + side
    waves = [str(WAVES), str(WAVES)]
    return images("sinusoidal", "--size", f"{size}x{size}", "--wavelength-x", *waves, "--wavelength-y", *waves,
                  folder=DATA / f"scaling_{size}")


def coarse() -> list[dict[str, Any]]:
    """The coarse problem of many small subdomains."""
    side = COARSE_ELEMENT * COARSE_ELEMENTS
    folder = pair(max(COARSE_SIDES) * side)
    keys = 'method = "dual"\npartition = "blocks"\npreconditioner = "two_level"\nblocks = '
    return counted(1, [str(case(folder, blocks * side, COARSE_ELEMENT, 4 * side, f"{keys}[{blocks}, {blocks}]",
                                f"coarse_{blocks**2}")) for blocks in COARSE_SIDES])


def pixel_rates() -> dict[str, Any]:
    """The largest record of bench/big.py, whose CPU seconds a pixel the model takes over."""
    file = RESULTS / "big.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    records: list[dict[str, Any]] = [record for record in map(json.loads, lines) if "result_bytes" in record]
    if not records:
        raise RuntimeError("bench/results/big.jsonl has no run: start bench/big.py first")
    largest = max(record["n_pixels"] for record in records)
    return [record for record in records if record["n_pixels"] == largest][-1]


def kept(kind: str) -> list[dict[str, Any]]:
    """The last record of each case of a kind, by size: weak, strong or coarse."""
    file = RESULTS / "scaling.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    last = {record["case"]: record for record in map(json.loads, lines)}
    ordered = sorted(last.values(), key=lambda record: (record["n_ranks"], record["n_dofs"]))
    return [record for record in ordered if record["case"].startswith(f"{kind}_")]


TABLES: dict[str, Callable[[list[dict[str, Any]]], str]] = {
    "weak": partial(measured_table, "Measured: one subdomain of about 320 x 320 px (400 Q4) a rank"),
    "strong": partial(measured_table, f"Measured: {STRONG_SIDE} x {STRONG_SIDE} px, {STRONG_SUBDOMAINS:,} subdomains"),
    "coarse": coarse_table,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND",
                        help="weak, strong, coarse, and the model of what they say; all but strong by default")
    parser.add_argument("--ranks", type=int, nargs="+", default=RANKS, help="squares from 4 on, of strong runs any")
    parser.add_argument("--report", action="store_true", help="only print the tables of the records kept")
    chosen = parser.parse_args()
    kinds = chosen.kinds or ["weak", "coarse", "model"]
    unknown = sorted(set(kinds) - {*TABLES, "model"})
    if unknown:
        parser.error(f"no such kind: {', '.join(unknown)}")
    rates = pixel_rates() if "model" in kinds else {}
    for kind in () if chosen.report else kinds:
        for n_ranks in chosen.ranks if kind in ("weak", "strong") else ():
            (weak if kind == "weak" else strong)(n_ranks)
        if kind == "coarse":
            coarse()
    for kind in kinds:
        print(model_table(build_models(kept("weak"), kept("coarse"), rates)) if kind == "model"
              else TABLES[kind](kept(kind)))


if __name__ == "__main__":
    main()
