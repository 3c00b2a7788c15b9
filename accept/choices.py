"""What is chosen for users: the solver by "auto" beside the fastest that could be stated, what a sweep recommends."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy.special import erf

import ddic
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_command, ddic_run, environment, images
from ddic.synth.fields import Kirsch, Sinusoidal

MOST_TIMES_FASTEST = 1.25
"""Largest time of "auto" over that of the best method."""

SIZES, WAVELENGTHS = (1000, 2000, 3000, 4000), (0, 80, 256)
"""Sides of the images and cut-off wavelengths, pixels; 0: no regularization."""

SMOKE_SIZES, SMOKE_WAVELENGTHS = (300,), (80,)
ELEMENT, EDGE = 10, 20
"""Side of an element, and what is left out at the images' edges, pixels."""

SIZE_ALONE = 2000
"""Side of the images that one rank measures as well, pixels."""

SIDE = 40
"""Elements along a side of the subdomains of which the dual method is given many."""

ROUNDS = 3
"""Runs of each method, one after the other in turn."""

HOPELESS = 2.0
"""Times the time of "auto" beyond which a method is not run again."""


@dataclass(frozen=True)
class SolvedCase:
    """A case whose linear steps are solved in several ways.

    Attributes
    ----------
    size : int
        Side of its images, pixels.
    wavelength : int
        Cut-off wavelength, pixels; 0: no regularization.
    n_ranks : int
        MPI ranks.
    folder : Path
        Where its images are, below ``images_SIZE``.
    """

    size: int
    wavelength: int
    n_ranks: int
    folder: Path

    def list_methods(self) -> dict[str, str]:
        """List the ways by name: what they add to the case file."""
        n_cells = ((self.size - 2 * EDGE) // ELEMENT) ** 2
        many = max(-(-n_cells // SIDE**2), self.n_ranks)
        methods = {"auto": "", "conjugate_gradient": 'method = "conjugate_gradient"\n',
                   "assembled": 'method = "assembled"\n', "dual": 'method = "dual"\n'}
        if many > self.n_ranks:
            methods["dual, many subdomains"] = f'method = "dual"\nsubdomains = {many}\n'
        return methods

    def write(self, solver: str) -> str:
        """Write the case file."""
        end = self.size - EDGE
        given = f"[regularization]\ncut_off_wavelength = {self.wavelength}\n" if self.wavelength else ""
        return (f'[images]\nreference = "images_{self.size}/reference.tif"\n'
                f'deformed = "images_{self.size}/deformed.tif"\n[mesh.structured]\n'
                f"region = [{EDGE}, {EDGE}, {end}, {end}]\nelement_size = {ELEMENT}\n{given}[solver]\n{solver}")


def measure_choice(scale: Scale) -> list[Row]:
    """Measure every case with "auto" and with each method stated, in turn."""
    sizes, wavelengths = (SMOKE_SIZES, SMOKE_WAVELENGTHS) if scale.smoke else (SIZES, WAVELENGTHS)
    folder = scale.folder("chosen_solver")
    cases = [SolvedCase(size, wavelength, 2, folder) for size in sizes for wavelength in wavelengths]
    cases += [SolvedCase(sizes[0] if scale.smoke else SIZE_ALONE, wavelength, 1, folder) for wavelength in wavelengths]
    for size in sizes:
        images("sinusoidal", "--size", f"{size}x{size}", "--noise", "2", folder=folder / f"images_{size}")
    return [_measure_case(case, 1 if scale.smoke else ROUNDS) for case in cases]


def _measure_case(case: SolvedCase, n_rounds: int) -> Row:
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in case.list_methods()}
    failed: set[str] = set()
    for _ in range(n_rounds):
        for name, solver in case.list_methods().items():
            if name in failed or _is_hopeless(runs, name):
                continue
            try:
                runs[name].append(_run(case, name, solver))
            except RuntimeError:
                # Most often conjugate gradients that do not converge: no rival.
                if name == "auto":
                    raise
                failed.add(name)
    seconds = {name: median(_seconds(run) for run in found) for name, found in runs.items() if found}
    best = min((name for name in seconds if name != "auto"), key=seconds.__getitem__)
    ratio = seconds["auto"] / seconds[best]
    taken = runs["auto"][0]
    listed = ", ".join(f"{name} {value:.2f}" for name, value in seconds.items())
    missing = f"; did not converge: {', '.join(sorted(failed))}" if failed else ""
    wavelength = f"l_c = {case.wavelength} px" if case.wavelength else "no regularization"
    return Row(f'"auto" against the best method: {case.size} x {case.size} px, {ELEMENT}-px Q4, {wavelength}, '
               f"{case.n_ranks} ranks: CPU seconds of a rank",
               f"<= {MOST_TIMES_FASTEST} times the best",
               f"{ratio:.2f} times {best} ({listed}{missing}); it took {taken['method']} on {taken['n_subdomains']} "
               "subdomains", ratio <= MOST_TIMES_FASTEST, judged_small=False)


def _run(case: SolvedCase, name: str, solver: str) -> dict[str, Any]:
    record = ddic_run(case.write(solver), case.folder, case.n_ranks, "run")
    append_result("chosen_solver_runs", {"size": case.size, "wavelength": case.wavelength, "name": name} | {
        key: record[key] for key in ("n_ranks", "method", "preconditioner", "n_subdomains", "iterations",
                                     "krylov_iterations", "seconds", "cpu_seconds", "peak_memory_bytes")})
    return record


def _seconds(record: Mapping[str, Any]) -> float:
    """CPU seconds of a rank, all phases: wall time means little where others compute."""
    return float(sum(record["cpu_seconds"].values()) / record["n_ranks"])


def _is_hopeless(runs: Mapping[str, Sequence[Mapping[str, Any]]], name: str) -> bool:
    """Whether a method's first run took far longer than that of "auto"."""
    return bool(runs[name]) and _seconds(runs[name][0]) > HOPELESS * _seconds(runs["auto"][0])


Array = NDArray[np.float64]
Displacement = Callable[[Array], Array]

SWEPT_SIDE, SMOKE_SWEPT_SIDE, MARGIN = 576, 192, 32
"""Side of the images and edge without elements, pixels."""

NOISES = (1.0, 4.0)
"""Standard deviation of the noise of both images, grey levels."""

ELEMENTS = (6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""Sizes that are swept, pixels: from fewer pixels than a speckle has to the smallest period of the star and more."""

LENGTHS = (0.0, 23.0, 32.0, 45.0, 64.0, 91.0, 128.0, 181.0, 256.0, 362.0, 512.0)
"""Cut-off wavelengths, sqrt 2 apart up to the width of the region, and none."""

OWN = (16.0, 64.0)
"""Element size and cut-off wavelength of the case, from which the recommendation must not depend."""

MOST_TIMES_BEST = 1.25
"""Error of the recommended settings over the least of the sweep."""

LEAST_MEASURED = 0.95
"""Share of the places at which settings must measure to count as the best."""


def measure_sweep(scale: Scale) -> list[Row]:
    """Sweep images of four exact fields with two levels of noise."""
    side = SMOKE_SWEPT_SIDE if scale.smoke else SWEPT_SIDE
    fields = _make_fields(side)
    if scale.smoke:
        return [_measure_swept("star", fields["star"], NOISES[-1], side, scale)]
    return [_measure_swept(name, field, noise, side, scale) for name, field in fields.items() for noise in NOISES]


def measure_example_sweep(scale: Scale) -> None:
    """Sweep the Gaussian neck with little noise as users do; case.sweep.png is a picture of the documentation."""
    name, folder = "Gaussian neck", scale.folder("sweep") / "example"
    case = _write_case(name, _make_fields(SWEPT_SIDE)[name], NOISES[0], SWEPT_SIDE, folder)
    subprocess.run([ddic_command(), "sweep", str(case), "--elements", "6,8,11.3,16,22.6,32"], env=environment(),
                   stdout=subprocess.DEVNULL, check=True)


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


def _measure_swept(name: str, displacement: Displacement, noise: float, side: int, scale: Scale) -> Row:
    """Sweep one pair and compare every setting with the truth, which the sweep does not know."""
    folder = scale.folder("sweep") / f"{name.replace(' ', '_')}_{noise:g}"
    case = _write_case(name, displacement, noise, side, folder)
    begin = time.process_time()
    small = {"element_sizes": (12.0, 16.0), "cut_off_wavelengths": (0.0, 64.0)}
    swept = {"element_sizes": ELEMENTS, "cut_off_wavelengths": LENGTHS}
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
        {"element_size": trial.candidate.element_size, "wavelength": trial.candidate.cut_off_wavelength,
         "error_px": error,
         "virtual_error_px": trial.virtual_error, "predicted_error_px": trial.predicted_error,
         "failure": trial.failure} for trial, error in zip(sweep.trials, errors.tolist(), strict=True)]})
    return Row(f"sweep, {name}, {side} x {side} px, noise {noise:g} grey levels: error of the recommended settings",
               f"<= {MOST_TIMES_BEST} times the least of the sweep", measured, bool(ratio <= MOST_TIMES_BEST))


def _rms(error: Array) -> float:
    """RMS of a component, pixels; nan where too little was measured."""
    is_measured = np.isfinite(error).all(axis=1)
    return float(np.sqrt((error[is_measured] ** 2).mean())) if is_measured.mean() >= LEAST_MEASURED else float("nan")


def _write_case(name: str, displacement: Displacement, noise: float, side: int, folder: Path) -> Path:
    """Images and case file."""
    middle, radius = (side - 1) / 2, side / 10
    is_holed = name == "Kirsch"
    pair = ddic.make_synthetic_pair(displacement, (side, side), noise=noise,
                                    hole={"center": (middle, middle), "radius": radius} if is_holed else None)
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
