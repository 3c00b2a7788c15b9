"""A small region in a large image, which starts as in a small one."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.large_motions import GAUGE, NECK_HEIGHT, SIDE, make_neck
from accept.support.deformed_pair import Camera, Deformation, measure_deformed, render_deformed
from accept.table import Check, Scale
from bench.support.rows import Row

SIZE, SMOKE_SIZE = (6576, 4384), (2000, 2000)
"""Width and height of the large image, pixels."""

NECKS = (40.0, 140.0)
MOST_TIMES_ALONE = 1.01
"""Standard deviations of the necks, pixels, and the RMS error beside that in a small image: nothing but the start
differs, and where that is good enough Gauss-Newton forgets it."""


def measure_small_region(scale: Scale) -> list[Row]:
    """Measure the narrow gauge that necks where it is a part of a large image.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one neck, in an image of 4 megapixels.

    Returns
    -------
    list of Row
        One.
    """
    width, height = SMOKE_SIZE if scale.smoke else SIZE
    origin = np.array([width // 2, height // 3])
    gauge = np.array([100.0, 100.0, 300.0, 100.0 + NECK_HEIGHT])
    told, holds = [], True
    for neck in NECKS[:1] if scale.smoke else NECKS:
        deformation = make_neck(neck)
        pair = render_deformed(deformation, Camera((400, SIDE)))
        alone = measure_deformed(pair, ddic.structured_mesh(tuple(gauge), 12), deformation)
        large = tuple(_surround(image, (height, width), origin, seed) for seed, image in enumerate(pair))
        moved = Deformation(partial(_displace_from, deformation, origin))
        mesh = ddic.structured_mesh(tuple(gauge + np.tile(origin, 2)), 12)
        found = measure_deformed((large[0], large[1]), mesh, moved)
        holds &= found.converged and found.rms <= MOST_TIMES_ALONE * alone.rms
        told.append(f"neck of {neck:g} px: " + (f"{found.rms:.4f} px ({alone.rms:.4f} px in an image of its own)"
                                                if found.converged else f"not converged: {found.refusal}"))
    return [Row(f"a gauge of {GAUGE[0]} x {GAUGE[1]} px with a neck of 20 % in an image of {width} x {height} px",
                f"converges, RMS error at most {MOST_TIMES_ALONE:g} times that in an image of its own", "; ".join(told),
                holds)]


def _surround(image: NDArray[Any], shape: tuple[int, int], origin: NDArray[np.int64], seed: int) -> NDArray[np.uint8]:
    """A large image of noise, with another one in it."""
    large = np.random.default_rng(seed).integers(58, 63, shape, dtype=np.uint8)
    large[origin[1]:origin[1] + image.shape[0], origin[0]:origin[0] + image.shape[1]] = image
    return large


def _displace_from(deformation: Deformation, origin: NDArray[np.int64], points: NDArray[np.float64],
                   ) -> NDArray[np.float64]:
    return deformation.displacement(points - origin)


CHECKS: dict[str, Check] = {"small_region": measure_small_region}
