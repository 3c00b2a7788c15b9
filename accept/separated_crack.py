"""Corrections that PGD-DIC takes on the field of an inclined crack, with and without the update step."""

from __future__ import annotations

from typing import Any

import numpy as np

import ddic
from accept.first_example import PUBLISHED, count_to_eta, measure_pgd
from accept.support.cracked_pair import Crack
from accept.support.separated_pair import REGION, SIZE, list_pixels, measure_rms, render
from accept.table import Scale
from bench.support.rows import Row, append_result

ELEMENT, SMOKE_ELEMENT = 8, 16
"""Side of the elements, pixels."""

PAPER, PAPER_Q4 = 81, 25
"""Corrections of [PP12], and its iterations of Q4-DIC."""

RUNS: dict[str, dict[str, Any]] = {
    "published": {**PUBLISHED, "max_corrections": 400},
    "with update": {**PUBLISHED, "update": True},
    "default": {},
}


def measure_separated_crack(scale: Scale) -> list[Row]:
    """Measure an inclined crack in mode I, its line not known.

    Parameters
    ----------
    scale : Scale
        A smoke run takes larger elements and the defaults alone.

    Returns
    -------
    list of Row
        One row.
    """
    element = SMOKE_ELEMENT if scale.smoke else ELEMENT
    crack = Crack(tip=np.array([250.3, 250.7]))
    pair, points = render(crack, "float", SIZE), list_pixels()
    known = crack.displacement(points)
    found = {}
    for name, pgd in list(RUNS.items())[-1:] if scale.smoke else RUNS.items():
        result = measure_pgd(pair, element, pgd)
        error = measure_rms(result.at(points) - known)
        found[name] = (len(result.corrections["correction"]), count_to_eta(result), error)
    q4 = ddic.measure(pair, ddic.structured_mesh(REGION, element),
                      options={"solver": {"method": "assembled"}, "start": {"pyramid": False}})
    n_q4, error_q4 = len(q4.gauss_newton["iteration"]), measure_rms(q4.at(points) - known)
    append_result("pgd_runs", {"check": "crack", **found, "q4": [n_q4, error_q4]})
    listed = "; ".join(f"{name}: {n} corrections ({eta} to eta < 1e-3), error {error:.4f} px"
                       for name, (n, eta, error) in found.items())
    return [Row(f"mode I crack at {np.rad2deg(crack.angle):.0f} degrees across the region, {element}-px elements, "
                "float images, from a rigid translation", f"converges; the paper needs {PAPER} corrections (Q4-DIC "
                f"{PAPER_Q4})", f"{listed}; Q4-DIC {n_q4} iterations, {error_q4:.4f} px", True)]
