"""Frames that start from an earlier result, from a table of points and from a few pairs, beside starts from nothing."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.deformed_pair import (
    Camera,
    Deformation,
    Measured,
    Pair,
    make_linear,
    make_rotation,
    measure_deformed,
    render_deformed,
)
from accept.table import Scale
from bench.support.rows import Row, append_result

Array = NDArray[np.float64]

SIDE, REGION, ELEMENT = 900, 260, 20
"""Sides of the images, of the region in their middle, and of the elements, pixels."""

OF_NOTHING = 1.1
"""Largest RMS error, times that of a start from nothing."""

SAME_PX = 1e-3
"""Largest difference, pixels, between a frame and the same frame restarted from its own result: Gauss-Newton's."""

WRONG_PX, N_POINTS = 1.5, 200
"""How wrong points of a table are, standard deviation in pixels, and how many."""

PERIOD, REPEATED_SHIFT = 12, 41.0
"""Of a repetitive texture, and how far it is shifted, pixels."""


def measure_initial_fields(scale: Scale) -> list[Row]:
    """Measure later frames of a series from given displacements.

    Parameters
    ----------
    scale : Scale
        A smoke run takes the jump of 40 px from the earlier result.

    Returns
    -------
    list of Row
        One for each later frame, and for the texture that only a given displacement finds.
    """
    mesh, first = _mesh_in_the_middle(REGION), _deform(0.0, np.zeros(2), 0.01)
    pair = render_deformed(first, Camera((SIDE, SIDE)))
    earlier = ddic.measure(pair, mesh)
    of_part = ddic.measure(pair, _mesh_in_the_middle(REGION / 2))
    later = {
        "a jump of 40 px": _deform(0.0, np.array([40.0, 0.0]), 0.014),
        "a jump of 180 px": _deform(0.0, np.array([-150.0, 100.0]), 0.014),
        "a jump of 40 px, 10 degrees and 5 % of strain": _deform(10.0, np.array([30.0, 27.0]), 0.06),
        "120 degrees": _deform(120.0, np.array([5.0, 9.0]), 0.014),
    }
    rows = []
    for name, deformation in list(later.items())[:1] if scale.smoke else later.items():
        rows.append(_compare(name, deformation, earlier, of_part))
    return rows if scale.smoke else [*rows, _restart(pair, mesh, earlier), _measure_repeated()]


def _mesh_in_the_middle(region: float) -> ddic.Mesh:
    low, high = (SIDE - region) / 2, (SIDE + region) / 2
    return ddic.structured_mesh((low, low, high, high), ELEMENT)


def _deform(degrees: float, translation: Array, strain: float) -> Deformation:
    """A rotation and a translation after strain and a wave of 300 px."""
    centre, turned = np.full(2, SIDE / 2), make_rotation(degrees) + np.eye(2)

    def displacement(points: Array) -> Array:
        offsets = points - centre
        wave = 300 / (2 * np.pi) * strain * np.sin(2 * np.pi * offsets / 300)
        stretched = offsets * [1 + strain, 1 - 0.3 * strain] + wave[:, ::-1] * [0.5, 0.2]
        return np.asarray(stretched @ turned.T + translation - offsets)

    return Deformation(displacement)


def _compare(name: str, deformation: Deformation, earlier: ddic.Result, of_part: ddic.Result) -> Row:
    """One later frame from everything that can be given."""
    mesh, pair = earlier.mesh, render_deformed(deformation, Camera((SIDE, SIDE)))
    nothing = measure_deformed(pair, mesh, deformation)
    found = {"the earlier result": measure_deformed(pair, mesh, deformation, start=earlier),
             "a result on a quarter of the region": measure_deformed(pair, mesh, deformation, start=of_part),
             f"{N_POINTS} points of a table, wrong by {WRONG_PX} px": _start_from_table(pair, mesh, deformation),
             "3 pairs in whole pixels": _start_from_pairs(pair, mesh, deformation)}
    for what, measured in found.items():
        append_result("start_runs", {"case": f"{name} from {what}", "rms": measured.rms, "nothing": nothing.rms,
                                     "refusal": measured.refusal})
    told = "; ".join(f"{what}: {_describe(measured)}" for what, measured in found.items())
    holds = nothing.converged and all(measured.converged and measured.rms <= OF_NOTHING * nothing.rms
                                      for measured in found.values())
    return Row(f"{name} since the earlier result", f"RMS error at most {OF_NOTHING} times that from nothing",
               f"from nothing {_describe(nothing)}; from {told}", holds)


def _describe(measured: Measured) -> str:
    return f"{measured.rms:.4f} px" if measured.converged else f"not converged ({measured.refusal[:60]})"


def _start_from_table(pair: Pair, mesh: ddic.Mesh, deformation: Deformation) -> Measured:
    random = np.random.default_rng(0)
    low, high = (SIDE - REGION) / 2, (SIDE + REGION) / 2
    points = random.uniform(low, high, (N_POINTS, 2))
    moved = deformation.displacement(points) + WRONG_PX * random.standard_normal(points.shape)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "points.csv"
        np.savetxt(path, np.hstack([points, moved]), delimiter=",", header="x,y,u,v", comments="")
        return measure_deformed(pair, mesh, deformation, _choose_start("from_points", path))


def _start_from_pairs(pair: Pair, mesh: ddic.Mesh, deformation: Deformation) -> Measured:
    middle, reach = SIDE / 2, 0.4 * REGION
    points = middle + reach * np.array([[-1.0, -0.9], [1.0, -0.8], [0.1, 1.0]])
    pairs = np.rint(np.hstack([points, points + deformation.displacement(points)]))
    return measure_deformed(pair, mesh, deformation, _choose_start("points", pairs))


def _choose_start(key: str, value: Any) -> dict[str, Any]:
    return {"start": {key: value}}


def _restart(pair: Pair, mesh: ddic.Mesh, earlier: ddic.Result) -> Row:
    again = ddic.measure(pair, mesh, start=earlier)
    off = float(np.abs(again.displacement - earlier.displacement).max())
    n_iterations = len(again.gauss_newton["iteration"])
    return Row("the frame itself, restarted from its own result",
               f"1 iteration, no node off by more than {SAME_PX:g} px", f"{n_iterations} iterations, {off:.1e} px",
               n_iterations == 1 and off <= SAME_PX)


def _measure_repeated() -> Row:
    """A texture that looks alike at every period: only one of the translations is right."""
    y, x = np.mgrid[0:500, 0:500]
    number = 2 * np.pi / PERIOD
    reference, deformed = (np.rint(127 + 100 * np.sin(number * (x - shift)) * np.sin(number * y)).astype(np.uint8)
                           for shift in (0.0, REPEATED_SHIFT))
    truth = make_linear(np.zeros((2, 2)), np.zeros(2), np.array([REPEATED_SHIFT, 0.0]))
    mesh = ddic.structured_mesh((150, 150, 350, 350), 20)
    nothing = measure_deformed((reference, deformed), mesh, truth)
    given = measure_deformed((reference, deformed), mesh, truth, _choose_start("points", [[250, 250, 292, 251]]))
    return Row(f"a texture of period {PERIOD} px shifted by {REPEATED_SHIFT:g} px, from one pair that is wrong by 1 px",
               "no node off by more than 0.1 px",
               f"largest error {given.largest:.3f} px; from nothing {nothing.largest:.1f} px",
               given.converged and given.largest <= 0.1)


CHECKS: dict[str, Callable[[Scale], list[Row]]] = {"initial_fields": measure_initial_fields}
