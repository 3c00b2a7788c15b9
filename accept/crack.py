"""The tip and the stress intensity factor of a crack, from its exact field with and without noise."""

from __future__ import annotations

import numpy as np

import ddic
from accept.support.cracked_pair import Crack, render_crack
from accept.support.opened_pair import mesh_inside
from accept.table import Scale
from bench.support.rows import Row, append_result

SIZE, SMOKE_SIZE, ELEMENT = 1024, 400, 16
"""Sides of the images and of the elements, pixels."""

BEYOND = 30.0
"""Pixels by which the line that is given goes on ahead of the tip."""

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
        Without noise, and with noise of 2 grey levels.
    """
    size = SMOKE_SIZE if scale.smoke else SIZE
    crack = Crack(tip=np.array([size / 2 - 11.7, size / 2 + 8.7]))
    line = [crack.tip - 2 * size * crack.along, crack.tip + BEYOND * crack.along]
    options = {"discontinuity": [{"vertices": [vertex.tolist() for vertex in line]}]}
    rows = []
    for noise in (0.0, 2.0):
        result = ddic.measure(render_crack(crack, size, noise), mesh_inside(size, ELEMENT), options=options)
        found = ddic.find_crack_tip(result)
        away = float(np.linalg.norm(found.position - crack.tip))
        off = found.opening_factor / crack.opening_factor - 1
        append_result("xdic_runs", {"check": "crack", "noise": noise, "away_px": away, "factor_off": off,
                                    "sliding": found.sliding_factor / crack.opening_factor})
        rows.append(Row(f"mode I crack at {np.rad2deg(crack.angle):.0f} degrees, tip inside, {size} x {size} px, "
                        f"{ELEMENT}-px elements, noise of {noise:g} grey levels, the line goes on {BEYOND:g} px beyond "
                        "the tip: tip, K_I", f"within {TIP_PX:g} px, {FACTOR:.0%}",
                        f"{away:.2f} px, {off:+.2%}; K_II {found.sliding_factor / crack.opening_factor:+.2%} of K_I",
                        away <= TIP_PX and abs(off) <= FACTOR))
    return rows
