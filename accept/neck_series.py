"""A neck that grows over 60 frames, measured with every frame, every second and every fifth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import ddic
from accept.large_motions import NECK_HEIGHT, SIDE, make_neck
from accept.support.deformed_pair import Camera, render_deformed
from accept.table import Scale
from bench.support.rows import Row

N_FRAMES, NECK_WIDTH = 60, 140.0
STRIDES = (1, 2, 5)
RIGHT_PX = 0.5
"""Largest error of a node in the last frame, pixels; noise of 2 grey levels leaves 0.1 px at a corner."""


def measure_neck_series(scale: Scale) -> list[Row]:
    """Measure a series, each frame from the one before.

    Parameters
    ----------
    scale : Scale
        A smoke run takes two frames.

    Returns
    -------
    list of Row
        By stride.
    """
    mesh = ddic.structured_mesh((100, 100, 300, 100 + NECK_HEIGHT), 12)
    camera = Camera((400, SIDE))
    numbers = range(30, 61, 30) if scale.smoke else range(1, N_FRAMES + 1)
    reference = render_deformed(make_neck(NECK_WIDTH, 0.0), camera)[0]
    frames = {n: render_deformed(make_neck(NECK_WIDTH, n / N_FRAMES), camera)[1] for n in numbers}
    rows = []
    for stride in STRIDES[-1:] if scale.smoke else STRIDES:
        chosen = [n for n in frames if n % stride == 0]
        n_iterations, told, holds = 0, "", False
        result: ddic.Result | None = None
        with ddic.prepare(reference, mesh) as session:
            for n in chosen:
                try:
                    result = session.measure(frames[n], start=result)
                except ddic.DdicError as error:
                    told = f"frame {n}: {str(error).splitlines()[0]}"
                    break
                n_iterations += len(result.gauss_newton["iteration"])
            if result is not None and not told:
                off = result.at(mesh.nodes) - make_neck(NECK_WIDTH, chosen[-1] / N_FRAMES).displacement(mesh.nodes)
                largest = float(np.linalg.norm(off, axis=1).max())
                holds = largest <= RIGHT_PX
                told = (f"frame {chosen[-1]} reached, {n_iterations / len(chosen):.1f} iterations a frame, RMS error "
                        f"{np.sqrt(np.mean(off**2)):.3f} px, largest {largest:.2f} px")
        rows.append(Row(f"neck of 20 % over {N_FRAMES} frames, each from the last, every {stride} measured",
                        f"reaches the last frame, no node off by more than {RIGHT_PX} px", told, holds))
    return rows


CHECKS: dict[str, Callable[[Scale], list[Row]]] = {"series": measure_neck_series}
