"""A crack whose line, or tip, is given off its place: openings, K_I, and the line and tip that its residual refines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.crack import NEAR_TIP as ABOUT_TIP
from accept.crack import place_about_tip
from accept.support.cracked_pair import Crack, render_crack
from accept.support.opened_pair import MARGIN, mesh_inside
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from ddic.fracture.opening import get_line

Array = NDArray[np.float64]

SIZE, SMOKE_SIZE, ELEMENT, NOISE = 640, 512, 16, 1.0
"""Sides of the images and of the elements, pixels; grey levels of 256."""

OPENING, BEYOND = 5.5, 30.0
"""Largest opening, and how far the line goes on ahead of the tip, pixels."""

OFFSETS, TURNS, SEEDS, CUT_OFF = (0.0, 1.0, 2.0, 3.0, 5.0), (0.5, 1.0), (0, 1, 2), 80.0
"""How far the line is off across itself, pixels, and about the middle of the crack, degrees; of the noise; pixels."""

SMOKE_CASES = ((2.0, 0.0), (0.0, 1.0))

TIP_OFFSETS, SMOKE_TIP_OFFSETS = (-5.0, -2.0, 0.0, 2.0, 5.0), (-5.0,)
"""How far the end of a line with tip functions is off along the line, ahead where positive, pixels."""

NEAR_TIP, NEAR_EDGE = 3 * ELEMENT, ELEMENT
"""Pixels from the tip and from the mesh's edge within which openings are not judged: elements at the tip do not hold
the root of the distance, and are 0.15 px off with the line in its place; nodes at the edge have more noise."""

OPENING_PX, FACTOR, LINE_PX, LINE_DEGREES = 0.1, 0.02, 0.5, 0.1
"""Largest errors of openings, K_I, and the refined line's place and direction."""

TIP_PX, ABOUT_TIP_PX = 1.0, 0.02
"""Largest error of the refined tip's place, and RMS error about the tip: 0.025 px with l_c where it stays 5 px off."""


@dataclass(frozen=True)
class _Found:
    """What one measurement came to: largest errors, and the share of the openings that are nan."""

    opening: float
    nan_share: float
    factor: float
    line: float
    degrees: float

    @property
    def holds(self) -> bool:
        return (self.opening <= OPENING_PX and abs(self.factor) <= FACTOR and self.line <= LINE_PX
                and abs(self.degrees) <= LINE_DEGREES)


def measure_line_off(scale: Scale) -> list[Row]:
    """Measure a crack in mode I with its line displaced and turned, with and without regularization.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image, one seed and two places.

    Returns
    -------
    list of Row
        One for each place.
    """
    size = SMOKE_SIZE if scale.smoke else SIZE
    crack = _place_crack(size)
    cases = SMOKE_CASES if scale.smoke else (*((off, 0.0) for off in OFFSETS), *((0.0, turn) for turn in TURNS))
    pairs = [render_crack(crack, size, NOISE, seed) for seed in (SEEDS[:1] if scale.smoke else SEEDS)]
    return [_measure_place(crack, size, pairs, place) for place in cases]


def _place_crack(size: int) -> Crack:
    """A crack from the left edge, OPENING open there."""
    tip = np.array([0.68 * size + 0.3, 0.53 * size + 0.7])
    at_unit_factor = Crack(tip=tip, opening_factor=1.0)
    mouth = tip - (tip[0] - MARGIN) * at_unit_factor.along / at_unit_factor.along[0]
    opening = float(np.linalg.norm(_find_jumps(at_unit_factor, mouth[None])))
    return Crack(tip=tip, opening_factor=OPENING / opening)


def _find_jumps(crack: Crack, points: Array) -> Array:
    """Displacement of the crack's left side less that of its right one, (n, 2), where points lie along it."""
    to_left = np.array([crack.along[1], -crack.along[0]])
    on_crack = crack.tip + ((points - crack.tip) @ crack.along)[:, None] * crack.along
    return crack.displacement(on_crack + 1e-6 * to_left) - crack.displacement(on_crack - 1e-6 * to_left)


def _measure_place(crack: Crack, size: int, pairs: list[tuple[NDArray[Any], NDArray[Any]]],
                   place: tuple[float, float]) -> Row:
    """Off by some pixels, or turned by some degrees."""
    off, turn = place
    line = _misplace(crack, size, off, turn)
    found = []
    for cut_off in (None, CUT_OFF):
        regularization = {} if cut_off is None else {"regularization": {"cut_off_wavelength": cut_off}}
        options = {**MONOLITHIC, **regularization, "discontinuity": [{"vertices": line.tolist()}]}
        for pair in pairs:
            found.append(_judge(crack, ddic.measure(pair, mesh_inside(size, ELEMENT), options=options)))
            append_result("accept_trust_runs", {"check": "line_off", "off_px": off, "turned_degrees": turn,
                                                "cut_off": cut_off or 0.0, "opening_px": found[-1].opening,
                                                "nan_share": found[-1].nan_share, "factor_off": found[-1].factor,
                                                "line_px": found[-1].line, "line_degrees": found[-1].degrees})
    worst: Mapping[str, float] = {name: max(abs(getattr(one, name)) for one in found)
                                  for name in ("opening", "nan_share", "factor", "line", "degrees")}
    where = f"turned by {turn:g} degrees" if turn else f"off by {off:g} px"
    return Row(f"crack in mode I, {OPENING:g} px open, {size} x {size} px, {ELEMENT}-px elements, noise of {NOISE:g} "
               f"grey levels, {describe_settings(MONOLITHIC)}, without l_c and with {CUT_OFF:g} px, {len(pairs)} "
               f"seeds, line {where}: opening {NEAR_TIP:g} px or more from the tip and {NEAR_EDGE:g} px from the "
               "mesh's edge; K_I; line",
               f"within {OPENING_PX:g} px or nan; {FACTOR:.0%}; {LINE_PX:g} px and {LINE_DEGREES:g} degrees",
               f"{worst['opening']:.3f} px, {worst['nan_share']:.0%} nan; {worst['factor']:.2%}; "
               f"{worst['line']:.2f} px, {worst['degrees']:.3f} degrees", all(one.holds for one in found))


def _misplace(crack: Crack, size: int, off: float, turn: float) -> Array:
    """The crack's line beyond its tip, moved across itself and turned about the middle of what is open."""
    angle = crack.angle + np.deg2rad(turn)
    along = np.array([np.cos(angle), np.sin(angle)])
    half = float(crack.tip[0] - MARGIN) / crack.along[0] / 2
    middle = crack.tip - half * crack.along + off * np.array([-crack.along[1], crack.along[0]])
    return np.stack([middle - 2 * size * along, middle + (half + BEYOND) * along])


def _judge(crack: Crack, result: ddic.Result) -> _Found:
    opening = ddic.measure_opening(result)
    line = get_line(result, 1)
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    to_left = np.array([along[1], -along[0]])
    judged = ((opening.points - crack.tip) @ crack.along <= -NEAR_TIP) & (opening.points[:, 0] >= MARGIN + NEAR_EDGE)
    jumps = _find_jumps(crack, opening.points)
    errors = np.hypot(opening.tangential - jumps @ along, opening.normal - jumps @ to_left)[judged]
    heights = (opening.points - crack.tip) @ np.array([-crack.along[1], crack.along[0]])
    tip = ddic.find_crack_tip(result)
    degrees = float(np.rad2deg(np.arctan2(along[1], along[0]) - crack.angle))
    return _Found(float(np.nanmax(errors)), float(np.isnan(errors).mean()),
                  tip.opening_factor / crack.opening_factor - 1, float(np.abs(heights[judged]).max()), degrees)


def measure_tip_off(scale: Scale) -> list[Row]:
    """Measure a crack in mode I with tip functions and its tip displaced, with and without regularization.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image, one seed and one place.

    Returns
    -------
    list of Row
        One for each place.
    """
    size = SMOKE_SIZE if scale.smoke else SIZE
    crack = _place_crack(size)
    pairs = [render_crack(crack, size, NOISE, seed) for seed in (SEEDS[:1] if scale.smoke else SEEDS)]
    return [_measure_tip_place(crack, size, pairs, off) for off in (SMOKE_TIP_OFFSETS if scale.smoke else TIP_OFFSETS)]


def _measure_tip_place(crack: Crack, size: int, pairs: list[tuple[NDArray[Any], NDArray[Any]]], off: float) -> Row:
    line = {"vertices": [(crack.tip - 2 * size * crack.along).tolist(), (crack.tip + off * crack.along).tolist()],
            "tip_functions": True}
    points = place_about_tip(crack)
    found = []
    for cut_off in (None, CUT_OFF):
        regularization = {} if cut_off is None else {"regularization": {"cut_off_wavelength": cut_off}}
        for pair in pairs:
            result = ddic.measure(pair, mesh_inside(size, ELEMENT),
                                  options={**MONOLITHIC, **regularization, "discontinuity": [line]})
            factor = ddic.find_crack_tip(result).opening_factor / crack.opening_factor - 1
            away = float(np.linalg.norm(get_line(result, 1)[-1] - crack.tip))
            rms = float(np.sqrt(np.mean((result.at(points) - crack.displacement(points)) ** 2)))
            found.append((abs(factor), away, rms))
            append_result("accept_trust_runs", {"check": "tip_off", "off_px": off, "cut_off": cut_off or 0.0,
                                                "factor_off": factor, "tip_px": away, "about_tip_px": rms})
    factor_off, tip_px, about_tip_px = np.max(found, axis=0)
    return Row(f"crack in mode I with tip functions, {OPENING:g} px open, {size} x {size} px, {ELEMENT}-px elements, "
               f"noise of {NOISE:g} grey levels, {describe_settings(MONOLITHIC)}, without l_c and with {CUT_OFF:g} px, "
               f"{len(pairs)} seeds, end of the line {off:+g} px ahead of the tip: K_I; end of the line after it was "
               f"refined; RMS error within {ABOUT_TIP:g} px of the tip",
               f"{FACTOR:.0%}; within {TIP_PX:g} px; {ABOUT_TIP_PX:g} px",
               f"{factor_off:.2%}; {tip_px:.2f} px; {about_tip_px:.4f} px",
               bool(factor_off <= FACTOR and tip_px <= TIP_PX and about_tip_px <= ABOUT_TIP_PX))
