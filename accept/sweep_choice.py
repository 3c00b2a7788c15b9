"""What ``ddic sweep`` recommends on exact fields, beside the best that it tried."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy.special import erf

import ddic
from accept.table import Scale
from bench.support.rows import Row, append_result
from ddic.synth.fields import Kirsch, Sinusoidal

Array = NDArray[np.float64]
Displacement = Callable[[Array], Array]

SIDE, SMOKE_SIDE, MARGIN = 576, 192, 32
"""Side of the images and edge without elements, pixels."""

NOISES = (1.0, 4.0)
"""Standard deviation of the noise of both images, grey levels."""

ELEMENTS = (6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""Sizes that are swept, pixels: from fewer pixels than a speckle has to the smallest period of the star and more."""

LENGTHS = (0.0, 23.0, 32.0, 45.0, 64.0, 91.0, 128.0, 181.0, 256.0, 362.0, 512.0)
"""Cut-off wavelengths, sqrt 2 apart up to the width of the region, and none."""

OWN = (16.0, 64.0)
"""Element size and cut-off wavelength of the case, from which the recommendation must not depend."""

BOUND = 1.25
"""Error of the recommended settings over the least of the sweep."""

LEAST_MEASURED = 0.95
"""Share of the places at which settings must measure to count as the best."""


def measure_sweep(scale: Scale) -> list[Row]:
    """Sweep images of four exact fields with two levels of noise.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one field on a small image, and few settings.

    Returns
    -------
    list of Row
        One for each field and noise.
    """
    side = SMOKE_SIDE if scale.smoke else SIDE
    fields = _make_fields(side)
    if scale.smoke:
        return [_measure_case("star", fields["star"], NOISES[-1], side, scale)]
    return [_measure_case(name, field, noise, side, scale) for name, field in fields.items() for noise in NOISES]


def _make_fields(side: int) -> dict[str, Displacement]:
    """Displacements by name; the plate's hole lies in the middle."""
    middle = (side - 1) / 2
    return {
        "reference field": Sinusoidal().displacement,
        "Kirsch": Kirsch((middle, middle), side / 10, 0.01).displacement,
        "Gaussian neck": lambda points: _neck(points, middle, 0.045 * side),
        "star": lambda points: _star(points, side),
    }


def _neck(points: Array, middle: float, width: float) -> Array:
    """A strain of 0.2 % and a Gaussian neck of 2 % along y, narrower by half of it along x."""
    x, y = (points - middle).T
    strain = 0.002 + 0.02 * np.exp(-(y**2) / (2 * width**2))
    along = 0.002 * y + 0.02 * width * np.sqrt(np.pi / 2) * erf(y / (np.sqrt(2) * width))
    return np.stack([-0.5 * strain * x, along], axis=1)


def _star(points: Array, side: int) -> Array:
    """Half a pixel along y in waves along y, whose period grows from 20 to 300 px over the region's width."""
    x, y = points.T
    share = np.clip((x - MARGIN) / (side - 2 * MARGIN), 0.0, 1.0)
    wave = 0.5 * np.cos(2 * np.pi * (y - (side - 1) / 2) / (20.0 + 280.0 * share))
    return np.stack([np.zeros_like(wave), wave], axis=1)


def _measure_case(name: str, displacement: Displacement, noise: float, side: int, scale: Scale) -> Row:
    """Sweep one pair and compare every setting with the truth, which the sweep does not know."""
    folder = scale.folder("sweep") / f"{name.replace(' ', '_')}_{noise:g}"
    case = _write_case(name, displacement, noise, side, folder)
    begin = time.process_time()
    small = {"element_sizes": (12.0, 16.0), "wavelengths": (0.0, 64.0)}
    swept = {"element_sizes": ELEMENTS, "wavelengths": LENGTHS}
    sweep = ddic.choose_regularization(case, **(small if scale.smoke else swept))
    seconds = time.process_time() - begin
    truth = displacement(sweep.points)
    errors = np.array([_rms(trial.displacement - truth) for trial in sweep.trials])
    best = int(np.nanargmin(errors))
    predicted = int(np.nanargmin([trial.predicted_error for trial in sweep.trials]))
    ratio = errors[sweep.recommended] / errors[best]
    least = sweep.trials[best].candidate
    measured = (f"{sweep.best.candidate.describe()}: {errors[sweep.recommended]:.5f} px (virtual images: "
                f"{sweep.best.virtual_error:.5f} px); best of {len(errors)}: {least.describe()}: "
                f"{errors[best]:.5f} px; ratio {ratio:.3f} (of the least that the residual predicts "
                f"{errors[predicted] / errors[best]:.3f}); {seconds:.0f} s")
    append_result("sweep_runs", {"field": name, "noise": noise, "trials": [
        {"element_size": trial.candidate.element_size, "wavelength": trial.candidate.wavelength, "error_px": error,
         "virtual_error_px": trial.virtual_error, "predicted_error_px": trial.predicted_error,
         "failure": trial.failure} for trial, error in zip(sweep.trials, errors.tolist(), strict=True)]})
    return Row(f"sweep, {name}, {side} x {side} px, noise {noise:g} grey levels: error of the recommended settings",
               f"<= {BOUND} times the least of the sweep", measured, bool(ratio <= BOUND))


def _rms(error: Array) -> float:
    """RMS of a component, pixels; nan where too little was measured."""
    is_measured = np.isfinite(error).all(axis=1)
    return float(np.sqrt((error[is_measured] ** 2).mean())) if is_measured.mean() >= LEAST_MEASURED else float("nan")


def _write_case(name: str, displacement: Displacement, noise: float, side: int, folder: Path) -> Path:
    """Images and case file."""
    middle, radius = (side - 1) / 2, side / 10
    is_holed = name == "Kirsch"
    pair = ddic.make_synthetic_pair(displacement, (side, side), noise=noise,
                                    hole=((middle, middle), radius) if is_holed else None)
    folder.mkdir(parents=True, exist_ok=True)
    for image, grey in zip(("reference", "deformed"), pair, strict=True):
        tifffile.imwrite(folder / f"{image}.tif", grey)
    hole = f"circles = [{{ center = [{middle}, {middle}], radius = {radius} }}]" if is_holed else ""
    path = folder / "case.toml"
    path.write_text(f"""
[images]
reference = "reference.tif"
deformed = "deformed.tif"
[mesh.structured]
region = [{MARGIN}, {MARGIN}, {side - MARGIN}, {side - MARGIN}]
element_size = {OWN[0]}
{hole}
[regularization]
cut_off_wavelength = {OWN[1]}
""", encoding="utf-8")
    return path
