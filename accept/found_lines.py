"""Lines found without being told: two that cross or run along each other, three, one that bends; and none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.slips import draw_homogeneous_field, draw_smooth_field
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.opened_pair import SIZE, Opened, mesh_inside, render
from bench.support.rows import Row, append_result

Array = NDArray[np.float64]
Random = np.random.Generator

N_CASES, N_WITHOUT, SMOKE_CASES = 25, 20, 1
ELEMENT, NOISE, JUMP = 16, 2.0, 0.9
"""Side of the elements, pixels; grey levels of 256; pixels by which the sides of a line part."""

DISTANCE_PX, ANGLE_DEGREES, SHARE = 0.3, 0.2, 0.9
"""Farthest that a line may be from its place in the middle of what is seen of it, and be turned; share of the cases in
which all lines must be so near, and no other one be found."""

SEEN = (24.0, 472.0)
"""From where to where the mesh reaches along either axis, pixels."""


def measure_found_lines(scale: Scale) -> list[Row]:
    """Find lines of unknown place, number and shape, and none where there is none."""
    n_cases = SMOKE_CASES if scale.smoke else N_CASES
    setting = (f"{JUMP:g} px between the sides, noise of {NOISE:g} grey levels, {ELEMENT}-px elements, {SIZE} x {SIZE} "
               f'px, discontinuity = "detect", {describe_settings(MONOLITHIC)}')
    rows = [_measure(name, draw, n_cases, setting) for name, draw in KINDS.items()]
    n_fields = SMOKE_CASES if scale.smoke else N_WITHOUT
    n_found = 0
    for seed in range(n_fields):
        draw = (draw_homogeneous_field, draw_smooth_field)[seed % 2]
        # Other fields than those of "xdic band".
        field = draw(np.random.default_rng(100 + seed))
        pair = ddic.make_synthetic_pair(field, (SIZE, SIZE), noise=NOISE, seed=100 + seed)
        n_found += len(_find_lines(pair))
    return [*rows, Row(f"homogeneous and smooth fields in turn, noise of {NOISE:g} grey levels, {n_fields} fields: "
                       "lines found", "0", str(n_found), n_found == 0)]


def _measure(name: str, draw: Callable[[Random], Opened], n_cases: int, setting: str) -> Row:
    errors = []
    for seed in range(n_cases):
        opened = draw(np.random.default_rng(seed))
        found = _find_lines(render(opened, SIZE, noise=NOISE, seed=seed, speckle=1.0))
        errors.append(_compare(found, opened.lines))
    are_near = [error.is_near for error in errors]
    append_result("papers_runs", {"check": "found_lines", "kind": name,
                                  "errors": [[error.away, error.turned] for error in errors]})
    near = [error for error in errors if error.is_near]
    away, turned = (max((getattr(error, key) for error in near), default=np.inf) for key in ("away", "turned"))
    return Row(f"{name}, {n_cases} cases, {setting}: all lines found, and no other",
               f"within {DISTANCE_PX} px and {ANGLE_DEGREES} degrees in {SHARE:.0%}",
               f"{sum(are_near)} of {n_cases}, those within {away:.3f} px and {turned:.3f} degrees",
               bool(sum(are_near) >= SHARE * n_cases), judged_small=False)


def _place_line(angle: float, height: float) -> Array:
    """A line across the image at an angle, some pixels from its middle."""
    tangent, normal = _find_directions(angle)
    middle = np.full(2, SIZE / 2) + height * normal
    return np.stack([middle - 2 * SIZE * tangent, middle + 2 * SIZE * tangent])


def _find_directions(angle: float) -> tuple[Array, Array]:
    """Along a line, and to the right of it."""
    return np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])


def _let_slide(random: Random, angles: list[float], heights: list[float]) -> Opened:
    """Lines along each of which the sides slide."""
    jumps = [random.choice([-1, 1]) * JUMP * _find_directions(angle)[0] for angle in angles]
    return Opened(tuple(map(_place_line, angles, heights)), tuple(jumps))


def _draw_crossing_lines(random: Random) -> Opened:
    first, between = random.uniform(0, np.pi), np.deg2rad(random.uniform(30, 150))
    return _let_slide(random, [first, first + between], list(random.uniform(-60, 60, 2)))


def _draw_parallel_lines(random: Random) -> Opened:
    first, between = random.uniform(0, np.pi), np.deg2rad(random.uniform(-4, 4))
    middle, apart = random.uniform(-40, 40), random.uniform(80, 160)
    return _let_slide(random, [first, first + between], [middle - apart / 2, middle + apart / 2])


def _draw_three_lines(random: Random) -> Opened:
    first = random.uniform(0, np.pi)
    angles = [first, *(first + np.deg2rad(turn + random.uniform(-15, 15)) for turn in (60, 120))]
    return _let_slide(random, angles, list(random.uniform(-100, 100, 3)))


def _draw_bend(random: Random) -> Opened:
    """A line that bends by 20 to 90 degrees; its sides part along both legs, since overlaps show either."""
    first, turn = random.uniform(0, 2 * np.pi), random.choice([-1, 1]) * np.deg2rad(random.uniform(20, 90))
    bend = np.full(2, SIZE / 2) + random.uniform(-60, 60, 2)
    line = np.stack([bend - 2 * SIZE * _find_directions(first)[0], bend,
                     bend + 2 * SIZE * _find_directions(first + turn)[0]])
    along, to_right = _find_directions(first + turn / 2)
    off_normal = random.uniform(-1, 1) * (np.pi / 2 - abs(turn) / 2)
    return Opened((line,), (JUMP * (np.sin(off_normal) * along - np.cos(off_normal) * to_right),))


KINDS: dict[str, Callable[[Random], Opened]] = {
    "two lines that cross at 30 to 150 degrees": _draw_crossing_lines,
    "two lines along each other, 80 to 160 px apart": _draw_parallel_lines,
    "three lines": _draw_three_lines,
    "a bend of 20 to 90 degrees": _draw_bend,
}


def _find_lines(pair: tuple[NDArray[np.generic], NDArray[np.generic]]) -> list[Array]:
    """The lines by which a pair is measured, (n_vertices, 2) each."""
    result = ddic.measure(pair, mesh_inside(SIZE, ELEMENT), **MONOLITHIC, discontinuity="detect")
    lines = json.loads(result.attributes["case"]["json"])["discontinuity"]
    return [np.array(line["vertices"]) for line in lines]


@dataclass(frozen=True)
class _Error:
    """Largest distance and angle of lines that were found from those that are there; infinite where one has none."""

    away: float
    turned: float

    @property
    def is_near(self) -> bool:
        """Whether both are within their bounds."""
        return self.away <= DISTANCE_PX and self.turned <= ANGLE_DEGREES


def _compare(found: list[Array], known: tuple[Array, ...]) -> _Error:
    """Compare straight pieces with straight pieces."""
    pieces, wanted = ([np.stack(ends) for line in lines for ends in pairwise(line)] for lines in (found, known))
    if len(found) != len(known) or len(pieces) != len(wanted):
        return _Error(np.inf, np.inf)
    errors = [min(_compare_pieces(piece, there) for piece in pieces) for there in wanted]
    away, turned = np.max(errors, axis=0)
    return _Error(float(away), float(turned))


def _compare_pieces(found: Array, known: Array) -> tuple[float, float]:
    """Distance of one from the middle of what is seen of the other, pixels, and angle between them, degrees."""
    points = known[0] + np.linspace(0.0, 1.0, 4001)[:, None] * (known[1] - known[0])
    middle = points[((points >= SEEN[0]) & (points <= SEEN[1])).all(axis=1)].mean(axis=0)
    along, wanted = ((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]) for ends in (found, known))
    place = float((middle - found[0]) @ along)
    if not 0.0 <= place <= np.linalg.norm(found[1] - found[0]):
        return np.inf, np.inf
    normal = np.array([-wanted[1], wanted[0]])
    away = abs(float((found[0] + place * along - middle) @ normal))
    return away, float(np.rad2deg(np.arcsin(np.clip(abs(along @ normal), 0.0, 1.0))))
