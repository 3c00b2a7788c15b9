"""A shear band found by itself: twenty lines of all orientations, and twenty fields without one."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.opened_pair import SIZE, Opened, mesh_inside, render
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result

Array = NDArray[np.float64]

SLIP, NOISE, ELEMENT = 0.9, 2.0, 16
"""Pixels; grey levels of 256; side of the elements, pixels."""

SPECKLE = 1.0
"""The reference speckle."""

N_LINES, N_SEEDS, SMOKE = 20, 20, 1
OFF_CENTRE = 80.0
"""Largest distance of a line from the middle of the image, pixels."""

DISTANCE_PX, ANGLE_DEGREES = 0.3, 0.2
"""Farthest that a line may be from its place at the middle of the region, and be turned."""


def measure_band(scale: Scale) -> list[Row]:
    """Find bands of unknown place, and none where there is none.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one line and one field.

    Returns
    -------
    list of Row
        Lines; homogeneous and smooth fields.
    """
    random = np.random.default_rng(0)
    n_lines, n_seeds = (SMOKE, SMOKE) if scale.smoke else (N_LINES, N_SEEDS)
    errors = []
    for k in range(n_lines):
        angle = (k + random.uniform()) * np.pi / n_lines
        opened = _band(angle, random.uniform(-OFF_CENTRE, OFF_CENTRE))
        pair = render(opened, SIZE, noise=NOISE, seed=k, speckle=SPECKLE)
        found = _find(pair)
        errors.append((np.inf, np.inf) if found is None else _compare(found, opened.lines[0]))
    away, turned = np.max(errors, axis=0)
    append_result("xdic_runs", {"check": "band", "errors": errors})
    what = (f"slip of {SLIP} px, noise of {NOISE:g} grey levels, {ELEMENT}-px elements, {SIZE} x {SIZE} px, "
            f'{n_lines} lines of all orientations, discontinuity = "detect", {describe_settings(MONOLITHIC)}')
    is_near = bool(away <= DISTANCE_PX and turned <= ANGLE_DEGREES)
    rows = [Row(what, f"within {DISTANCE_PX} px and {ANGLE_DEGREES} degrees",
                f"largest {away:.3f} px and {turned:.4f} degrees", is_near)]
    for name, make in (("homogeneous", _homogeneous), ("smooth", _smooth)):
        n_found = 0
        for seed in range(n_seeds):
            field = make(np.random.default_rng(seed))
            pair = ddic.make_synthetic_pair(field, (SIZE, SIZE), noise=NOISE, seed=seed)
            n_found += _find(pair) is not None
        rows.append(Row(f"{name} fields, noise of {NOISE:g} grey levels, {n_seeds} seeds: lines found", "0",
                        str(n_found), n_found == 0))
    return rows


def _band(angle: float, height: float) -> Opened:
    """A line at an angle, some pixels from the middle of the image."""
    tangent, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    middle = np.full(2, SIZE / 2) + height * normal
    return Opened((np.stack([middle - 2 * SIZE * tangent, middle + 2 * SIZE * tangent]),), (SLIP * tangent,))


def _find(pair: tuple[NDArray[np.generic], NDArray[np.generic]]) -> Array | None:
    """The line by which a pair is measured, (2, 2); None where there is none."""
    result = ddic.measure(pair, mesh_inside(SIZE, ELEMENT), options={**MONOLITHIC, "discontinuity": "detect"})
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


def _homogeneous(random: np.random.Generator) -> Callable[[Array], Array]:
    gradient, shift = random.normal(size=(2, 2)) * 5e-3, random.uniform(-1, 1, 2)
    return lambda points: np.asarray(shift + (points - SIZE / 2) @ gradient.T)


def _smooth(random: np.random.Generator) -> Callable[[Array], Array]:
    """A wave of 100 to 400 px and 0.2 to 2 px on top of a homogeneous field."""
    base = _homogeneous(random)
    length, amplitude, angle = random.uniform(100, 400), random.uniform(0.2, 2.0), random.uniform(0, np.pi)
    direction, polarization = np.array([np.cos(angle), np.sin(angle)]), random.normal(size=2)
    polarization /= np.linalg.norm(polarization)
    return lambda points: np.asarray(
        base(points) + amplitude * np.sin(2 * np.pi * (points @ direction) / length)[:, None] * polarization)
