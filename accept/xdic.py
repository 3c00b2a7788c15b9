"""The acceptance table of discontinuities: ``make accept-xdic``, a check alone with CHECK=NAME.

Pairs are exact: every side of a line shows the same speckle, moved by a displacement of its own. They have 16 bits and
speckles of 1.6 times the reference size unless a row says otherwise.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

import ddic
from accept.band import measure_band
from accept.bolted import measure_bolted
from accept.crack import measure_crack
from accept.real_cracks import measure_failed_hole, measure_fracture
from accept.slip import measure_slip
from accept.support.opened_pair import (
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
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Check, Scale, run_table
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
    """Measure uniform displacements with a line that does not open.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image and one displacement.

    Returns
    -------
    list of Row
        With noise of 2 grey levels of 256, and without.
    """
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
                continuous = ddic.measure(pair, mesh, options=MONOLITHIC)
                enriched = ddic.measure(pair, mesh, options={
                    **MONOLITHIC, "discontinuity": opened.sections("tangential")})
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
    """Measure two lines that cross a hole's surroundings, a polyline with a bend, and T3, beside one line on Q4.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image.

    Returns
    -------
    list of Row
        One row.
    """
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
        result = ddic.measure(render(opened, size), mesh, options={
            **MONOLITHIC, "discontinuity": opened.sections("both")})
        errors[name] = find_opening_error(result, opened)
    bound = SHAPES_FACTOR * errors["one line on Q4"]
    return [Row(f"other lines and meshes, {element}-px elements, any opening, {describe_settings(MONOLITHIC)}: RMS "
                "error of the opening",
                f"at most {SHAPES_FACTOR} times that of one line on Q4",
                "; ".join(f"{name} {error:.1e} px" for name, error in errors.items()),
                all(error <= bound for error in errors.values()))]


def measure_solvers(scale: Scale) -> list[Row]:
    """Compare dual and conjugate gradients with the assembled operator, the line crossing interfaces.

    Parameters
    ----------
    scale : Scale
        A smoke run takes two ranks.

    Returns
    -------
    list of Row
        One row.
    """
    ranks = SMOKE_RANKS if scale.smoke else RANKS
    records = [record for n in ranks for record in run_job(n, "accept.support.xdic_job", str(SMOKE_SIZE))]
    largest = max(record["difference_px"] for record in records)
    return [Row("dual and conjugate gradients against the assembled operator on 1-4 ranks, the line crosses "
                "interfaces, with and without regularization", f"<= {SAME_PX:.0e} px",
                f"{largest:.1e} px of {len(records)}", largest <= SAME_PX)]


CHECKS: dict[str, Check] = {
    "slip": measure_slip,
    "bolted": measure_bolted,
    "band": measure_band,
    "crack": measure_crack,
    "fracture": measure_fracture,
    "failed_hole": measure_failed_hole,
    "uniform": measure_uniform,
    "shapes": measure_shapes,
    "solvers": measure_solvers,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the table; 1 where a bound is missed."""
    return run_table("xdic", CHECKS, arguments)


if __name__ == "__main__":
    sys.exit(main())
