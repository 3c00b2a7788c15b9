"""The examples of [PP12]: gradient noise on a plate clamped on one side, corrections to convergence, errors by size.

And the corrections that the field of an inclined crack takes, with and without the update step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import ddic
from accept.table import Scale
from bench.support.opened_pair import Crack
from bench.support.rows import Row, append_result
from bench.support.separated_cases import (
    COMPLETE,
    ELEMENT,
    KINDS,
    PUBLISHED,
    REGION,
    SIZE,
    Pair,
    Plate,
    Uniform,
    list_pixels,
    measure_pgd,
    measure_rms,
    render,
)

ETA = 1e-3
"""Of [PP12]: RMS of a correction relative to the displacement, of both components."""

MOST = {"float": 12, "16 bit": 12, "8 bit": 25}
"""Corrections to it, by the kind of images."""

SIZES, SMOKE_SIZES = (8, 16, 19, 38, 76), (16, 38)
"""Sides of elements that divide the region, pixels."""

SHIFTS, SMOKE_SHIFTS = (0.1, 0.3, 0.5, 0.7, 0.9), (0.3,)
"""Uniform displacements along both axes, pixels."""

SLOPES = {"error": -1.49, "uncertainty": -1.70}
"""The paper's, of log-log curves."""

LARGEST_OF_SLOPE = {"error": 19, "uncertainty": 76}
"""Elements up to which a slope is taken, pixels."""

WITHIN = 0.10


def count_to_eta(result: ddic.Result) -> int | None:
    """Corrections after which the paper's eta is below ETA for both components; None where it never is."""
    eta = np.maximum(result.corrections["relative_x"], result.corrections["relative_y"])
    below = np.flatnonzero(eta < ETA)
    return int(below[0]) + 1 if len(below) else None


def measure_corrections(scale: Scale) -> list[Row]:
    """Count corrections on float, 16-bit, 8-bit and noisy images."""
    rows, points, plate = [], list_pixels(), Plate()
    known = plate.displacement(points)
    for kind in KINDS[:1] if scale.smoke else KINDS:
        pair = render(plate, kind)
        published, default = measure_pgd(pair, ELEMENT, PUBLISHED), measure_pgd(pair, ELEMENT, {})
        q4 = ddic.measure(pair, ddic.structured_mesh(REGION, ELEMENT), solver={"method": "assembled"})
        n, most = count_to_eta(published), MOST.get(kind)
        errors = {name: measure_rms(result.at(points) - known)
                  for name, result in (("published", published), ("default", default), ("Q4", q4))}
        n_default = len(default.corrections["correction"])
        append_result("pgd_runs", {"check": "corrections", "kind": kind, "n": n, "n_default": n_default, **errors})
        rows.append(Row(f"first example of [PP12], {kind}, 16-px elements, published algorithm: corrections to eta < "
                        f"{ETA:g} (default: update, stop at noise)",
                        f"at most {most}" if most else "reported beside 32-36 of a prototype",
                        f"{n} corrections, error {errors['published']:.5f} px (default: {n_default} corrections, "
                        f"{errors['default']:.5f} px; Q4-DIC {errors['Q4']:.5f} px)",
                        most is None or (n is not None and n <= most), judged_small=most is not None))
    return rows


def measure_sizes(scale: Scale) -> list[Row]:
    """Compare error and uncertainty with Q4-DIC's as functions of the elements' size."""
    sizes = SMOKE_SIZES if scale.smoke else SIZES
    pairs: dict[str, list[tuple[Pair, Plate | Uniform]]] = {
        "error": [(render(Plate(), "8 bit"), Plate())],
        "uncertainty": [(render(Uniform((shift, shift)), "8 bit, noise of 2", seed=k), Uniform((shift, shift)))
                        for k, shift in enumerate(SMOKE_SHIFTS if scale.smoke else SHIFTS)]}
    return [_compare(name, sizes, pairs[name]) for name in pairs]


def _compare(name: str, sizes: tuple[int, ...], pairs: list[tuple[Pair, Plate | Uniform]]) -> Row:
    points, of_pgd, of_q4 = list_pixels(), [], []
    for size in sizes:
        mesh = ddic.structured_mesh(REGION, size)
        found: list[tuple[float, float]] = []
        for pair, field in pairs:
            known = field.displacement(points)
            pgd = measure_pgd(pair, size, COMPLETE)
            q4 = ddic.measure(pair, mesh, solver={"method": "assembled"})
            found.append((measure_rms(pgd.at(points) - known, spread=name == "uncertainty"),
                          measure_rms(q4.at(points) - known, spread=name == "uncertainty")))
        of_pgd.append(np.mean([a for a, _ in found]))
        of_q4.append(np.mean([b for _, b in found]))
    ratios = np.array(of_pgd) / np.array(of_q4)
    # On larger elements the plate's error is that of the elements, not of the images.
    n = sum(size <= LARGEST_OF_SLOPE[name] for size in sizes)
    slopes = [float(np.polyfit(np.log(sizes[:n]), np.log(values[:n]), 1)[0]) if n > 1 else float("nan")
              for values in (of_pgd, of_q4)]
    append_result("pgd_runs", {"check": name, "sizes": list(sizes), "pgd": of_pgd, "q4": of_q4, "slopes": slopes})
    listed = "; ".join(f"{h} px: {a:.4f} beside {b:.4f} px" for h, a, b in zip(sizes, of_pgd, of_q4, strict=True))
    what = "8 bit, error of the plate" if name == "error" else "uniform displacements, noise of 2 grey levels, spread"
    return Row(f"first example of [PP12], {what} by element size, beside Q4-DIC's", f"within {WITHIN:.0%}",
               f"{listed}; slope up to {sizes[n - 1]} px {slopes[0]:.2f} (Q4-DIC {slopes[1]:.2f}; the paper's "
               f"{SLOPES[name]:.2f})",
               bool((np.abs(ratios - 1.0) <= WITHIN).all()))


CRACK_ELEMENT, SMOKE_CRACK_ELEMENT = 8, 16
"""Side of the elements, pixels."""

PAPER, PAPER_Q4 = 81, 25
"""Corrections of [PP12], and its iterations of Q4-DIC."""

RUNS: dict[str, dict[str, Any]] = {
    "published": {**PUBLISHED, "max_corrections": 400},
    "with update": {**PUBLISHED, "update": True},
    "default": {},
}


def measure_separated_crack(scale: Scale) -> list[Row]:
    """Measure an inclined crack in mode I, its line not known."""
    element = SMOKE_CRACK_ELEMENT if scale.smoke else CRACK_ELEMENT
    crack = Crack(tip=np.array([250.3, 250.7]))
    pair, points = render(crack, "float", SIZE), list_pixels()
    known = crack.displacement(points)
    found = {}
    for name, pgd in list(RUNS.items())[-1:] if scale.smoke else RUNS.items():
        result = measure_pgd(pair, element, pgd)
        error = measure_rms(result.at(points) - known)
        found[name] = (len(result.corrections["correction"]), count_to_eta(result), error)
    q4 = ddic.measure(pair, ddic.structured_mesh(REGION, element),
                      solver={"method": "assembled"}, start={"pyramid": False})
    n_q4, error_q4 = len(q4.gauss_newton["iteration"]), measure_rms(q4.at(points) - known)
    append_result("pgd_runs", {"check": "crack", **found, "q4": [n_q4, error_q4]})
    listed = "; ".join(f"{name}: {n} corrections ({eta} to eta < 1e-3), error {error:.4f} px"
                       for name, (n, eta, error) in found.items())
    return [Row(f"mode I crack at {np.rad2deg(crack.angle):.0f} degrees across the region, {element}-px elements, "
                "float images, from a rigid translation", f"converges; the paper needs {PAPER} corrections (Q4-DIC "
                f"{PAPER_Q4})", f"{listed}; Q4-DIC {n_q4} iterations, {error_q4:.4f} px", True)]
