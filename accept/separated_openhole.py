"""PGD-DIC beside Q4-DIC on a real pair: the open-hole tension test, below the hole."""

from __future__ import annotations

import numpy as np

import ddic
from accept.support.separated_pair import list_pixels
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import real_data

REGION = (580.0, 720.0, 820.0, 976.0)
"""Below the hole, inside the strip, pixels."""

SIZES, SMOKE_SIZES = (16, 8), (16,)
"""Sides of the elements, pixels."""

MOST, PAPER = 2e-3, (0.9e-3, 1.2e-3)
"""Difference in the whole vector's norm, and the paper's two."""

DEFAULTS_JUDGED_AT = 16
"""Elements, pixels, at which the default settings are judged too. On smaller ones they leave out more of Q4-DIC's noise
than the bound."""


def measure_separated_openhole(scale: Scale) -> list[Row]:
    """Measure frames 53 -> 70 by both methods.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one size of elements.

    Returns
    -------
    list of Row
        One for each size.
    """
    folder = real_data() / "openhole"
    pair = (folder / "zoom-0053_1.tif", folder / "zoom-0070_1.tif")
    points, rows = list_pixels(REGION), []
    for size in SMOKE_SIZES if scale.smoke else SIZES:
        mesh = ddic.structured_mesh(REGION, size)
        q4 = ddic.measure(pair, mesh, options={"solver": {"method": "assembled"}})
        known, differences, counts = q4.at(points), {}, {}
        for name, pgd in (("default", {}), ("published", {"update": False, "stop_at_noise": False}),
                          ("no stop at noise", {"stop_at_noise": False})):
            result = ddic.measure(pair, mesh, options={"pgd": pgd})
            differences[name] = float(np.linalg.norm(result.at(points) - known) / np.linalg.norm(known))
            counts[name] = len(result.corrections["correction"])
        append_result("pgd_runs", {"check": "openhole", "size": size, "differences": differences, "counts": counts})
        listed = "; ".join(f"{name} {100 * one:.3f} % after {counts[name]} corrections"
                           for name, one in differences.items())
        judged = ("published", "default") if size == DEFAULTS_JUDGED_AT else ("published",)
        rows.append(Row(f"openhole 53 -> 70, a rectangle below the hole, {size}-px elements: difference to Q4-DIC in "
                        f"the whole vector's norm, {' and '.join(judged)}",
                        f"<= {100 * MOST:g} %; the paper's {100 * PAPER[0]:.2f} and {100 * PAPER[1]:.2f} %",
                        listed, all(differences[name] <= MOST for name in judged)))
    return rows
