"""Volumes: how near is the field to a known one, of analytic speckle and of real snow, however turned and stretched.

Speckle is a sum of Gaussians, of which nothing is interpolated. Snow is moved by a quintic spline, another one than the
cubic that measures, and the moved volume is given white noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from accept.accuracy import ELEMENT, error_rms
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images, real_data
from ddic.io.result_reader import read_result
from ddic.methods.sweep import render_virtual_image

Array = NDArray[np.float64]

SIZE, SMOKE_SIZE = 256, 96
"""Side of speckle volumes, voxels."""

MARGIN, SMOKE_MARGIN = 16, 16
"""Edge without elements, voxels."""

NOISE, WAVELENGTH = 5, 4 * ELEMENT
"""Grey levels, and the cut-off wavelength beside them, voxels."""

MOST_ERROR = {0: 0.0015, NOISE: 0.003}
"""RMS error of a component by noise, voxels."""

SHIFTS, MOST_BIAS, SHIFTED_SIZE = (0.25, 0.5, 0.75), 1.5e-3, 128
"""Of all voxels along all axes; mean error of a component, voxels; side of these volumes."""

MOST_FLOORS = 1.5
"""RMS error of a component over the noise floor that the run tells."""

N_RANKS = 2


def write_case(folder: Path, sizes: tuple[int, int], element: float, extra: str = "", names: str = "tif") -> str:
    """Give the case of a pair of cubes; ``sizes`` are their side and the edge without elements, voxels."""
    side, margin = sizes
    end = margin + element * ((side - 2 * margin) // element)
    box = ", ".join(f"{place:g}" for place in (margin, margin, margin, end, end, end))
    return f"""
[volumes]
reference = "{folder}/reference.{names}"
deformed = "{folder}/deformed.{names}"
[mesh.structured]
region = [{box}]
element_size = {element:g}
{extra}"""


def _cut_off(wavelength: float) -> str:
    return f"[regularization]\ncut_off_wavelength = {wavelength:g}\n"


def measure_accuracy(scale: Scale) -> list[Row]:
    """Measure waves on analytic speckle without noise, and with noise and a regularization."""
    size = SMOKE_SIZE if scale.smoke else SIZE
    rows = []
    for noise, wavelength in ((0, 0), (NOISE, WAVELENGTH)):
        folder = images("sinusoidal", "--size", f"{size}x{size}x{size}", "--noise", str(noise),
                        folder=scale.folder(f"volume_waves_noise{noise}"))
        extra = _cut_off(wavelength) if wavelength else ""
        summary = ddic_run(write_case(folder, (size, MARGIN), ELEMENT, extra), folder, N_RANKS)
        error = error_rms(folder / "result.vtkhdf", folder / "truth.json")
        append_result("volumes_runs", {"noise": noise, "error_px": error, **summary})
        gap = f"l_c = {wavelength} voxels" if wavelength else "no regularization"
        rows.append(Row(f"analytic speckle, {size}^3, 8 bit, default waves of ddic synth, Hex8 of {ELEMENT} voxels, "
                        f"noise {noise} grey levels, {gap}: RMS error at nodes an element from the border",
                        f"<= {MOST_ERROR[noise]} voxels", f"{error:.5f} voxels", error <= MOST_ERROR[noise],
                        judged_small=False))
    return rows


def measure_bias(scale: Scale) -> list[Row]:
    """Measure uniform shifts by quarters of a voxel along all axes."""
    size, shifts = (SMOKE_SIZE, SHIFTS[:1]) if scale.smoke else (SHIFTED_SIZE, SHIFTS)
    errors = {}
    for shift in shifts:
        folder = images("translation", "--size", f"{size}x{size}x{size}", "--vector", *[str(shift)] * 3,
                        folder=scale.folder(f"volume_shift{shift:g}"))
        ddic_run(write_case(folder, (size, MARGIN), ELEMENT), folder, N_RANKS)
        displacement = read_result(folder / "result.vtkhdf").displacement
        errors[shift] = float(np.abs(displacement.mean(axis=0) - shift).max())
        append_result("volumes_runs", {"shift": shift, "bias_px": errors[shift]})
    listed = ", ".join(f"{error:.2e} at {shift:g}" for shift, error in errors.items())
    return [Row(f"uniform shifts along x, y and z, analytic speckle, {size}^3, 8 bit, no noise, Hex8 of {ELEMENT} "
                "voxels, no regularization: mean error of a component over all nodes", f"<= {MOST_BIAS:g} voxels",
                listed, max(errors.values()) <= MOST_BIAS)]


@dataclass(frozen=True)
class _Applied:
    """What moves the snow: x -> F (x - middle) + middle + translation, and waves; cut-off wavelengths, 0 for none."""

    name: str
    gradient: Array
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wave: float = 0.0
    wavelengths: tuple[float, ...] = (0.0, 48.0)

    def displace(self, points: Array, middle: float) -> Array:
        """The displacement at points, (n, 3), voxels."""
        waves = self.wave * np.sin(2.0 * np.pi * points[:, [1, 2, 0]] / WAVE)
        return np.asarray(self.translation + (points - middle) @ (self.gradient - np.eye(3)).T + waves)


def _turn(degrees: float, axis: Array) -> Array:
    """The matrix of a rotation about an axis."""
    along = axis / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), along)
    angle = np.deg2rad(degrees)
    return np.asarray(np.eye(3) - np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


APPLIED = (
    _Applied("translation of (1.3, -0.7, 0.4) voxels and waves of 0.5 voxels", np.eye(3), (1.3, -0.7, 0.4), 0.5),
    _Applied("20 degrees about (1, 2, 3)", _turn(20.0, np.array([1.0, 2.0, 3.0]))),
    _Applied("15 % of stretch along x, -4 % along y and z", np.diag([1.15, 0.96, 0.96]),
             # Mechanics of free faces, the default, are not those of a cube that is pulled.
             wavelengths=(0.0,)),
)
"""Fields that are applied to the snow."""

WAVE = 128.0
"""Length of the waves that move the snow, voxels."""

SNOW_NOISE, SNOW_MARGIN, SNOW_ELEMENT = 0.02, 26, 12
"""Noise over the standard deviation of the grey levels; edge without elements and side of the elements, voxels."""


def measure_snow(scale: Scale) -> list[Row]:
    """Apply known fields to a real volume and find them, by defaults, from no start that is given."""
    snow = tifffile.imread(real_data() / "snow" / "snow.tif").astype(np.float64)
    size, middle = len(snow), 0.5 * (len(snow) - 1)
    sigma = SNOW_NOISE * snow.std()
    rows = []
    for number, applied in enumerate(APPLIED[:1] if scale.smoke else APPLIED):
        folder = scale.folder(f"snow{number}")
        folder.mkdir(parents=True, exist_ok=True)
        z, y, x = np.mgrid[:size, :size, :size].astype(np.float64)
        points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
        moved = render_virtual_image(snow, applied.displace(points, middle).reshape(*snow.shape, 3))
        moved = moved + sigma * np.random.default_rng(number).standard_normal(moved.shape)
        for name, values in (("reference", snow), ("deformed", moved)):
            tifffile.imwrite(folder / f"{name}.tif", np.clip(np.rint(values), 0, 65535).astype(np.uint16))
        for wavelength in applied.wavelengths:
            extra = _cut_off(wavelength) if wavelength else ""
            summary = ddic_run(write_case(folder, (size, SNOW_MARGIN), SNOW_ELEMENT, extra), folder, N_RANKS)
            result = read_result(folder / "result.vtkhdf")
            error = result.displacement - applied.displace(result.mesh.nodes, middle)
            rms, floor = float(np.sqrt((error**2).mean())), summary["noise_floor_px"]
            append_result("volumes_runs", {"applied": applied.name, "error_px": rms, **summary})
            gap = f"l_c = {wavelength:g} voxels" if wavelength else "no regularization"
            rows.append(Row(f"snow, 100^3, 16 bit, {applied.name}, noise of {SNOW_NOISE:.0%} of the contrast, Hex8 of "
                            f"{SNOW_ELEMENT} voxels, {gap}: RMS error of all nodes",
                            f"<= {MOST_FLOORS:g} of the noise floor that the run tells",
                            f"{rms:.4f} of {floor:.4f} voxels", rms <= MOST_FLOORS * floor))
    return rows
