"""A tip moved along its line by the residual of Williams' series about it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.support.opened_pair import Crack, render_crack
from ddic.detection.refine_line import UncertainLine
from ddic.detection.refine_tip import LEAST_PX, choose_radius, find_tip_move
from ddic.errors import ConvergenceError
from ddic.fracture.crack_tip import find_kolosov_constant
from ddic.kinematics.enriched import Discontinuities
from ddic.kinematics.tip_functions import Tip, find_tips
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.structured import build_structured_mesh
from ddic.start.coarse_displacement import CutField
from ddic.start.independent import Images
from support.pictures import source

Array = NDArray[np.float64]

SIDE = 224
MESH = build_structured_mesh((16.0, 16.0, 208.0, 208.0), 16.0)
TIP = np.array([120.3, 109.7])
KAPPA = find_kolosov_constant(0.3, "stress")


@dataclass(frozen=True, eq=False)
class Stretched(Crack):
    """A crack in a specimen that turns, and that comes nearer to the camera."""

    gradient: Array = field(default_factory=lambda: np.zeros((2, 2)))

    def displacement(self, points: Array) -> Array:
        opened = points + super().displacement(points)
        return np.asarray(opened + (opened - self.tip) @ self.gradient.T - points)


class NotElastic(Crack):
    """A crack whose sides part as roots of the distance do, and move nowhere else."""

    def displacement(self, points: Array) -> Array:
        normal = np.array([-self.along[1], self.along[0]])
        x, y = (points - self.tip) @ self.along, (points - self.tip) @ normal
        return np.asarray((0.3 * np.sqrt(np.hypot(x, y)) * np.sin(np.arctan2(y, x) / 2))[:, None] * normal)


def turn(degrees: float, stretch: float) -> Array:
    angle = np.deg2rad(degrees)
    return (1 + stretch) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) - np.eye(2)


CRACKS = {"opening": Crack(tip=TIP, opening_factor=0.25),
          "sliding too": Crack(tip=TIP, opening_factor=0.2, sliding_factor=0.2),
          "turned and stretched": Stretched(tip=TIP, opening_factor=0.25, gradient=turn(3.0, 0.01)),
          "not elastic": NotElastic(tip=TIP, opening_factor=0.25),
          "closed": Crack(tip=TIP, opening_factor=0.0)}


@cache
def render(kind: str, noise: float) -> Images:
    f, g = render_crack(CRACKS[kind], SIDE, noise)
    return Images(source(f), source(g), np.ones((SIDE, SIDE), np.uint8), 3, "none")


def give(kind: str, off: float) -> tuple[CutField, Tip, Array]:
    """The field as elements hold it, and the tip off by some pixels along the line."""
    crack = CRACKS[kind]
    line = np.stack([crack.tip - 400 * crack.along, crack.tip + off * crack.along])
    cut = cut_mesh(MESH, [line])
    patch = find_tips(MESH, [line], [True])
    assert patch is not None
    return CutField(cut.mesh, crack.displacement(find_points_on_own_side(cut.mesh))), patch.tips[0], line


def uncertain(tip: Tip, lines: list[Array]) -> UncertainLine:
    return UncertainLine(Discontinuities(tuple(lines)), tip.line, 3.0)


# Four standard deviations of what noise makes of the place: 0.03, 0.13 and 0.25 px.
@pytest.mark.parametrize(("noise", "bound"), [(0.0, 0.12), (1.0, 0.5), (2.0, 1.0)])
@pytest.mark.parametrize("off", [-10.0, -3.0, 0.0, 3.0, 10.0])
def test_a_tip_is_found_along_its_line(off: float, noise: float, bound: float) -> None:
    field_, tip, line = give("opening", off)
    move = find_tip_move(render("opening", noise), MESH, field_, tip, uncertain(tip, [line]), KAPPA)
    assert abs(move.ahead + off) < bound
    # It is told how exactly.
    assert abs(move.ahead + off) < 4 * move.deviation + 0.05
    assert move.deviation < bound / 3


@pytest.mark.parametrize("kind", ["sliding too", "turned and stretched"])
def test_modes_turns_and_a_camera_that_comes_nearer_do_not_matter(kind: str) -> None:
    field_, tip, line = give(kind, 4.0)
    move = find_tip_move(render(kind, 1.0), MESH, field_, tip, uncertain(tip, [line]), KAPPA)
    assert abs(move.ahead + 4.0) < 0.5


def test_poissons_ratio_matters_little() -> None:
    field_, tip, line = give("opening", -4.0)
    other = find_kolosov_constant(0.45, "stress")
    move = find_tip_move(render("opening", 1.0), MESH, field_, tip, uncertain(tip, [line]), other)
    assert abs(move.ahead - 4.0) < 1.0


# The series fitted to it lies 5 px ahead.
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_field_that_is_not_elastic_tells_nothing_of_its_tip(noise: float) -> None:
    field_, tip, line = give("not elastic", 0.0)
    with pytest.raises(ConvergenceError, match="does not fit"):
        find_tip_move(render("not elastic", noise), MESH, field_, tip, uncertain(tip, [line]), KAPPA)


def test_a_crack_that_is_closed_tells_nothing_of_its_tip() -> None:
    field_, tip, line = give("closed", 0.0)
    move = find_tip_move(render("closed", 1.0), MESH, field_, tip, uncertain(tip, [line]), KAPPA)
    assert abs(move.ahead) < 2 * move.deviation
    assert move.deviation > 1.0


def test_near_another_line_there_is_no_room() -> None:
    _, tip, line = give("opening", 0.0)
    radius, limit = choose_radius(MESH, tip, uncertain(tip, [line]))
    # Four elements, and 0.9 times the 87.7 px to the nearest of the mesh's nodes at the side.
    assert (radius, limit) == (64.0, "4 elements")
    beside = line[::-1] + np.array([0.0, 20.0])
    radius, limit = choose_radius(MESH, tip, uncertain(tip, [line, beside]))
    assert radius < LEAST_PX
    assert limit == "another line"
