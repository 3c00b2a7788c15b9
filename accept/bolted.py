"""Two plates of a bolted assembly slide by 7.5 px: what levels and enrichment are worth [RHR08, section 6.1]."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

import ddic
from accept.support.opened_pair import find_field_error, mesh_inside, render, straight_line
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.start.binned_pair import choose_block_sizes

SLIP = 7.5
"""Of one plate along the other, which does not move, pixels."""

SIZE, SMOKE_SIZE, ELEMENT = 2048, 256, 32
"""Sides of the images and elements, pixels."""

SPECKLE = 1.0
"""The reference speckle, which a start 7.5 px away does not find."""

MOST_ITERATIONS = 500
"""Enough for continuous elements to converge, slowly."""

REPEATS, SMOKE_REPEATS = 5, 1
"""Measurements with each basis, alternated; medians are compared."""


def measure_bolted(scale: Scale) -> list[Row]:
    """Measure a large slip on one level, on all levels, and with continuous elements.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image.

    Returns
    -------
    list of Row
        Convergence, and work beside that of continuous elements.
    """
    size = SMOKE_SIZE if scale.smoke else SIZE
    opened = straight_line(size, SLIP)
    # The plate to the right of the line rests.
    opened = dataclasses.replace(opened, offset=opened.jumps[0] / 2)
    pair = render(opened, size, speckle=SPECKLE)
    mesh = mesh_inside(size, ELEMENT)
    # Cells that start too far off would else be excluded, and found again from their neighbours: all converge then.
    all_pixels: dict[str, Any] = {**MONOLITHIC, "correlation": {"spoilt_pixels": "keep"}}
    enriched: dict[str, Any] = {**all_pixels, "discontinuity": opened.sections("tangential")}
    one_level = {**enriched, "start": {"rigid": False, "pyramid": False}}
    continuous: dict[str, Any] = {**all_pixels, "gauss_newton": {"max_iterations": MOST_ITERATIONS}}
    alone = _describe_one_level(pair, mesh, one_level)
    runs: dict[str, list[tuple[int, float]]] = {"enriched": [], "continuous": []}
    for _ in range(SMOKE_REPEATS if scale.smoke else REPEATS):
        for name, options in (("enriched", enriched), ("continuous", continuous)):
            begin = time.process_time()
            result = ddic.measure(pair, mesh, options=options)
            runs[name].append((len(result.gauss_newton["iteration"]), time.process_time() - begin))
            if name == "enriched":
                error = find_field_error(result, opened)
    (n_enriched, s_enriched), (n_continuous, s_continuous) = (np.median(runs[name], axis=0) for name in runs)
    append_result("xdic_runs", {"check": "bolted", "runs": runs, "error": error, "one_level": alone})
    n_levels = len(choose_block_sizes(size**2, mesh)) + 1
    what = f"two plates of {size} x {size} px slide by {SLIP} px, {ELEMENT}-px elements"
    return [Row(f"{what}: one level alone, and {n_levels} levels with enrichment (default); "
                f"{describe_settings(all_pixels)}",
                "one does not converge, all do",
                f"one: {alone or 'converges'}; {n_levels}: {n_enriched:.0f} iterations, RMS error {error:.1e} px",
                bool(alone)),
            Row(f"{what}: iterations on the finest level and CPU time, enriched beside continuous elements",
                "fewer, and less",
                f"{n_enriched:.0f} beside {n_continuous:.0f} iterations; {s_continuous / s_enriched:.2f} times less "
                "time (the paper's: 2.36)", bool(n_enriched < n_continuous and s_enriched < s_continuous),
                judged_small=False)]


def _describe_one_level(pair: tuple[Any, Any], mesh: ddic.Mesh, options: Mapping[str, Any]) -> str:
    """How a measurement fails; empty where it does not."""
    try:
        ddic.measure(pair, mesh, options=options)
    except (ConvergenceError, SingularSubdomainError) as error:
        return str(error).split(";")[0]
    return ""
