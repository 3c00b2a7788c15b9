"""Slips: a known one, two bolted plates [RHR08, section 6.1], and shear bands found by themselves."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.opened_pair import (
    ANGLE,
    SIZE,
    SMOKE_SIZE,
    SPECKLE,
    Opened,
    find_field_error,
    find_opening_error,
    mesh_inside,
    render,
    straight_line,
)
from bench.support.rows import Row, append_result
from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.start.binned_pair import choose_block_sizes

ELEMENTS, SMOKE_ELEMENTS = (8, 16, 32, 64), (32,)
SLIPS, SMOKE_SLIPS = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9), (0.45,)
"""Sides of the elements and slips along the line, pixels."""

FIELD_PX, SLIP_PX = 6e-4, 1e-3
"""RMS errors of the displacement and of the slip with elements of 64 px."""


@dataclass(frozen=True)
class _Images:
    """Kind of the images: bits a pixel, and the size of the speckles, times the reference size."""

    bits: int = 16
    speckle: float = SPECKLE

    @property
    def what(self) -> str:
        return (f"slip of {SLIPS[0]:g} to {SLIPS[-1]:g} px along a line at {np.rad2deg(ANGLE):.0f} degrees, "
                f"{self.bits} bit, speckle of {self.speckle:g} times the reference size, "
                f"{describe_settings(MONOLITHIC)}")


JUDGED = _Images()
BESIDE = (_Images(bits=8), _Images(speckle=1.0))
"""Images that are reported beside those of the bounds: 8 bits, and the reference speckle."""


@dataclass(frozen=True)
class _Errors:
    """RMS errors by size of the elements, pixels: displacement of continuous and of enriched elements, and slip."""

    elements: tuple[int, ...]
    continuous: list[float]
    enriched: list[float]
    slip: list[float]

    def __str__(self) -> str:
        return "; ".join(f"{element} px: continuous {c:.1e}, enriched {e:.1e}, slip {s:.1e} px" for element, c, e, s in
                         zip(self.elements, self.continuous, self.enriched, self.slip, strict=True))


def measure_slip(scale: Scale) -> list[Row]:
    """Measure a slip along a line at 27 degrees with continuous elements and with the line given."""
    errors = _measure(scale, JUDGED)
    rises = bool((np.diff(errors.continuous) > 0).all())
    falls = bool((np.diff(errors.enriched) < 0).all())
    largest = errors.elements[-1]
    judged = [Row(f"{JUDGED.what}: RMS error of the displacement with growing elements",
                  f"rises with continuous elements, falls with enriched ones, <= {FIELD_PX} px at {largest} px",
                  str(errors), rises and falls and errors.enriched[-1] <= FIELD_PX),
              Row(f"{JUDGED.what}: RMS error of the slip along the line, {largest}-px elements", f"<= {SLIP_PX} px",
                  f"{errors.slip[-1]:.1e} px", errors.slip[-1] <= SLIP_PX)]
    return judged + [Row(f"{images.what}: RMS errors", "measured", str(_measure(scale, images)), True,
                         judged_small=False) for images in BESIDE]


def _measure(scale: Scale, images: _Images) -> _Errors:
    size = SMOKE_SIZE if scale.smoke else SIZE
    slips, elements = (SMOKE_SLIPS, SMOKE_ELEMENTS) if scale.smoke else (SLIPS, ELEMENTS)
    rms: dict[str, list[float]] = {"continuous": [], "enriched": [], "slip": []}
    for element in elements:
        found: dict[str, list[float]] = {name: [] for name in rms}
        for slip in slips:
            opened = straight_line(size, slip)
            pair = render(opened, size, speckle=images.speckle, bits=images.bits)
            mesh = mesh_inside(size, element)
            continuous = ddic.measure(pair, mesh, **MONOLITHIC)
            enriched = ddic.measure(pair, mesh, **MONOLITHIC, discontinuity=opened.sections("tangential"))
            found["continuous"].append(find_field_error(continuous, opened))
            found["enriched"].append(find_field_error(enriched, opened))
            found["slip"].append(find_opening_error(enriched, opened))
        for name, errors in found.items():
            rms[name].append(float(np.sqrt(np.mean(np.square(errors)))))
    append_result("xdic_runs", {"check": "slip", "bits": images.bits, "speckle": images.speckle,
                                "elements": elements, **rms})
    return _Errors(elements, **rms)


BOLTED_SLIP = 7.5
"""Of one plate along the other, which does not move, pixels."""

BOLTED_SIZE, SMOKE_BOLTED_SIZE, BOLTED_ELEMENT = 2048, 256, 32
"""Sides of the images and elements, pixels."""

REFERENCE_SPECKLE = 1.0
"""The reference speckle, which a start 7.5 px away does not find."""

MOST_ITERATIONS = 500
"""Enough for continuous elements to converge, slowly."""

REPEATS, SMOKE_REPEATS = 5, 1
"""Measurements with each basis, alternated; medians are compared."""


def measure_bolted(scale: Scale) -> list[Row]:
    """Measure a large slip on one level, on all levels, and with continuous elements."""
    size = SMOKE_BOLTED_SIZE if scale.smoke else BOLTED_SIZE
    opened = straight_line(size, BOLTED_SLIP)
    # The plate to the right of the line rests.
    opened = dataclasses.replace(opened, offset=opened.jumps[0] / 2)
    pair = render(opened, size, speckle=REFERENCE_SPECKLE)
    mesh = mesh_inside(size, BOLTED_ELEMENT)
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
            result = ddic.measure(pair, mesh, **options)
            runs[name].append((len(result.gauss_newton["iteration"]), time.process_time() - begin))
            if name == "enriched":
                error = find_field_error(result, opened)
    (n_enriched, s_enriched), (n_continuous, s_continuous) = (np.median(runs[name], axis=0) for name in runs)
    append_result("xdic_runs", {"check": "bolted", "runs": runs, "error": error, "one_level": alone})
    n_levels = len(choose_block_sizes((size, size), mesh)) + 1
    what = f"two plates of {size} x {size} px slide by {BOLTED_SLIP} px, {BOLTED_ELEMENT}-px elements"
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
        ddic.measure(pair, mesh, **options)
    except (ConvergenceError, SingularSubdomainError) as error:
        return str(error).split(";")[0]
    return ""


Array = NDArray[np.float64]

BAND_SLIP, BAND_NOISE, BAND_ELEMENT = 0.9, 2.0, 16
"""Pixels; grey levels of 256; side of the elements, pixels."""

"""The reference speckle."""

N_LINES, N_SEEDS, SMOKE_BANDS = 20, 20, 1
OFF_CENTRE = 80.0
"""Largest distance of a line from the middle of the image, pixels."""

DISTANCE_PX, ANGLE_DEGREES = 0.3, 0.2
"""Farthest that a line may be from its place at the middle of the region, and be turned."""


def measure_band(scale: Scale) -> list[Row]:
    """Find bands of unknown place, and none where there is none."""
    random = np.random.default_rng(0)
    n_lines, n_seeds = (SMOKE_BANDS, SMOKE_BANDS) if scale.smoke else (N_LINES, N_SEEDS)
    errors = []
    for k in range(n_lines):
        angle = (k + random.uniform()) * np.pi / n_lines
        opened = _band(angle, random.uniform(-OFF_CENTRE, OFF_CENTRE))
        pair = render(opened, SIZE, noise=BAND_NOISE, seed=k, speckle=REFERENCE_SPECKLE)
        found = _find(pair)
        errors.append((np.inf, np.inf) if found is None else _compare(found, opened.lines[0]))
    away, turned = np.max(errors, axis=0)
    append_result("xdic_runs", {"check": "band", "errors": errors})
    what = (f"slip of {BAND_SLIP} px, noise of {BAND_NOISE:g} grey levels, {BAND_ELEMENT}-px elements, {SIZE} x {SIZE} "
            f'px, {n_lines} lines of all orientations, discontinuity = "detect", {describe_settings(MONOLITHIC)}')
    is_near = bool(away <= DISTANCE_PX and turned <= ANGLE_DEGREES)
    rows = [Row(what, f"within {DISTANCE_PX} px and {ANGLE_DEGREES} degrees",
                f"largest {away:.3f} px and {turned:.4f} degrees", is_near)]
    for name, make in (("homogeneous", draw_homogeneous_field), ("smooth", draw_smooth_field)):
        n_found = 0
        for seed in range(n_seeds):
            field = make(np.random.default_rng(seed))
            pair = ddic.make_synthetic_pair(field, (SIZE, SIZE), noise=BAND_NOISE, seed=seed)
            n_found += _find(pair) is not None
        rows.append(Row(f"{name} fields, noise of {BAND_NOISE:g} grey levels, {n_seeds} seeds: lines found", "0",
                        str(n_found), n_found == 0))
    return rows


def _band(angle: float, height: float) -> Opened:
    """A line at an angle, some pixels from the middle of the image."""
    tangent, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    middle = np.full(2, SIZE / 2) + height * normal
    return Opened((np.stack([middle - 2 * SIZE * tangent, middle + 2 * SIZE * tangent]),), (BAND_SLIP * tangent,))


def _find(pair: tuple[NDArray[np.generic], NDArray[np.generic]]) -> Array | None:
    """The line by which a pair is measured, (2, 2); None where there is none."""
    result = ddic.measure(pair, mesh_inside(SIZE, BAND_ELEMENT), **MONOLITHIC, discontinuity="detect")
    lines = json.loads(result.attributes["case"]["json"])["discontinuity"]
    return np.array(lines[0]["vertices"]) if lines else None


def _compare(found: Array, known: Array) -> tuple[float, float]:
    """Distance of a line from another at the foot of the image's middle, pixels, and angle between them, degrees."""
    along, wanted = found[1] - found[0], known[1] - known[0]
    along, wanted = along / np.linalg.norm(along), wanted / np.linalg.norm(wanted)
    normal = np.array([-wanted[1], wanted[0]])
    middle = np.full(2, SIZE / 2)
    at_foot = found[0] + ((middle - found[0]) @ along) * along
    return float(abs((at_foot - known[0]) @ normal)), float(np.rad2deg(abs(np.arcsin(np.clip(along @ normal, -1, 1)))))


def draw_homogeneous_field(random: np.random.Generator) -> Callable[[Array], Array]:
    """Draw a displacement that is linear."""
    gradient, shift = random.normal(size=(2, 2)) * 5e-3, random.uniform(-1, 1, 2)
    return lambda points: np.asarray(shift + (points - SIZE / 2) @ gradient.T)


def draw_smooth_field(random: np.random.Generator) -> Callable[[Array], Array]:
    """A wave of 100 to 400 px and 0.2 to 2 px on top of a homogeneous field."""
    base = draw_homogeneous_field(random)
    length, amplitude, angle = random.uniform(100, 400), random.uniform(0.2, 2.0), random.uniform(0, np.pi)
    direction, polarization = np.array([np.cos(angle), np.sin(angle)]), random.normal(size=2)
    polarization /= np.linalg.norm(polarization)
    return lambda points: np.asarray(
        base(points) + amplitude * np.sin(2 * np.pi * (points @ direction) / length)[:, None] * polarization)
