"""One thread against several on one rank: 4096 x 4096 px, 16-px Q4, as one subdomain and as those of the paper's size.

First what is computed from pixels, alternately in one process; then phases of ``ddic run``, alternately as well. Both
are wall seconds, since CPU seconds do not fall with threads: medians, and the ratio of the shortest times too, which
other work on the machine disturbs least. Fields must agree to the last bit.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import h5py
import numpy as np

from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA, ddic_run, images
from ddic.functionals.correlation import read_correlations
from ddic.images.spline import read_gradient, read_spline
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.images.threads import Threads
from ddic.images.window import Window
from ddic.io.image_file import open_image
from ddic.mesh.structured import build_structured_mesh
from ddic.synth.truth import load_truth

MARGIN, ELEMENT = 32, 16
SUBDOMAIN = 160_000
"""Pixels of a subdomain in the paper's case: 29 megapixels in 180."""

COUNTS = (1, 2)
"""Threads."""

PIXEL_REPEATS = 10
"""Calls of what takes a tenth of a second, for each run."""

Times = dict[str, dict[int, list[float]]]
"""Wall seconds by what was done and number of threads."""

TOGETHER = "all phases"


def pixel_calls(folder: Path, size: int, n_threads: int) -> dict[str, Callable[[], object]]:
    """What a rank does with the pixels of one subdomain, by name."""
    reference, deformed = (MaskedSource(open_image(folder / f"{name}.tif")) for name in ("reference", "deformed"))
    threads = Threads(n_threads)
    mesh = build_structured_mesh((MARGIN, MARGIN, size - MARGIN, size - MARGIN), ELEMENT)
    part = read_correlations([mesh], reference, 3, threads)[0][0]
    q = load_truth(folder / "truth.json").displacement(mesh.nodes).ravel()
    image = DeformedSubImage(deformed, 3, threads)
    window = image.get_spline(part.find_displaced_window(q)).window
    return {
        "f and its gradient": lambda: read_gradient(reference.image, part.reference.window, 3, None, threads),
        "spline of g": lambda: read_spline(deformed.image, window, 3, None, threads),
        "M, sums of cells": part.compute_cell_hessians,
        "residual": lambda: part.compute_residual(image, q),
        "residual image": lambda: part.compute_residual_image(image, q),
        "file read alone": lambda: reference.image.read(Window.of_size(size, size)),
    }


def pixel_seconds(folder: Path, size: int, repeats: int) -> Times:
    """Times of each of ``pixel_calls``, after one that is not measured."""
    calls = {n: pixel_calls(folder, size, n) for n in COUNTS}
    seconds: Times = {name: {n: [] for n in COUNTS} for name in calls[COUNTS[0]]}
    for turn in range(repeats + 1):
        for name, measured in seconds.items():
            for n in COUNTS:
                began = time.perf_counter()
                calls[n][name]()
                if turn:
                    measured[n].append(time.perf_counter() - began)
    return seconds


def run(folder: Path, size: int, n_subdomains: int, n_threads: int) -> dict[str, Any]:
    """Summary of a run on one rank."""
    return ddic_run(f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [{MARGIN}, {MARGIN}, {size - MARGIN}, {size - MARGIN}]
element_size = {ELEMENT}
[regularization]
cut_off_wavelength = {4 * ELEMENT}
[solver]
method = "dual"
subdomains = {n_subdomains}
threads = {n_threads}
""", folder, 1, f"threads_{n_threads}")


def run_seconds(folder: Path, size: int, n_subdomains: int, repeats: int) -> Times:
    """Times of each phase of a run; raises RuntimeError where fields differ."""
    found: dict[int, list[dict[str, float]]] = {n: [] for n in COUNTS}
    for _ in range(repeats):
        for n in COUNTS:
            found[n].append(run(folder, size, n_subdomains, n)["seconds"])
    fields = []
    for n in COUNTS:
        with h5py.File(folder / f"threads_{n}.vtkhdf") as file:
            fields.append(file["VTKHDF/PointData/displacement"][...])
    if not all(np.array_equal(field, fields[0]) for field in fields):
        raise RuntimeError("the field depends on the number of threads")
    for times in found.values():
        for seconds in times:
            seconds[TOGETHER] = sum(seconds.values())
    return {name: {n: [seconds[name] for seconds in found[n]] for n in COUNTS} for name in found[COUNTS[0]][0]}


def row(what: str, seconds: Times) -> Row:
    """Keep and show the times of one table."""
    kept = {name: {str(n): s for n, s in by.items()} for name, by in seconds.items()}
    append_result("threads_runs", {"what": what, "load_average": os.getloadavg()[0], "seconds": kept})
    one, several = COUNTS[0], COUNTS[-1]
    shown = "".join(
        f"\n          {name:20s} {median(by[one]):7.3f} {median(by[several]):7.3f} "
        f"{median(by[one]) / median(by[several]):6.2f} {min(by[one]) / min(by[several]):6.2f}"
        for name, by in seconds.items())
    return Row(f"{one} and {several} threads, {what}",
               "the same field; medians, their ratio and that of the shortest times recorded", shown, True)


def measure(size: int, repeats: int) -> list[Row]:
    """Pixels of one subdomain, and runs with one and with many."""
    folder = images("sinusoidal", "--size", f"{size}x{size}", folder=DATA / f"threads_{size}")
    rows = [row("pixels of one subdomain", pixel_seconds(folder, size, PIXEL_REPEATS * repeats))]
    many = max(2, round(size**2 / SUBDOMAIN))
    rows += [row(f"ddic run, {n} subdomain{'s' if n > 1 else ''}", run_seconds(folder, size, n, repeats))
             for n in (1, many)]
    return [replace(r, check=f"{r.check}, {size} x {size} px") for r in rows]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=4096)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    main("threads", lambda: measure(arguments.size, arguments.repeats))
