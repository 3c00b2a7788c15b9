"""Displacements that are discontinuous across a line: known fields, and the same field by all solvers on all ranks."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.cli.check import check
from ddic.cli.plot import plot
from ddic.cli.run import run
from ddic.errors import ConvergenceError, InputError
from support.oracles import make_on_root

Array = NDArray[np.float64]
SIZE = 200
START = np.array([-20.0, 62.3])
ANGLE = np.deg2rad(21.0)
TANGENT, NORMAL = np.array([np.cos(ANGLE), np.sin(ANGLE)]), np.array([-np.sin(ANGLE), np.cos(ANGLE)])
LINE = [START.tolist(), (START + 300 * TANGENT).tolist()]
SLIP = 0.6
MESH = {kind: ddic.structured_mesh((20, 20, 180, 180), 16, kind) for kind in ("Q4", "T3")}
EXACT = {"gauss_newton": {"tolerance": 1e-10, "rms_tolerance": 0, "largest_tolerance": 1e-8}}
SOLVERS = {
    "dual": {"method": "dual", "subdomains": 5, "inexact": False, "tolerance": 1e-11},
    "blocks": {"method": "dual", "partition": "blocks", "blocks": [3, 2], "inexact": False, "tolerance": 1e-11},
    "conjugate_gradient": {"method": "conjugate_gradient", "subdomains": 4, "inexact": False, "tolerance": 1e-11},
}
REGULARIZED = {"regularization": {"cut_off_wavelength": 60}}


def slide(points: Array) -> Array:
    """Both sides move along the line, apart by SLIP; no point changes sides."""
    height = (points - START) @ NORMAL
    along = 0.4 + np.where(height > 0, SLIP / 2, -SLIP / 2) + 1e-3 * height
    return np.asarray(along[:, None] * TANGENT)


@cache
def sliding_pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return ddic.make_synthetic_pair(slide, (SIZE, SIZE), seed=3)


def measure(settings: dict[str, Any], opening: str = "both", kind: str = "Q4") -> ddic.Result:
    line = {"vertices": LINE, "opening": opening}
    return ddic.measure(sliding_pair(), MESH[kind], discontinuity=[line], **settings)


def beside_the_line(distance: float) -> tuple[Array, Array]:
    """Points on both sides of the line, at that distance."""
    on_line = START + np.linspace(50, 200, 40)[:, None] * TANGENT
    return on_line + distance * NORMAL, on_line - distance * NORMAL


@pytest.mark.parametrize("kind", ["Q4", "T3"])
@pytest.mark.parametrize("opening", ["both", "tangential"])
@pytest.mark.parametrize("settings", [{}, REGULARIZED], ids=["plain", "regularized"])
def test_field_is_found_on_both_sides(kind: str, opening: str, settings: dict[str, Any]) -> None:
    result = measure(settings | {"solver": {"method": "monolithic"}}, opening, kind)
    points = np.random.default_rng(0).uniform(40, 160, (2000, 2))
    error = result.at(points) - slide(points)
    # 8 bit leave 0.01 px on 16-px elements, more on the small parts of cut ones; the slip itself is 0.6 px.
    assert np.sqrt((error**2).mean()) < 0.02
    above, below = beside_the_line(0.1)
    apart = result.at(above) - result.at(below) - SLIP * TANGENT
    assert np.sqrt((apart**2).mean()) < 0.05
    if opening == "tangential":
        assert np.abs(apart @ NORMAL).max() < 0.01


def test_continuous_elements_smear_the_slip() -> None:
    result = ddic.measure(sliding_pair(), MESH["Q4"], solver={"method": "monolithic"})
    points = np.random.default_rng(0).uniform(40, 160, (2000, 2))
    assert np.sqrt(((result.at(points) - slide(points)) ** 2).mean()) > 0.03


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("opening", "settings"), [("both", {}), ("tangential", REGULARIZED)],
                         ids=["plain", "regularized"])
def test_all_solvers_find_the_field_of_the_assembled_operator(opening: str, settings: dict[str, Any]) -> None:
    alone: dict[str, Any] = settings | EXACT | {
        "solver": {"method": "monolithic"}, "discontinuity": [{"vertices": LINE, "opening": opening}],
        "comm": MPI.COMM_SELF}
    above, below = beside_the_line(3.0)
    points = np.vstack([above, below, MESH["Q4"].nodes + np.array([0.1, 0.2])])
    expected = make_on_root(lambda: ddic.measure(sliding_pair(), MESH["Q4"], **alone).at(points))
    for solver in SOLVERS.values():
        result = measure(settings | EXACT | {"solver": solver}, opening)
        # The linear steps are solved to 1e-11 of a pixel or so.
        assert np.nanmax(np.abs(result.at(points) - expected)) < 1e-9


def test_line_that_ends_inside_opens_behind_its_end() -> None:
    """A crack from the left edge to the middle, opened by a wedge: nothing parts ahead of its end."""
    tip = np.array([100.0, 101.3])

    def open_up(points: Array) -> Array:
        behind = np.maximum(tip[0] - points[:, 0], 0.0)
        above = points[:, 1] > tip[1]
        return np.column_stack([np.zeros(len(points)), np.where(above, 0.5, -0.5) * 6e-3 * behind])

    # Each side is drawn by itself: what opens up between them shows nothing of either.
    height, width = SIZE, SIZE
    sides = [ddic.make_synthetic_pair(lambda p, s=side: np.column_stack(
        [np.zeros(len(p)), s * 3e-3 * np.maximum(tip[0] - p[:, 0], 0.0)]), (width, height), seed=3)
        for side in (1.0, -1.0)]
    reference, deformed = sides[0][0], np.where(np.arange(height)[:, None] > tip[1], sides[0][1], sides[1][1])
    result = ddic.measure((reference, deformed.astype(np.uint8)), MESH["Q4"],
                          discontinuity=[{"vertices": [[0.0, 101.3], [101.0, 101.3]]}])
    x = np.linspace(30, 170, 57)
    apart = (result.at(np.column_stack([x, np.full(57, 102.3)])) - result.at(np.column_stack([x, np.full(57, 100.3)])))
    wanted = open_up(np.column_stack([x, np.full(57, 110.0)])) - open_up(np.column_stack([x, np.full(57, 90.0)]))
    assert np.abs(apart - wanted)[x < 70].max() < 0.08
    # Ahead of the cell of the end both points lie in elements of one piece: 2 px of bilinear displacement.
    assert np.abs(apart)[x > 118].max() < 0.03


CRACK_TIP = np.array([103.3, 101.7])


def part(points: Array, above: bool) -> Array:
    """Opening of a crack that ends at CRACK_TIP: the root of r times sin(theta / 2), on either face."""
    x, y = (points - CRACK_TIP) @ TANGENT, (points - CRACK_TIP) @ NORMAL
    r, theta = np.hypot(x, y), np.arctan2(y, x)
    theta = np.where(theta < 0, theta + 2 * np.pi, theta) if above else np.where(theta > 0, theta - 2 * np.pi, theta)
    return np.asarray((0.08 * np.sqrt(r) * np.sin(np.where(x > 0, np.arctan2(y, x), theta) / 2))[:, None] * NORMAL)


@cache
def cracked_pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Each face is drawn by itself, and the deformed image put together along the line."""
    drawn = [ddic.make_synthetic_pair(partial(part, above=above), (SIZE, SIZE), seed=3) for above in (True, False)]
    rows, columns = np.indices((SIZE, SIZE))
    is_above = (np.stack([columns, rows], axis=-1) - CRACK_TIP) @ NORMAL > 0
    return drawn[0][0], np.where(is_above, drawn[0][1], drawn[1][1])


def measure_crack(settings: dict[str, Any], tip_functions: bool) -> ddic.Result:
    line = {"vertices": [(CRACK_TIP - 300 * TANGENT).tolist(), CRACK_TIP.tolist()], "tip_functions": tip_functions}
    return ddic.measure(cracked_pair(), MESH["Q4"], discontinuity=[line], **settings)


def test_tip_functions_hold_what_elements_about_a_tip_do_not() -> None:
    angle, r = np.random.default_rng(0).uniform((-np.pi, 3.0), (np.pi, 24.0), (2000, 2)).T
    points = CRACK_TIP + r[:, None] * (np.cos(angle)[:, None] * TANGENT + np.sin(angle)[:, None] * NORMAL)
    height = (points - CRACK_TIP) @ NORMAL
    points, height = points[np.abs(height) > 3], height[np.abs(height) > 3]
    wanted = np.where(height[:, None] > 0, part(points, above=True), part(points, above=False))
    found = {tips: measure_crack({}, tips).at(points) - wanted for tips in (False, True)}
    errors = {tips: float(np.sqrt((error**2).mean())) for tips, error in found.items()}
    # 8 bit leave 0.01 px on 16-px elements; without the root of r they are off by a part of the 0.3 px that it opens.
    assert errors[True] < 0.015
    assert errors[True] < 0.5 * errors[False]


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("settings", [{}, REGULARIZED], ids=["plain", "regularized"])
def test_all_solvers_find_the_field_about_a_tip(settings: dict[str, Any]) -> None:
    line = {"vertices": [(CRACK_TIP - 300 * TANGENT).tolist(), CRACK_TIP.tolist()], "tip_functions": True}
    alone: dict[str, Any] = settings | EXACT | {"solver": {"method": "monolithic"}, "discontinuity": [line],
                                                "comm": MPI.COMM_SELF}
    points = np.vstack([CRACK_TIP + np.random.default_rng(0).uniform(-30, 30, (300, 2)), MESH["Q4"].nodes + 0.1])
    expected = make_on_root(lambda: ddic.measure(cracked_pair(), MESH["Q4"], **alone).at(points))
    for solver in SOLVERS.values():
        result = measure_crack(settings | EXACT | {"solver": solver}, tip_functions=True)
        # The linear steps are solved to 1e-11 of a pixel or so.
        assert np.nanmax(np.abs(result.at(points) - expected)) < 1e-9


@cache
def far_apart() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """One side rests, the other slides 12 px along the line."""
    return ddic.make_synthetic_pair(lambda points: np.where(
        (points - START) @ NORMAL > 0, 12.0, 0.0)[:, None] * TANGENT, (400, 400), seed=3)


@pytest.mark.parallel([1, 3])
def test_start_finds_sides_that_are_far_apart() -> None:
    line = [START.tolist(), (START + 500 * TANGENT).tolist()]
    mesh = ddic.structured_mesh((20, 20, 380, 380), 16)
    settings: dict[str, Any] = {"discontinuity": [{"vertices": line, "opening": "tangential"}]}
    result = ddic.measure(far_apart(), mesh, **settings)
    on_line = START + np.linspace(50, 350, 100)[:, None] * TANGENT
    apart = result.at(on_line + 3 * NORMAL) - result.at(on_line - 3 * NORMAL)
    # 8 bit and elements of 16 px: some hundredths of a pixel.
    assert np.sqrt(((apart - 12.0 * TANGENT) ** 2).mean()) < 0.05
    # Levels that smear the slip leave half of it, more than speckles of 5 px allow.
    # Cells beside the line would else be excluded, and found again from their neighbours.
    smeared = settings | {"start": {"largest_enriched_block": 0}, "correlation": {"spoilt_pixels": "keep"}}
    try:
        apart = ddic.measure(far_apart(), mesh, **smeared).at(on_line + 3 * NORMAL)
    except ConvergenceError:
        return
    assert np.sqrt(((apart - 12.0 * TANGENT) ** 2).mean()) > 1.0


@pytest.mark.parametrize(("line", "message"), [
    ({"vertices": [[-50, -50], [-10, -10]]}, "discontinuity, entry 1: its line crosses no element"),
    ({"vertices": [[50, 50], [50, 50]]}, "a vertex repeats the one before it"),
    ({"vertices": [[50, 50]]}, "expected at least 2 items"),
    ({"vertices": [[0, 60], [90, 95], [103.2, 96]], "tip_functions": True}, r"its line bends at \(90, 95\) px"),
    ({"vertices": LINE, "tip_functions": True}, "neither end of its line lies in the mesh"),
    ({"tip_functions": True}, "give discontinuity.vertices up to the tip"),
    ({"vertices": [[0, 62.3], [100, 70]], "opening": "normal", "tip_functions": True}, 'leave opening = "normal" out'),
    ({"vertices": LINE, "opening": "sideways"}, 'expected "both", "tangential" or "normal"'),
])
def test_bad_lines_are_refused(line: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ddic.measure(sliding_pair(), MESH["Q4"], discontinuity=[line])


def test_kinematics_of_ones_own_are_refused_beside_discontinuities() -> None:
    with pytest.raises(InputError, match="discontinuities have kinematics of their own"):
        ddic.measure(sliding_pair(), MESH["Q4"], kinematics=ddic.NodalRegion, discontinuity=[{"vertices": LINE}])


def test_command_line_measures_says_and_shows_it(tmp_path: Path) -> None:
    """`ddic check`, `ddic run` and `ddic plot` of a case file; VTK opens the line."""
    for name, image in zip(("f", "g"), sliding_pair(), strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.tif"), image)
    (tmp_path / "case.toml").write_text(
        '[images]\nreference = "f.tif"\ndeformed = "g.tif"\n[mesh.structured]\nregion = [20, 20, 180, 180]\n'
        f'element_size = 16\n[[discontinuity]]\nvertices = {LINE}\nopening = "tangential"\n'
        '[solver]\nmethod = "monolithic"\n')
    checked = CliRunner().invoke(check, [str(tmp_path / "case.toml")])
    assert checked.exit_code == 0, checked.output
    assert "1 line cuts 14 elements" in checked.stdout
    ran = CliRunner().invoke(run, [str(tmp_path / "case.toml")])
    assert ran.exit_code == 0, ran.output
    assert "discontinuities: 1 line cuts 14 elements" in ran.output
    drawn = CliRunner().invoke(plot, [str(tmp_path / "result.vtkhdf"), "--output", str(tmp_path)])
    assert drawn.exit_code == 0, drawn.output
    result = ddic.open(tmp_path / "result.vtkhdf")
    # Whole cells, and 14 cut ones in triangles: neighbours across the line have no point in common.
    assert result.mesh.n_cells > 100 + 14
    above = (result.mesh.centroids - START) @ NORMAL > 0
    shared = np.intersect1d(np.unique(result.mesh.cells[above]), np.unique(result.mesh.cells[~above]))
    assert shared.tolist() == [-1]
    # A restart finds the field on both sides again: phantom nodes go on from the middle of their parts by the slope
    # there, which triangles of a bilinear part have to some per cent.
    again = '[start]\nfrom_result = "result.vtkhdf"\n[output]\nfile = "b.vtkhdf"\n'
    (tmp_path / "again.toml").write_text((tmp_path / "case.toml").read_text() + again)
    ran = CliRunner().invoke(run, [str(tmp_path / "again.toml")])
    assert ran.exit_code == 0, ran.output
    assert ddic.open(tmp_path / "b.vtkhdf").gauss_newton["rms_correction_px"][0] < 6e-3
