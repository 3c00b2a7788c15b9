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
from accept.bad_inputs import try_kinds
from accept.source_rules import count_code
from accept.table import Scale
from accept.trials.volume_trials import list_volume_trials
from bench import interface_solvers, large_volumes, volume_kernels, volume_peers
from bench.support.before import checkout_before
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images, real_data
from bench.support.tiled_texture import CELL
from bench.volume_kernels import SIX
from ddic.io.mesh_file import write_mesh
from ddic.io.result_reader import read_result
from ddic.mesh.cell_type import TET4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import build_mesh
from ddic.methods.sweep import render_virtual_image

Array = NDArray[np.float64]

SIZE, SMOKE_SIZE = 256, 96
"""Side of speckle volumes, voxels."""

MARGIN = 16
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


def write_case(folder: Path, sizes: tuple[int, int], element: float, extra: str = "") -> str:
    """Give the case of a pair of cubes; ``sizes`` are their side and the edge without elements, voxels."""
    side, margin = sizes
    end = margin + element * ((side - 2 * margin) // element)
    box = ", ".join(f"{place:g}" for place in (margin, margin, margin, end, end, end))
    return f"""
[volumes]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
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
        rows.append(Row(f"analytic speckle, {size}^3, 8 bit, default waves of ddic synth, as in the plane 1024 and "
                        f"1280 voxels long, Hex8 of {ELEMENT} voxels, "
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


EQUAL_SIZE, EQUAL_WAVELENGTH, MOST_DIFFERENCE = 48, 24, 1e-8
"""Side of the volumes and cut-off wavelength, voxels; difference of fields, relative to the largest displacement."""

METHODS = {"dual": 'method = "dual"\nsubdomains = 8', "assembled": 'method = "assembled"\nsubdomains = 8',
           "conjugate_gradient": 'method = "conjugate_gradient"\nsubdomains = 8',
           "matching": 'method = "matching"\nsubdomains = 8'}
RANKS = (1, 2, 3, 4)

TIGHT = """tolerance = 1e-12
inexact = false
max_iterations = 5000
[gauss_newton]
tolerance = 1e-12
rms_tolerance = 1e-12
[start]
independent = false
"""
"""Keys that leave no error of iterations."""


def measure_equality(scale: Scale) -> list[Row]:
    """Measure with all methods on several ranks, and with one factor on one rank."""
    size = EQUAL_SIZE
    folder = images("sinusoidal", "--size", f"{size}x{size}x{size}", folder=scale.folder("volume_equal"))
    mask = np.full((size,) * 3, 255, np.uint8)
    mask[:, 20:24, 8:24] = 0
    tifffile.imwrite(folder / "mask.tif", mask)
    grid = GridLines((np.arange(8.0, 41.0, 8.0),) * 3).build_mesh()
    write_mesh(folder / "tetrahedra.vtu", build_mesh(grid.nodes, {TET4: grid.cells[:, SIX].reshape(-1, 4)}))
    write_mesh(folder / "boxes.vtu", grid)
    rows = []
    for cells in ("boxes", "tetrahedra"):
        text = (f'[volumes]\nreference = "reference.tif"\ndeformed = "deformed.tif"\nmask = "mask.tif"\n'
                f'[mesh]\nfile = "{cells}.vtu"\n{_cut_off(EQUAL_WAVELENGTH)}')

        def measure(solver: str, n_ranks: int, text: str = text) -> Array:
            ddic_run(f"{text}[solver]\n{solver}\n{TIGHT}", folder, n_ranks)
            return np.asarray(read_result(folder / "result.vtkhdf").displacement)

        oracle = measure('method = "monolithic"', 1)
        found = {f"{method} on {n_ranks}": float(np.abs(measure(keys, n_ranks) - oracle).max() / np.abs(oracle).max())
                 for method, keys in METHODS.items() for n_ranks in (RANKS[1:2] if scale.smoke else RANKS)}
        worst = max(found, key=found.__getitem__)
        rows.append(Row(f"{size}^3 with a mask, {cells} of 8 voxels, l_c = {EQUAL_WAVELENGTH} voxels, 8 subdomains; "
                        f"{', '.join(METHODS)} on {', '.join(map(str, RANKS))} ranks against one factor",
                        f"<= {MOST_DIFFERENCE:g} relative", f"{found[worst]:.1e}, {worst} ranks",
                        found[worst] <= MOST_DIFFERENCE))
    return rows


MOST_SCALED, MOST_TWO_LEVEL = 30, 25
"""Iterations of the interface problem to 1e-6."""

INTERFACES = ([("scaled", 8, 2, waves) for waves in (0.5, 1.0, 2.0, 4.0)]
              + [("two_level", 6, blocks, waves) for blocks in (4, 6) for waves in (2.0, 4.0, 8.0)])
"""Preconditioner, elements along a subdomain's side, subdomains along the cube's, cut-off wavelength over the side."""
SMALL_INTERFACES = [("scaled", 4, 2, 1.0), ("two_level", 4, 2, 2.0)]
"""Of a smoke run."""


def measure_iterations(scale: Scale) -> list[Row]:
    """Count the iterations of the dual method."""
    counts: dict[str, dict[str, int]] = {"scaled": {}, "two_level": {}}
    for preconditioner, side, blocks, waves in SMALL_INTERFACES if scale.smoke else INTERFACES:
        record = interface_solvers.run(preconditioner, side, side * blocks, waves * side * CELL, 1,
                                       interface_solvers.TIMEOUT_S, 3)
        append_result("volumes_runs", record)
        counts[preconditioner][f"{blocks**3} subdomains, l_c = {waves:g} H"] = record.get("iterations", 10**6)
    rows = []
    for preconditioner, most in (("scaled", MOST_SCALED), ("two_level", MOST_TWO_LEVEL)):
        listed = "; ".join(f"{where}: {count}" for where, count in counts[preconditioner].items())
        rows.append(Row(f"dual, {preconditioner}, cubes of Hex8, tiled texture: iterations to 1e-6", f"<= {most}",
                        listed, max(counts[preconditioner].values()) <= most))
    return rows


LONG_SIDE, LONG_WAVES, LONG_SECONDS, LONG_MEMORY = 40, 32, 20, 2
"""Elements along a cube, cut-off wavelength in elements, CPU seconds, GiB."""


def measure_long_wavelength(scale: Scale) -> list[Row]:
    """Solve one linear step of 206,763 unknowns with a long cut-off wavelength."""
    side = 8 if scale.smoke else LONG_SIDE
    record = interface_solvers.run("matching", None, side, LONG_WAVES * CELL, 1, interface_solvers.TIMEOUT_S, 3)
    append_result("volumes_runs", record)
    what = (f"{record['n_dofs']} unknowns, Hex8, l_c = {LONG_WAVES} elements, method = \"matching\", 1 rank, set-up "
            "and one step to 1e-6")
    bound = f"<= {LONG_SECONDS} CPU s, <= {LONG_MEMORY} GiB"
    if record["outcome"] != "solved":
        return [Row(what, bound, record["outcome"], False)]
    seconds, memory = record["setup_cpu"] + record["solve_cpu"], max(record["peak_memory_bytes"]) / 2**30
    return [Row(what, bound, f"{seconds:.1f} CPU s ({record['setup_cpu']:.1f} of set-up), {record['iterations']} "
                f"iterations, {memory:.2f} GiB", seconds <= LONG_SECONDS and memory <= LONG_MEMORY, judged_small=False)]


def measure_kernels(scale: Scale) -> list[Row]:
    """Measure the rates of voxel kernels."""
    return volume_kernels.measure(volume_kernels.SMALL if scale.smoke else volume_kernels.SIZE)


def measure_large(scale: Scale) -> list[Row]:
    """Measure 512^3 voxels from files to the result."""
    return [large_volumes.measure(96 if scale.smoke else 512)]


def measure_huge(scale: Scale) -> list[Row]:
    """Measure 1024^3 voxels, regularized."""
    return [large_volumes.measure(96 if scale.smoke else 1024)]


def measure_peers(scale: Scale) -> list[Row]:
    """Measure CPU and error against al-dvc and spam, which the first measurement installs."""
    if not scale.smoke:
        return volume_peers.measure()
    folder = images("translation", "--size", "64x64x64", "--vector", "0.5", "0.5", "0.5",
                    folder=scale.folder("volume_of_peers"))
    summary = ddic_run(write_case(folder, (64, MARGIN), ELEMENT), folder, 1)
    return [Row("al-dvc and spam: ddic alone", "runs", f"{sum(summary['cpu_seconds'].values()):.1f} CPU s", True,
                judged_small=False)]


MOST_MORE, BEFORE, WITH_VOLUMES = 3000, "e96c963b", "4e564260"
"""Lines of code in src/ that volumes may need, more than the commit before them has; the commit that has them all."""


def measure_source(scale: Scale) -> list[Row]:
    """Count what volumes added to the source."""
    del scale
    more = count_code(checkout_before(WITH_VOLUMES) / "src") - count_code(checkout_before(BEFORE) / "src")
    return [Row("lines of code in src/ more than before volumes", f"at most {MOST_MORE}", str(more),
                more <= MOST_MORE)]


FEWEST_KINDS = 400
"""Of bad input."""


def measure_bad_inputs(scale: Scale) -> list[Row]:
    """Try every kind of bad input that volumes can have, and some as a user does."""
    return try_kinds(scale, list_volume_trials(), FEWEST_KINDS)
