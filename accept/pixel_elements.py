"""Elements of one pixel: a million unknowns, and the same by the dual solver, by size of the region."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import ddic
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.separated_cases import (
    WAVELENGTH,
    Pair,
    find_region,
    list_pixels,
    measure_pixels,
    measure_rms,
    render_reference,
)
from ddic.parallel.team import require_held
from ddic.plots.canvas import save_figure
from ddic.synth.fields import Sinusoidal


def draw_comparison(sides: Sequence[float], found: Mapping[str, Sequence[Mapping[str, float]]]) -> Figure:
    """Draw CPU times of PGD-DIC and Q4 R-DIC, and how far their displacements are apart, as Fig. 17 of [PP12].

    Parameters
    ----------
    sides : sequence of float
        Of the region, pixels.
    found : mapping of sequence of mapping
        By kind of images, for each side: ``pgd_cpu_s``, ``q4_cpu_s``, ``difference_px``, ``pgd_error_px``,
        ``q4_error_px``.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(9.0, 5.0), layout="tight")
    times, apart = figure.subplots(1, 2)
    for style, (kind, of_sides) in zip(("-", "--", ":"), found.items(), strict=False):
        for axes, keys in ((times, {"pgd_cpu_s": "PGD-DIC", "q4_cpu_s": "Q4 R-DIC, dual solver"}),
                           (apart, {"difference_px": "difference", "pgd_error_px": "error of PGD-DIC",
                                    "q4_error_px": "error of Q4 R-DIC"})):
            for colour, (key, label) in zip(("tab:blue", "tab:orange", "tab:green"), keys.items(), strict=False):
                axes.loglog(sides, [one[key] for one in of_sides], style, color=colour, marker="o", markersize=3,
                            linewidth=1.4, label=f"{label}, {kind}")
    times.set_ylabel("CPU time [s]")
    apart.set_ylabel("RMS displacement [px]")
    for axes in (times, apart):
        axes.set_xlabel("side of the region [px]")
        axes.grid(which="both", alpha=0.25)
        axes.set_xticks(list(sides), [f"{side:g}" for side in sides])
        axes.set_xticks([], minor=True)
        axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    return figure


SIZE, SMOKE_SIZE = 1024, 256
"""Side of the images, pixels."""

SIDE, SMOKE_SIDE = 710, 120
"""Of the region in their middle."""

MOST_CORRECTIONS, MOST_CPU_S, PAPER_RESIDUAL = 10, 1.5, 0.59
"""Corrections on float images, CPU seconds of a measurement, and the paper's residual in percent of the range."""

RUNS = (("default", True, True), ("without update", True, False),
        ("without update, from a rigid translation", False, False))
"""Whether a pyramid starts, and whether all functions of a direction are found anew after each mode."""

SIDES, SMOKE_SIDES = (100, 200, 400, 700), (60,)
"""Of the regions that are measured by both methods, pixels."""

SUBDOMAIN_SIDE = 50
"""Pixels: subdomains of the dual solver, on which it is fastest among 25, 50 and 100."""

ALL_CONTROLLED: dict[str, Any] = {"cut_off_wavelength": WAVELENGTH, "not_controlled": []}
"""Of both methods where they are compared."""

TIMES_CHEAPER = 5.0

Array = NDArray[np.float64]
Timed = tuple[ddic.Result, float]


def timed(measure: Callable[[], ddic.Result]) -> Timed:
    """Run a measurement; its result and its CPU seconds."""
    begin = time.process_time()
    result = measure()
    return result, time.process_time() - begin


def measure_million(scale: Scale) -> list[Row]:
    """Measure a million unknowns on float, 8-bit and noisy images."""
    size, side = (SMOKE_SIZE, SMOKE_SIDE) if scale.smoke else (SIZE, SIDE)
    region = find_region(size, side)
    points = list_pixels(region)
    known = Sinusoidal().displacement(points)
    measure_pixels(render_reference(SMOKE_SIZE, "float"), SMOKE_SIDE)
    rows = []
    for kind in ("float", "8 bit", "8 bit, noise of 2"):
        pair = render_reference(size, kind)
        runs = {name: timed(partial(measure_pixels, pair, side, pyramid=pyramid, update=update))
                for name, pyramid, update in RUNS}
        counts = {name: len(result.corrections["correction"]) for name, (result, _) in runs.items()}
        texts = []
        for name, (result, cpu) in runs.items():
            spread = float(np.nanstd(require_held(result.residual_image)))
            residual = 100 * spread / float(np.ptp(pair[0].astype(float)))
            error = measure_rms(result.at(points) - known)
            append_result("pgd_runs", {"check": "million", "kind": kind, "run": name, "n": counts[name],
                                       "cpu_s": cpu, "residual_percent": residual, "error_px": error})
            texts.append(f"{name} {counts[name]} corrections, {cpu:.2f} s CPU with start and result, residual "
                         f"{residual:.2f} %, error {error:.4f} px")
        holds = kind != "float" or (max(counts.values()) <= MOST_CORRECTIONS
                                    and max(cpu for _, cpu in runs.values()) <= MOST_CPU_S)
        bound = (f"at most {MOST_CORRECTIONS} corrections, {MOST_CPU_S:g} s CPU; residual beside {PAPER_RESIDUAL} %"
                 if kind == "float" else "reported")
        rows.append(Row(f"{side} x {side} px of {size} x {size} px, 1-px elements ({2 * (side + 1)**2} unknowns), "
                        f"cut-off {WAVELENGTH:g} px, {kind}", bound, "; ".join(texts), holds, judged_small=False))
    return rows


def measure_by_dual(pair: Pair, side: int) -> ddic.Result:
    """Measure the same by Q4 R-DIC with elements of a pixel through the dual solver.

    Nodes on the edge of such a mesh have fewer pixels than unknowns: the dual solver finds subdomains there singular
    unless their equilibrium is imposed too.
    """
    blocks = max(1, round(side / SUBDOMAIN_SIDE))
    mesh = ddic.structured_mesh(find_region(len(pair[0]), side), 1)
    return ddic.measure(pair, mesh, regularization=ALL_CONTROLLED, solver={"method": "dual", "partition": "blocks",
                                                        "blocks": [blocks, blocks]})


def measure_against_dual(scale: Scale) -> list[Row]:
    """Compare displacements and CPU times with those of the dual solver, by size of the region."""
    size, sides = (SMOKE_SIZE, SMOKE_SIDES) if scale.smoke else (SIZE, SIDES)
    measure_pixels(render_reference(SMOKE_SIZE, "float"), 60)
    measure_by_dual(render_reference(SMOKE_SIZE, "float"), 60)
    rows, found = [], {}
    for kind in ("float", "8 bit, noise of 2"):
        pair = render_reference(size, kind)
        found[kind] = [_compare(pair, side) for side in sides]
        append_result("pgd_runs", {"check": "dual", "kind": kind, "sides": list(sides), "found": found[kind]})
        listed = "; ".join(f"{side} px: difference {one['difference_px']:.4f} px, errors {one['pgd_error_px']:.4f} "
                           f"(Q4 {one['q4_error_px']:.4f}) px, {one['pgd_cpu_s']:.2f} s CPU (Q4 "
                           f"{one['q4_cpu_s']:.1f}), {one['q4_cpu_s'] / one['pgd_cpu_s']:.0f} times"
                           for side, one in zip(sides, found[kind], strict=True))
        times = found[kind][-1]["q4_cpu_s"] / found[kind][-1]["pgd_cpu_s"]
        is_bound = kind == "float"
        bound = f"at least {TIMES_CHEAPER:g} times cheaper at {sides[-1]} px" if is_bound else "reported"
        rows.append(Row(f"PGD-DIC and Q4 R-DIC by the dual solver, 1-px elements, cut-off {WAVELENGTH:g} px, all nodes "
                        f"controlled, {kind}, by size of the region", bound, listed,
                        times >= TIMES_CHEAPER or not is_bound, judged_small=False))
    # A picture of the documentation.
    folder = scale.folder("pgd_against_dual")
    folder.mkdir(parents=True, exist_ok=True)
    save_figure(draw_comparison(sides, found), folder / "pgd_against_dual.png")
    return rows


def _compare(pair: Pair, side: int) -> dict[str, float]:
    points = list_pixels(find_region(len(pair[0]), side))
    known = Sinusoidal().displacement(points)
    pgd, pgd_cpu = timed(lambda: measure_pixels(pair, side, ALL_CONTROLLED))
    q4, q4_cpu = timed(lambda: measure_by_dual(pair, side))
    u, v = pgd.at(points), q4.at(points)
    return {"difference_px": measure_rms(u - v), "pgd_error_px": measure_rms(u - known),
            "q4_error_px": measure_rms(v - known), "pgd_cpu_s": pgd_cpu, "q4_cpu_s": q4_cpu}
