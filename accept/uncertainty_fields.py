"""Standard deviations in a result against those of 200 repetitions, and what they take beside the measurement."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.deformed_pair import Camera, Deformation, render_deformed
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SIDE, SMOKE_SIDE = 512, 128
ELEMENT, MARGIN = 16, 16
N_REPETITIONS, SMOKE_REPETITIONS = 200, 4
SIGMA = 2.0
"""Standard deviation of the noise of both images, grey levels."""

WAVELENGTH = 120.0
"""Cut-off wavelength of the regularized case, pixels."""

LARGEST_RMS, MOST_AT_NODE, LEAST_WITHIN, MOST_TIMES = 0.05, 0.15, 0.95, 10.0
N_ROUNDS = 3
"""Times that measurements with and without uncertainty are timed, in turn."""

SETTINGS: dict[str, Mapping[str, Any]] = {
    "no regularization": MONOLITHIC,
    f"cut-off wavelength {WAVELENGTH:g} px": {**MONOLITHIC, "regularization": {"cut_off_wavelength": WAVELENGTH}},
}
FIELDS = {"displacement": ("sigma_u", "sigma_v"), "strain": ("sigma_exx", "sigma_eyy", "sigma_exy")}


@dataclass(frozen=True)
class Compared:
    """A field of standard deviations beside that of repetitions.

    Attributes
    ----------
    rms : float
        Its RMS over that of repetitions, less 1.
    within : float
        Share of the nodes' components that differ by MOST_AT_NODE at most.
    """

    rms: float
    within: float

    def __str__(self) -> str:
        return f"RMS {100 * self.rms:+.1f} %, {100 * self.within:.1f} % of the values within {100 * MOST_AT_NODE:.0f} %"


def measure_uncertainty(scale: Scale) -> list[Row]:
    """Measure noisy pairs over and over, and compare with what a single measurement says of its errors.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small pair a few times.

    Returns
    -------
    list of Row
        For each setting one of the fields and one of time.
    """
    side, n_repetitions = (SMOKE_SIDE, SMOKE_REPETITIONS) if scale.smoke else (SIDE, N_REPETITIONS)
    clean = _render(side)
    mesh = ddic.structured_mesh((MARGIN, MARGIN, side - MARGIN, side - MARGIN), ELEMENT)
    rows = []
    for name, settings in SETTINGS.items():
        pair = _add_noise(clean, np.random.default_rng(1))
        found = ddic.measure(pair, mesh, options={**settings, "output": {"uncertainty": True}})
        repeated = _repeat(clean, mesh, settings, n_repetitions)
        compared = {kind: _compare(found, names, repeated[kind]) for kind, names in FIELDS.items()}
        times = _time(pair, mesh, settings)
        noise = found.attributes["uncertainty"]["noise_grey"]
        append_result("uncertainty", {"setting": name, "times": times, "noise": noise,
                                      **{kind: vars(of_kind) for kind, of_kind in compared.items()}})
        holds = all(abs(c.rms) <= LARGEST_RMS and c.within >= LEAST_WITHIN for c in compared.values())
        rows.append(Row(f"{side} x {side} px, Q4 of {ELEMENT} px, noise of {SIGMA:g} grey levels, {name}, "
                        f"{describe_settings(MONOLITHIC)}: fields of standard deviations against {n_repetitions} "
                        "repetitions",
                        f"RMS within {100 * LARGEST_RMS:.0f} %, {100 * LEAST_WITHIN:.0f} % within "
                        f"{100 * MOST_AT_NODE:.0f} %",
                        "; ".join(f"{kind}: {of_kind}" for kind, of_kind in compared.items()), holds,
                        judged_small=False))
        rows.append(Row(f"the same pair, {name}: CPU time with uncertainty over that without",
                        f"<= {MOST_TIMES:g} times the measurement", f"{times:.1f}", times <= MOST_TIMES,
                        judged_small=False))
    return rows


def _render(side: int) -> tuple[Image, Image]:
    """A pair without noise whose shifts take all parts of a pixel."""

    def move(points: Array) -> Array:
        x, y = points.T
        return np.column_stack([0.4 + 0.3 * np.sin(x / 60) + 0.004 * y, -0.3 + 0.4 * np.cos(y / 80)])

    f, g = render_deformed(Deformation(move), Camera((side, side), noise=0.0, bits=16))
    # 16 bits, in grey levels of 8.
    return (f / 257.0).astype(np.float32), (g / 257.0).astype(np.float32)


def _add_noise(clean: tuple[Image, Image], random: np.random.Generator) -> tuple[Image, Image]:
    f, g = (image + (SIGMA * random.standard_normal(image.shape)).astype(np.float32) for image in clean)
    return f, g


def _repeat(clean: tuple[Image, Image], mesh: Any, settings: Mapping[str, Any], n: int) -> dict[str, Array]:
    """Standard deviations of n measurements, each of noise of its own, (n_nodes, 2 or 3)."""
    random = np.random.default_rng(2)
    displacements, strains = [], []
    for _ in range(n):
        result = ddic.measure(_add_noise(clean, random), mesh, options=settings)
        displacements.append(result.displacement)
        strains.append(result.point_data["nodal_strain_infinitesimal"][:, [0, 1, 3]])
    return {"displacement": np.std(displacements, axis=0, ddof=1), "strain": np.std(strains, axis=0, ddof=1)}


def _compare(found: ddic.Result, names: tuple[str, ...], repeated: Array) -> Compared:
    sigma = np.stack([found.point_data[name] for name in names], axis=1)
    rms = float(np.sqrt((sigma**2).mean() / (repeated**2).mean())) - 1.0
    return Compared(rms, float((np.abs(sigma / repeated - 1.0) <= MOST_AT_NODE).mean()))


def _time(pair: tuple[Image, Image], mesh: Any, settings: Mapping[str, Any]) -> float:
    """CPU time of a measurement with uncertainty over that of one without, both the least of some."""
    seconds: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(N_ROUNDS):
        for asked, of_kind in seconds.items():
            begin = time.process_time()
            ddic.measure(pair, mesh, options={**settings, "output": {"uncertainty": asked}})
            of_kind.append(time.process_time() - begin)
    return min(seconds[True]) / min(seconds[False])
