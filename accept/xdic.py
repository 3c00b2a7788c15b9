"""Lines across a pair: uniform motions, shapes of the region, and the same jump by every solver.

Pairs are exact: every side of a line shows the same speckle, moved by a displacement of its own. They have 16 bits and
speckles of 1.6 times the reference size unless a row says otherwise. Under MPI, as python -m accept.xdic SIZE, the side
of the images in pixels, rank 0 prints a JSON line for each solver and regularization.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from mpi4py import MPI

import ddic
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.opened_pair import (
    MARGIN,
    SIZE,
    SMOKE_SIZE,
    Opened,
    find_field_error,
    find_opening_error,
    mesh_inside,
    render,
    straight_line,
)
from bench.support.rows import Row
from bench.support.runs import run_job

SHIFTS, SMOKE_SHIFTS = np.linspace(0.0, 1.0, 11), (0.3,)
UNIFORM_ELEMENTS, SMOKE_ELEMENTS = (16, 32, 64), (32,)
MOST_WITH_NOISE, MOST_NOISE_FREE, LEAST_PX, UNIFORM_PX = 1.1, 1.25, 1e-4, 1e-3
"""Standard deviations of enriched elements: times those of continuous ones with and without noise, or pixels; pixels at
32 px, noise-free."""

SHAPES_FACTOR = 1.2
"""RMS errors of openings beside that of one straight line on Q4."""

SAME_PX = 1e-9
"""Largest difference between solvers."""

RANKS, SMOKE_RANKS = (1, 2, 3, 4), (2,)


def measure_uniform(scale: Scale) -> list[Row]:
    """Measure uniform displacements with a line that does not open."""
    size = SMOKE_SIZE if scale.smoke else SIZE
    shifts = SMOKE_SHIFTS if scale.smoke else SHIFTS
    rows = []
    for noise in (2.0, 0.0):
        spreads: dict[int, tuple[float, float]] = {}
        for element in SMOKE_ELEMENTS if scale.smoke else UNIFORM_ELEMENTS:
            of_continuous, of_enriched = [], []
            for seed, shift in enumerate(shifts):
                opened = straight_line(size, 0.0, shift)
                pair = render(opened, size, noise=noise, seed=seed)
                mesh = mesh_inside(size, element)
                continuous = ddic.measure(pair, mesh, **MONOLITHIC)
                enriched = ddic.measure(pair, mesh, **MONOLITHIC, discontinuity=opened.sections("tangential"))
                of_continuous.append(find_field_error(continuous, opened, spread=True))
                of_enriched.append(find_field_error(enriched, opened, spread=True))
            spreads[element] = (float(np.mean(of_continuous)), float(np.mean(of_enriched)))
        most = MOST_WITH_NOISE if noise else MOST_NOISE_FREE
        holds = all(b <= most * a or (not noise and b <= LEAST_PX) for a, b in spreads.values())
        bound = f"at most {most} times that of continuous elements"
        if not noise:
            holds = holds and spreads.get(32, (0.0, 0.0))[1] <= UNIFORM_PX
            bound += f", or {LEAST_PX:.0e} px; <= {UNIFORM_PX:.0e} px at 32 px"
        rows.append(Row(f"uniform displacements of 0 to 1 px, noise of {noise:g} grey levels, a line that may slide, "
                        f"{describe_settings(MONOLITHIC)}: standard deviation", bound,
                        "; ".join(f"{k} px: {b:.2e} beside {a:.2e} px" for k, (a, b) in spreads.items()), holds,
                        judged_small=bool(noise)))
    return rows


def measure_shapes(scale: Scale) -> list[Row]:
    """Measure two lines that cross a hole's surroundings, a polyline with a bend, and T3, beside one line on Q4."""
    size, element = (SMOKE_SIZE, 32) if scale.smoke else (SIZE, 32)
    middle = size / 2
    jump = np.array([0.31, -0.22])
    one = Opened((np.array([[-50.0, middle - 90.3], [size + 50.0, middle + 60.2]]),), (jump,))
    bent = Opened((np.array([[-50.0, middle - 60.3], [middle + 3.7, middle + 4.1], [size + 50.0, middle - 40.6]]),),
                  (jump,))
    two = Opened((one.lines[0], np.array([[middle - 70.4, -50.0], [middle - 40.3, size + 50.0]])),
                 (jump, np.array([-0.2, 0.17])))
    hole = ddic.structured_mesh((MARGIN, MARGIN, size - MARGIN, size - MARGIN), element,
                                circles=[((middle - 60.0, middle), 40.0)])
    cases = {"one line on Q4": (one, mesh_inside(size, element)), "on T3": (one, mesh_inside(size, element, "T3")),
             "a bend": (bent, mesh_inside(size, element)), "two lines, one across the edge of a hole": (two, hole)}
    errors = {}
    for name, (opened, mesh) in cases.items():
        result = ddic.measure(render(opened, size), mesh, **MONOLITHIC, discontinuity=opened.sections("both"))
        errors[name] = find_opening_error(result, opened)
    bound = SHAPES_FACTOR * errors["one line on Q4"]
    return [Row(f"other lines and meshes, {element}-px elements, any opening, {describe_settings(MONOLITHIC)}: RMS "
                "error of the opening",
                f"at most {SHAPES_FACTOR} times that of one line on Q4",
                "; ".join(f"{name} {error:.1e} px" for name, error in errors.items()),
                all(error <= bound for error in errors.values()))]


def measure_solvers(scale: Scale) -> list[Row]:
    """Compare dual and conjugate gradients with the assembled operator, the line crossing interfaces."""
    ranks = SMOKE_RANKS if scale.smoke else RANKS
    records = [record for n in ranks for record in run_job(n, "accept.xdic", str(SMOKE_SIZE))]
    largest = max(record["difference_px"] for record in records)
    return [Row("dual and conjugate gradients against the assembled operator on 1-4 ranks, the line crosses "
                "interfaces, with and without regularization", f"<= {SAME_PX:.0e} px",
                f"{largest:.1e} px of {len(records)}", largest <= SAME_PX)]


SOLVED_SLIP, SOLVED_ELEMENT, SOLVED_MARGIN, N_SUBDOMAINS = 0.6, 16, 20, 6
"""Of the pair that all solvers measure: pixels; number of subdomains."""

EXACT: dict[str, Any] = {"gauss_newton": {"tolerance": 1e-10, "rms_tolerance": 0, "largest_tolerance": 1e-8}}
LINEAR: dict[str, Any] = {"subdomains": N_SUBDOMAINS, "inexact": False, "tolerance": 1e-11}
REGULARIZATIONS: dict[str, dict[str, Any]] = {"none": {}, "64 px": {"regularization": {"cut_off_wavelength": 64}}}


def main(size: str) -> None:
    """Measure one pair by all solvers."""
    opened = straight_line(int(size), SOLVED_SLIP)
    pair = render(opened, int(size))
    side = SOLVED_ELEMENT * ((int(size) - 2 * SOLVED_MARGIN) // SOLVED_ELEMENT)
    end = SOLVED_MARGIN + side
    mesh = ddic.structured_mesh((SOLVED_MARGIN, SOLVED_MARGIN, end, end), SOLVED_ELEMENT)
    points = np.random.default_rng(0).uniform(SOLVED_MARGIN, end, (5000, 2))
    for opening in ("both", "tangential"):
        for name, regularization in REGULARIZATIONS.items():
            fields = {}
            for method in ("assembled", "dual", "conjugate_gradient"):
                settings = {**EXACT, **regularization, "solver": {"method": method, **LINEAR},
                            "discontinuity": opened.sections(opening)}
                fields[method] = ddic.measure(pair, mesh, **settings).at(points)
            for method in ("dual", "conjugate_gradient"):
                difference = float(np.nanmax(np.abs(fields[method] - fields["assembled"])))
                if MPI.COMM_WORLD.rank == 0:
                    print(json.dumps({"method": method, "opening": opening, "regularization": name,
                                      "ranks": MPI.COMM_WORLD.size, "difference_px": difference}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
