"""A crack's tip, its factors and its opening, from exact displacements of nodes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import ddic
from ddic.cli.plot import plot
from ddic.cli.tables import _list_crack_lines, crack, opening
from ddic.errors import InputError
from ddic.fracture.crack_tip import evaluate_williams_series, find_kolosov_constant
from ddic.io.result_reader import Result
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import build_mesh

TIP = np.array([152.3, 100.0])
FACTORS = (0.3, -0.05, 2e-4)
ROOT = np.sqrt(2 * np.pi)


def cracked(end: float = 200.0, factors: tuple[float, float, float] = FACTORS) -> Result:
    """Two halves of a square of 300 x 200 px that meet at y = 100, with nodes of their own there; 5-px cells."""
    x, y = np.arange(0, 301, 5.0), np.arange(0, 101, 5.0)
    nodes, cells, side = [], [], []
    for number, base in enumerate((0.0, 100.0)):
        grid = np.stack(np.meshgrid(x, base + y), axis=-1).reshape(-1, 2)
        rows, columns = np.divmod(np.arange((len(y) - 1) * (len(x) - 1)), len(x) - 1)
        corner = rows * len(x) + columns + number * len(grid)
        nodes.append(grid)
        cells.append(np.stack([corner, corner + 1, corner + len(x) + 1, corner + len(x)], axis=1))
        side.append(np.full(len(grid), 1e-9 * (2 * number - 1)))
    points = np.concatenate(nodes)
    local = points - TIP + np.stack([np.zeros(len(points)), np.concatenate(side)], axis=1)
    terms = evaluate_williams_series(local, np.array([1, 2]), find_kolosov_constant(0.3, "stress"))
    u = terms @ [factors[0] / ROOT / 2, factors[2] / 8, -factors[1] / ROOT / 2, 0.0]
    mesh = build_mesh(points, {Q4: np.concatenate(cells)})
    case = json.dumps({"discontinuity": [{"vertices": [[-10.0, 100.0], [end, 100.0]]}]})
    return Result(Path("crack"), mesh, u, {}, {}, np.zeros(mesh.n_cells), {}, (), {"case": {"json": case}}, False)


@settings(max_examples=15, deadline=None)
@given(guess=st.floats(130, 175), one=st.floats(0.05, 0.5), ratio=st.floats(-0.5, 0.5))
def test_tip_and_factors_are_found_from_any_guess(guess: float, one: float, ratio: float) -> None:
    found = ddic.find_crack_tip(cracked(factors=(one, ratio * one, 2e-4)), tip=(guess, 100.0))
    # Bilinear cells miss a thousandth of the root of r from 3 cells away on.
    np.testing.assert_allclose(found.position, TIP, atol=0.2)
    assert found.opening_factor == pytest.approx(one, rel=5e-3)
    assert found.sliding_factor == pytest.approx(ratio * one, abs=5e-3 * one)
    assert found.t_stress == pytest.approx(2e-4, abs=2e-3 * one)


@pytest.mark.parametrize("ratio", [{"young_ratio": 15.0}, {"young_ratio": 1.0, "shear_ratio": 0.5}])
def test_a_composite_has_no_isotropic_tip(ratio: dict[str, float]) -> None:
    result = cracked()
    case = {**json.loads(result.attributes["case"]["json"]), "regularization": ratio}
    with pytest.raises(InputError, match=r"measured as a composite .* opening along the line"):
        ddic.find_crack_tip(replace(result, attributes={"case": {"json": json.dumps(case)}}))


def test_opening_is_that_of_the_faces() -> None:
    found = ddic.measure_opening(cracked())
    r = np.maximum(TIP[0] - found.points[:, 0], 0.0)
    # 2 (kappa + 1) / (2 mu) K sqrt(r / 2 pi) for either mode.
    expected = (find_kolosov_constant(0.3, "stress") + 1) / ROOT * np.sqrt(r)
    away = np.abs(found.points[:, 0] - TIP[0]) > 50
    # Cells of 5 px follow a root of 0.37 r^(1/2) px to h^2 / 8 of its second derivative: 0.0002 px, 50 px from the tip.
    np.testing.assert_allclose(found.normal[away], FACTORS[0] * expected[away], atol=1e-3)
    np.testing.assert_allclose(found.tangential[away], -FACTORS[1] * expected[away], atol=1e-3)


def test_places_at_a_bend_whose_sides_are_not_cut_are_left_out() -> None:
    """In the element with the bend the straight cut leaves both sides of the polyline on one side."""
    bend = np.array([98.4, 86.2])
    vertices = np.array([[-10.0, 130.0], bend, [210.0, 140.0]])

    y, x = np.mgrid[0:200, 0:200]
    is_above = y < np.interp(x, vertices[:, 0], vertices[:, 1])
    # Each side is drawn by itself: what opens between them shows nothing of either.
    above, below = (ddic.make_synthetic_pair(lambda p, v=v: np.tile([0.0, v], (len(p), 1)), (200, 200), seed=1)
                    for v in (-0.3, 0.3))
    deformed = np.where(is_above, above[1], below[1]).astype(np.uint8)
    result = ddic.measure((above[0], deformed), ddic.structured_mesh((16, 16, 176, 176), 32),
                          discontinuity=[{"vertices": vertices.tolist()}])
    found = ddic.measure_opening(result)
    # 8 bit on 32-px elements, and what opens shows nothing of either side.
    length = np.hypot(found.tangential, found.normal)
    assert length.min() > 0.4
    assert np.linalg.norm(found.points - bend, axis=1).min() > 5


@pytest.mark.parametrize(("arguments", "message"), [
    ({"line": 2}, "there are 1; give a number"),
    ({"tip": (290.0, 100.0)}, "leave 10 px about it"),
    ({"ring": ddic.Ring(30.0, 40.0)}, "has to end at 2 times"),
    ({"ring": ddic.Ring(-1.0)}, "give a radius above 0"),
    ({"ring": ddic.Ring(outer=float("nan"))}, "give a radius above 0"),
    ({"tip": (150.0, 160.0)}, "60 px beside the straight end"),
])
def test_impossible_questions_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ddic.find_crack_tip(cracked(), **arguments)  # type: ignore[arg-type]


def test_commands_print_and_write(tmp_path: Path) -> None:
    pair = ddic.make_synthetic_pair(lambda p: np.where(p[:, 1] > 80.3, 0.4, 0.0)[:, None] * np.array([1.0, 0.0]),
                                    (160, 160), seed=1)
    mesh = ddic.structured_mesh((16, 16, 144, 144), 8)
    path = tmp_path / "slid.vtkhdf"
    ddic.measure(pair, mesh, discontinuity=[{"vertices": [[0, 80.3], [160, 80.3]]}], output=path)
    table = CliRunner().invoke(opening, [str(path)])
    assert table.exit_code == 0, table.output
    rows = np.genfromtxt(tmp_path / "slid.opening.csv", delimiter=",", names=True)
    assert rows.dtype.names == ("line", "distance_px", "x_px", "y_px", "tangential_px", "normal_px", "excluded",
                                "doubtful")
    assert len(rows) > 120
    # Left is -y of a line along +x: it stays behind by the slip. 8 bit on 8-px elements.
    assert abs(rows["tangential_px"].mean() + 0.4) < 0.02
    drawn = CliRunner().invoke(plot, [str(path), "--kind", "opening"])
    assert drawn.exit_code == 0, drawn.output
    assert (tmp_path / "slid.opening.png").stat().st_size > 10000
    told = CliRunner().invoke(crack, [str(path), "--tip", "80", "80"])
    # There is no tip: what is printed or refused is one line each, never a traceback.
    assert told.exit_code in {0, 1, 2}
    refused = CliRunner().invoke(crack, [str(path), "--line", "3"])
    assert refused.exit_code == 2
    assert refused.output.count("\n") == 1


def test_a_place_that_was_not_measured_hides_no_tip() -> None:
    result = cracked()
    result.displacement[(np.abs(result.mesh.nodes - (170.0, 70.0)) <= 10.0).all(axis=1)] = np.nan
    found, of_whole = ddic.find_crack_tip(result), ddic.find_crack_tip(cracked())
    # 36 cells less of a thousand, and what a tip that is found 0.02 px beside brings in and out at the ring's edges.
    assert abs(of_whole.n_cells - 36 - found.n_cells) <= 4
    # Bilinear cells miss a thousandth of the root of r from 3 cells away on.
    np.testing.assert_allclose(found.position, TIP, atol=0.2)
    assert found.opening_factor == pytest.approx(FACTORS[0], rel=5e-3)


def noisy(deviation: float, seed: int) -> Result:
    """The same with noise of the nodes, whose standard deviation the result knows."""
    result = cracked()
    result.displacement[:] += deviation * np.random.default_rng(seed).standard_normal(result.displacement.shape)
    result.attributes["case"]["noise_floor_px"] = deviation
    return result


@pytest.mark.parametrize("seed", [0, 19, 32, 39, 43, 48])
def test_cells_that_enter_and_leave_the_ring_do_not_hide_the_tip(seed: int) -> None:
    found = ddic.find_crack_tip(noisy(0.02, seed), tip=(160.0, 100.0), ring=ddic.Ring(15.0, 45.0))
    # Five standard deviations by noise: it is 0.9 px in so small a ring.
    assert abs(found.position[0] - TIP[0]) < 5 * math.sqrt(3) * found.noise.place


def test_scatter_over_rings_is_small_and_holds_the_error() -> None:
    found = ddic.find_crack_tip(cracked())
    assert found.n_rings == 5
    # Bilinear cells miss the more of the root of r the nearer they are: smaller rings see more of that.
    assert found.scatter.opening_factor < 5e-3 * FACTORS[0]
    assert found.scatter.place < 0.2
    # A tip that moves by 0.01 px is taken for found.
    assert abs(found.position[0] - TIP[0]) < 3 * found.scatter.place + 0.01
    assert abs(found.opening_factor - FACTORS[0]) < 3 * found.scatter.opening_factor
    assert abs(found.sliding_factor - FACTORS[1]) < 3 * found.scatter.sliding_factor
    assert abs(found.t_stress - FACTORS[2]) < 3 * found.scatter.t_stress
    assert math.isnan(found.noise.opening_factor)


def test_noise_of_tip_and_factors_is_that_of_many_measurements() -> None:
    found = [ddic.find_crack_tip(noisy(0.02, seed)) for seed in range(40)]
    values = np.array([[tip.position[0], tip.opening_factor, tip.sliding_factor, tip.t_stress] for tip in found])
    told = found[0].noise
    predicted = np.array([told.place, told.opening_factor, told.sliding_factor, told.t_stress])
    # Noise of a measured field is averaged over a third of an element, that of nodes by themselves over a whole one.
    # 40 samples tell a standard deviation to 11 %.
    np.testing.assert_allclose(np.sqrt(3) * predicted, values.std(axis=0, ddof=1), rtol=0.35)


def test_noise_is_averaged_over_less_where_mechanics_join_nodes() -> None:
    result = noisy(0.02, 0)
    alone = ddic.find_crack_tip(result).noise
    case = json.loads(result.attributes["case"]["json"])
    result.attributes["case"]["json"] = json.dumps({**case, "regularization": {"cut_off_wavelength": 40.0}})
    # A weight given as eta says no wavelength.
    assert math.isnan(ddic.find_crack_tip(result).noise.place)
    result.attributes["case"].update(half_amplitude_shear_px=40.0, half_amplitude_longitudinal_px=40.0)
    held = ddic.find_crack_tip(result).noise
    # Areas of 0.4 x 40^2 and 5^2 / 3 px^2.
    assert held.opening_factor / alone.opening_factor == pytest.approx(math.sqrt(640 * 3 / 25), rel=1e-6)


@pytest.mark.parametrize(("ring", "limit", "n_rings"), [
    (ddic.Ring(), "0.9 of the way to the lower edge of the mesh", 5),
    (ddic.Ring(outer=500.0), "cut from 500 px by the lower edge of the mesh", 5),
    (ddic.Ring(outer=60.0), "", 5),
    (ddic.Ring(15.0, 35.0), "", 1),
])
def test_what_ends_the_ring_is_said(ring: ddic.Ring, limit: str, n_rings: int) -> None:
    found = ddic.find_crack_tip(cracked(), ring=ring)
    # Of edges as near as each other, 100 px, rounding chooses one.
    assert found.limit.replace("upper", "lower") == limit
    assert found.outer == pytest.approx(ring.outer if not limit else 100.0 if ring.outer else 90.0, abs=1.0)
    assert found.n_rings == n_rings
    assert math.isnan(found.scatter.place) == (n_rings == 1)
    lines = dict(_list_crack_lines(found, None, 1.0, "px"))
    assert ("scatter" in lines["K_I / mu"]) == (n_rings > 1)
    assert lines.get("outer radius") == (f"{found.outer:.0f} px, {found.limit}" if limit else None)


def test_a_bend_ends_the_ring() -> None:
    result = cracked()
    result.attributes["case"]["json"] = json.dumps(
        {"discontinuity": [{"vertices": [[-10.0, 90.0], [82.0, 100.0], [200.0, 100.0]]}]})
    found = ddic.find_crack_tip(result, ring=ddic.Ring(outer=90.0))
    assert found.limit == "cut from 90 px by the line's vertex at (82, 100) px"
    assert found.outer == pytest.approx(TIP[0] - 82.0, abs=0.5)


def test_a_ring_that_is_hardly_seen_is_told() -> None:
    result = cracked()
    result.displacement[result.mesh.nodes[:, 1] < 70.0] = np.nan
    found = ddic.find_crack_tip(result)
    # A disk of 90 px less the part beyond 30 px of its middle, and less its middle of 15 px: 72 % of the ring.
    assert found.covered == pytest.approx(0.72, abs=0.03)
    assert "px of the tip, 7" in dict(_list_crack_lines(found, None, 1.0, "px"))["ring"]


def test_scatter_is_printed_in_units_of_stress() -> None:
    found = ddic.find_crack_tip(noisy(0.02, 1))
    lines = dict(_list_crack_lines(found, 1000.0, 0.25, "mm"))
    # 1000 x sqrt(0.25) of what it is over mu.
    assert lines["K_I"] == (f"{500 * found.opening_factor:.5g} [mu] mm^(1/2), scatter "
                            f"{500 * found.scatter.opening_factor:.2g}, noise {500 * found.noise.opening_factor:.2g}")
    assert lines["T"].startswith(f"{1000 * found.t_stress:.5g} [mu], scatter ")
