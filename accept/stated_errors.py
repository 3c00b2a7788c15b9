"""Errors that a result states beside those it has: of white noise, repeated, of bias, light, blur, much noise."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import ddic
from accept.support.deformed_pair import Camera, Deformation, render_deformed
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from ddic.errors import ConvergenceError
from ddic.io.result_reader import Result

Array = NDArray[np.float64]
Image = NDArray[np.float32]

WHITE_SIDE, SMOKE_WHITE_SIDE = 512, 128
WHITE_MARGIN = 16
N_WHITE_REPETITIONS, SMOKE_WHITE_REPETITIONS = 200, 4
SIGMA = 2.0
"""Standard deviation of the noise of both images, grey levels."""

WAVELENGTH = 120.0
"""Cut-off wavelength of the regularized case, pixels."""

LARGEST_RMS, MOST_AT_NODE, LEAST_WITHIN, MOST_TIMES = 0.05, 0.15, 0.95, 10.0
N_ROUNDS = 3
"""Times that measurements with and without uncertainty are timed, in turn."""

WHITE_SETTINGS: dict[str, Mapping[str, Any]] = {
    "no regularization": MONOLITHIC,
    f"cut-off wavelength {WAVELENGTH:g} px": {**MONOLITHIC, "regularization": {"cut_off_wavelength": WAVELENGTH}},
}
DEVIATIONS = {"displacement": ("sigma_u", "sigma_v"), "strain": ("sigma_exx", "sigma_eyy", "sigma_exy")}


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
    """Measure noisy pairs over and over, and compare with what a single measurement says of its errors."""
    side = SMOKE_WHITE_SIDE if scale.smoke else WHITE_SIDE
    n_repetitions = SMOKE_WHITE_REPETITIONS if scale.smoke else N_WHITE_REPETITIONS
    clean = _render_clean(side)
    mesh = ddic.structured_mesh((WHITE_MARGIN, WHITE_MARGIN, side - WHITE_MARGIN, side - WHITE_MARGIN), ELEMENT)
    rows = []
    for name, settings in WHITE_SETTINGS.items():
        pair = _add_noise(clean, np.random.default_rng(1))
        found = ddic.measure(pair, mesh, **settings, output={"uncertainty": True})
        repeated = _find_scatter(clean, mesh, settings, n_repetitions)
        compared = {kind: _compare_deviations(found, names, repeated[kind]) for kind, names in DEVIATIONS.items()}
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


def _render_clean(side: int) -> tuple[Image, Image]:
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


def _find_scatter(clean: tuple[Image, Image], mesh: Any, settings: Mapping[str, Any], n: int) -> dict[str, Array]:
    """Standard deviations of n measurements, each of noise of its own, (n_nodes, 2 or 3)."""
    random = np.random.default_rng(2)
    displacements, strains = [], []
    for _ in range(n):
        result = ddic.measure(_add_noise(clean, random), mesh, **settings)
        displacements.append(result.displacement)
        strains.append(result.point_data["nodal_strain_infinitesimal"][:, [0, 1, 3]])
    return {"displacement": np.std(displacements, axis=0, ddof=1), "strain": np.std(strains, axis=0, ddof=1)}


def _compare_deviations(found: ddic.Result, names: tuple[str, ...], repeated: Array) -> Compared:
    sigma = np.stack([found.point_data[name] for name in names], axis=1)
    rms = float(np.sqrt((sigma**2).mean() / (repeated**2).mean())) - 1.0
    return Compared(rms, float((np.abs(sigma / repeated - 1.0) <= MOST_AT_NODE).mean()))


def _time(pair: tuple[Image, Image], mesh: Any, settings: Mapping[str, Any]) -> float:
    """CPU time of a measurement with uncertainty over that of one without, both the least of some."""
    seconds: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(N_ROUNDS):
        for asked, of_kind in seconds.items():
            begin = time.process_time()
            ddic.measure(pair, mesh, **settings, output={"uncertainty": asked})
            of_kind.append(time.process_time() - begin)
    return min(seconds[True]) / min(seconds[False])


Pair = tuple[Array, Array]
Spoil = Callable[[Pair, np.random.Generator], Pair]

SIDE, MARGIN, ELEMENT = 400, 20, 16
N_REPETITIONS, SMOKE_REPETITIONS = 100, 3
N_SEEDS = 5
"""Speckles and noises of the fields of which nodes are counted."""

LEAST_COVERED, MOST_COVERED = 0.90, 0.99
OF_SCATTER = 0.25
OF_NOISE, OF_MUCH_NOISE = 0.10, 0.20
MUCH_NOISE = 20.0
MOST_OUTSIDE, SIGMAS, FAR_PX = 0.01, 4.0, 0.3
"""Share of unmarked nodes that may be off by more than so many standard deviations, or pixels."""


@dataclass(frozen=True)
class Setting:
    """What is pictured and how it is measured.

    Attributes
    ----------
    name : str
        What a row calls it.
    move : callable
        From points (n, 2) to displacements (n, 2), pixels.
    noise : float
        Standard deviation of the noise of both images, grey levels of 256.
    options : mapping
        Sections of the case.
    spoil : callable, optional
        What happens to the pictures before noise and rounding; nothing by default.
    """

    name: str
    move: Callable[[Array], Array]
    noise: float
    options: Mapping[str, Any]
    spoil: Spoil | None = None


def _smooth(points: Array) -> Array:
    x, y = points.T
    return np.column_stack([0.4 + 0.3 * np.sin(x / 60) + 0.004 * y, -0.3 + 0.4 * np.cos(y / 80)])


def _wave(points: Array, length: float) -> Array:
    x, y = 2 * np.pi * points.T / length
    return np.column_stack([np.sin(x) * np.cos(y), np.cos((x + y) / 1.3)])


def _bend(points: Array) -> Array:
    x, y = points.T - SIDE / 2
    return np.column_stack([-2e-5 * 2 * x * y, 2e-5 * x**2])


def _neck(points: Array) -> Array:
    x, y = points.T - SIDE / 2
    across = -0.3 * y / 80 / np.cosh(x / 80) ** 2
    return np.column_stack([2.0 * np.tanh(x / 80), across])


def _translate(points: Array, by: float) -> Array:
    return np.broadcast_to([by, -0.7 * by], points.shape)


def _regularized(length: float) -> dict[str, Any]:
    return {**MONOLITHIC, "regularization": {"cut_off_wavelength": length}}


def _blur(pair: Pair, _: np.random.Generator) -> Pair:
    return pair[0], gaussian_filter(pair[1], 1.0)


def _light(pair: Pair, random: np.random.Generator) -> Pair:
    """Light that has moved on: 15 % brighter and darker over 150 to 190 px."""
    y, x = 2 * np.pi * np.mgrid[0:SIDE, 0:SIDE]
    along, across = random.uniform(0, 2 * np.pi, 2)
    return pair[0], pair[1] * (1.0 + 0.15 * np.sin(x / 150 + along) * np.cos(y / 190 + across))


def _dirt(pair: Pair, random: np.random.Generator) -> Pair:
    """Dark spots on the camera, of which 600 would lie on 1000 x 1000 px: they stay where they are."""
    f, g = pair[0].copy(), pair[1].copy()
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    for _ in range(round(600 * (SIDE / 1000) ** 2)):
        column, row = random.uniform(0, SIDE, 2)
        spot = (x - column) ** 2 + (y - row) ** 2 < random.uniform(1.0, 3.5) ** 2
        f[spot] = g[spot] = random.uniform(0, 60)
    return f, g


FIELDS = [
    *(Setting(f"{name}, l_c = {length} px", move, 2.0, _regularized(length)) for name, move, length in (
        ("waves of 400 px", partial(_wave, length=400.0), 60), ("waves of 400 px", partial(_wave, length=400.0), 120),
        ("waves of 300 px", partial(_wave, length=300.0), 80), ("smooth", _smooth, 120), ("bending", _bend, 120),
        ("a neck", _neck, 80))),
]
UNLIKE = [Setting("blur of 1 px", _smooth, 2.0, MONOLITHIC, _blur),
          Setting("moved light", _smooth, 2.0, MONOLITHIC, _light)]
NOISY = [Setting(f"noise of {noise:g} grey levels", _smooth, noise, MONOLITHIC) for noise in (5.0, 20.0, 40.0)]
DIRTY = [Setting(f"static dirt, {by:g} px", partial(_translate, by=by), 2.0, MONOLITHIC, _dirt)
         for by in (0.1, 0.4, 1.0)]


@dataclass(frozen=True, eq=False)
class Measured:
    """A field with what it states of its errors.

    Attributes
    ----------
    error, sigma, bias : (n_nodes, 2) array
        Pixels.
    doubtful : (n_nodes,) bool array
        Nodes of cells that are marked or left out.
    """

    error: Array
    sigma: Array
    bias: Array
    doubtful: NDArray[np.bool_]


def measure_two_sigma(scale: Scale) -> list[Row]:
    """Count the nodes whose error is within two of what noise and bias of regularization are stated to be together."""
    settings, n_seeds = (FIELDS[:1], 1) if scale.smoke else (FIELDS, N_SEEDS)
    rows = []
    for setting in settings:
        measured = _repeat(setting, n_seeds, scale.jobs)
        covered = float(np.mean([np.abs(m.error) <= 2.0 * np.hypot(m.sigma, m.bias) for m in measured]))
        append_result("stated_errors", {"setting": setting.name, "covered": covered})
        rows.append(Row(
            f"{_picture(setting)}, noise of {setting.noise:g} grey levels, {n_seeds} speckles: nodes within "
            "2 sqrt(sigma^2 + bias^2)",
            f"{100 * LEAST_COVERED:.0f} to {100 * MOST_COVERED:.0f} %",
            f"{100 * covered:.1f} %; RMS error {_rms(measured, 'error'):.3f} px, stated bias "
            f"{_rms(measured, 'bias'):.3f} px, sigma {_rms(measured, 'sigma'):.4f} px",
            LEAST_COVERED <= covered <= MOST_COVERED))
    return rows


def measure_unlike(scale: Scale) -> list[Row]:
    """Compare stated standard deviations with the scatter of repetitions, where residuals are not white."""
    n = SMOKE_REPETITIONS if scale.smoke else N_REPETITIONS
    rows = []
    for setting in UNLIKE[:1] if scale.smoke else UNLIKE:
        measured = _repeat(setting, n, scale.jobs)
        ratio = _rms(measured, "sigma") / _scatter(measured)
        covered = float(np.mean([np.abs(m.error) <= 2.0 * m.sigma for m in measured]))
        rows.append(Row(
            f"{_picture(setting)}, noise of {setting.noise:g} grey levels: sigma beside the scatter of {n} speckles, "
            "noises and lights",
            f"within {100 * OF_SCATTER:.0f} %; {100 * LEAST_COVERED:.0f} to {100 * MOST_COVERED:.0f} % of the nodes "
            "within two sigma",
            f"{100 * (ratio - 1):+.1f} %; {100 * covered:.1f} %",
            abs(ratio - 1) <= OF_SCATTER and LEAST_COVERED <= covered <= MOST_COVERED, judged_small=False))
    return rows


def measure_noise(scale: Scale) -> list[Row]:
    """Compare stated errors with true ones in much noise, clipped at both ends, and with dirt on the camera."""
    n = SMOKE_REPETITIONS if scale.smoke else N_REPETITIONS
    rows = []
    for setting in NOISY[:1] if scale.smoke else NOISY:
        measured = _repeat(setting, n, scale.jobs)
        refused = f"; {n - len(measured)} refused" if len(measured) < n else ""
        ratio, bound = _rms(measured, "sigma") / _scatter(measured), _bound(setting.noise)
        told, holds = _judge_unmarked(measured)
        rows.append(Row(f"{_picture(setting)}: sigma beside the scatter of {n} repetitions; unmarked nodes more than "
                        f"{SIGMAS:g} sigma or {FAR_PX} px off",
                        f"within {100 * bound:.0f} %; at most {100 * MOST_OUTSIDE:.0f} %",
                        f"{100 * (ratio - 1):+.1f} %; {told}{refused}", abs(ratio - 1) <= bound and holds,
                        judged_small=False))
    for setting in DIRTY[:1] if scale.smoke else DIRTY:
        told, holds = _judge_unmarked(_repeat(setting, 1 if scale.smoke else N_SEEDS, scale.jobs))
        rows.append(Row(f"{_picture(setting)}: unmarked nodes more than {SIGMAS:g} sigma or {FAR_PX} px off",
                        f"at most {100 * MOST_OUTSIDE:.0f} %", told, holds, judged_small=False))
    return rows


def _picture(setting: Setting) -> str:
    return (f"{SIDE} x {SIDE} px, Q4 of {ELEMENT} px, 8 bit, {setting.name}, {describe_settings(MONOLITHIC)}")


def _bound(noise: float) -> float:
    return OF_MUCH_NOISE if noise >= MUCH_NOISE else OF_NOISE


def _judge_unmarked(measured: Sequence[Measured]) -> tuple[str, bool]:
    """What is said of nodes that are not marked, and whether few enough are far off."""
    outside = [((np.abs(m.error) > SIGMAS * m.sigma) | (np.abs(m.error) > FAR_PX)).any(axis=1)[~m.doubtful]
               for m in measured]
    marked = np.mean([m.doubtful for m in measured])
    share = float(np.concatenate(outside).mean()) if marked < 1.0 else 0.0
    largest = max(np.abs(m.error[~m.doubtful]).max(initial=0.0) for m in measured)
    return (f"{100 * share:.2f} % (largest error {largest:.2f} px; {100 * marked:.1f} % marked)", share <= MOST_OUTSIDE)


def _repeat(setting: Setting, n: int, n_jobs: int) -> list[Measured]:
    """As many fields, but for those that are refused: no number is wrong there."""
    with ProcessPoolExecutor(n_jobs) as pool:
        return [found for found in pool.map(partial(_measure, setting), range(n)) if found is not None]


def _measure(setting: Setting, seed: int) -> Measured | None:
    """A field of other speckles and noise by seed; None where it is refused."""
    f, g = (image / 257.0 for image in render_deformed(
        Deformation(setting.move), Camera((SIDE, SIDE), noise=0.0, bits=16, seed=100 + seed)))
    random = np.random.default_rng(seed)
    if setting.spoil is not None:
        f, g = setting.spoil((f, g), random)
    pair = [np.clip(np.rint(image + setting.noise * random.standard_normal(image.shape)), 0, 255).astype(np.uint8)
            for image in (f, g)]
    mesh = ddic.structured_mesh((MARGIN, MARGIN, SIDE - MARGIN, SIDE - MARGIN), ELEMENT)
    try:
        found = ddic.measure(pair, mesh, **setting.options, output={"uncertainty": True})
    except ConvergenceError:
        return None
    error = found.displacement - setting.move(found.mesh.nodes)
    sigma = np.column_stack([found.point_data["sigma_u"], found.point_data["sigma_v"]])
    bias = np.asarray(found.point_data.get("regularization_bias", np.zeros_like(error)))[:, :2]
    return Measured(error, sigma, bias, _find_doubtful(found))


def _find_doubtful(found: Result) -> NDArray[np.bool_]:
    """Nodes of cells that are marked doubtful or excluded."""
    is_doubtful = np.asarray(found.cell_data["doubtful"], dtype=bool)
    nodes = np.zeros(found.mesh.n_nodes, dtype=bool)
    nodes[found.mesh.connectivity[np.repeat(is_doubtful, np.diff(found.mesh.offsets))]] = True
    return nodes


def _rms(measured: Sequence[Measured], name: str) -> float:
    return math.sqrt(np.mean([getattr(m, name) ** 2 for m in measured]))


def _scatter(measured: Sequence[Measured]) -> float:
    """RMS over nodes of the standard deviation of the repetitions' errors, pixels."""
    return math.sqrt(np.var([m.error for m in measured], axis=0, ddof=1).mean())
