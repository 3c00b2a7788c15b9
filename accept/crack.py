"""The tip and the stress intensity factor of a crack, and the field about it, with and without noise."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.cracked_pair import Crack, render_crack
from accept.support.opened_pair import mesh_inside
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result

SIZE, SMOKE_SIZE, ELEMENT = 1024, 400, 16
"""Sides of the images and of the elements, pixels."""

BEYOND = 30.0
"""Pixels by which the line that is given goes on ahead of the tip."""

NEAR_TIP, BESIDE = 32.0, 2.5
"""Pixels from the tip within which its field is judged, and from the crack beyond which."""

TIMES_LESS = 2.0
"""Error about the tip without tip functions over that with them."""

TIP_PX, FACTOR = 1.0, 0.02
"""Farthest that the tip may be from its place, and relative error of K_I."""


def measure_crack(scale: Scale) -> list[Row]:
    """Measure an inclined crack in mode I whose line is known and whose tip is not.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image.

    Returns
    -------
    list of Row
        Without noise, and with noise of 2 grey levels: the tip, and the field about it with tip functions.
    """
    size = SMOKE_SIZE if scale.smoke else SIZE
    crack = Crack(tip=np.array([size / 2 - 11.7, size / 2 + 8.7]))
    line = [crack.tip - 2 * size * crack.along, crack.tip + BEYOND * crack.along]
    options = {**MONOLITHIC, "discontinuity": [{"vertices": [vertex.tolist() for vertex in line]}]}
    rows = []
    for noise in (0.0, 2.0):
        pair = render_crack(crack, size, noise)
        result = ddic.measure(pair, mesh_inside(size, ELEMENT), options=options)
        found = ddic.find_crack_tip(result)
        away = float(np.linalg.norm(found.position - crack.tip))
        off = found.opening_factor / crack.opening_factor - 1
        append_result("xdic_runs", {"check": "crack", "noise": noise, "away_px": away, "factor_off": off,
                                    "sliding": found.sliding_factor / crack.opening_factor})
        rows.append(Row(f"mode I crack at {np.rad2deg(crack.angle):.0f} degrees, tip inside, {size} x {size} px, "
                        f"{ELEMENT}-px elements, {describe_settings(MONOLITHIC)}, noise of {noise:g} grey levels, the "
                        f"line goes on {BEYOND:g} px beyond the tip: tip, K_I", f"within {TIP_PX:g} px, {FACTOR:.0%}",
                        f"{away:.2f} px, {off:+.2%}; K_II {found.sliding_factor / crack.opening_factor:+.2%} of K_I",
                        away <= TIP_PX and abs(off) <= FACTOR))
        rows.append(_compare_tip_functions(crack, size, noise, pair))
    return rows


def _compare_tip_functions(crack: Crack, size: int, noise: float, pair: tuple[NDArray[Any], NDArray[Any]]) -> Row:
    """The field about the tip, measured with a line up to the tip with tip functions and without."""
    points = place_about_tip(crack)
    errors = {}
    for tip_functions in (False, True):
        line = {"vertices": [(crack.tip - 2 * size * crack.along).tolist(), crack.tip.tolist()],
                "tip_functions": tip_functions}
        result = ddic.measure(pair, mesh_inside(size, ELEMENT), options={**MONOLITHIC, "discontinuity": [line]})
        errors[tip_functions] = float(np.sqrt(np.mean((result.at(points) - crack.displacement(points)) ** 2)))
    append_result("xdic_runs", {"check": "crack", "noise": noise, "rms_near_tip_px": errors[True],
                                "rms_without_functions_px": errors[False]})
    return Row(f"the same, noise of {noise:g} grey levels, the line up to the tip: RMS error within {NEAR_TIP:g} px of "
               "the tip with tip functions, and without", f"{TIMES_LESS:g} times less with them",
               f"{errors[True]:.4f} px, {errors[False]:.4f} px", errors[False] >= TIMES_LESS * errors[True])


def place_about_tip(crack: Crack) -> NDArray[np.float64]:
    """Place random points within NEAR_TIP of the tip, beyond the band along the crack.

    Parameters
    ----------
    crack : Crack
        The crack.

    Returns
    -------
    (n, 2) array
        Pixels.
    """
    offsets = np.random.default_rng(0).uniform(-NEAR_TIP, NEAR_TIP, (8000, 2))
    height = offsets @ np.array([-crack.along[1], crack.along[0]])
    kept = (np.linalg.norm(offsets, axis=1) <= NEAR_TIP) & (np.abs(height) > BESIDE)
    return np.asarray(crack.tip + offsets[kept])
