"""A crack's tip, its factors and its opening, from exact displacements of nodes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import ddic
from ddic.cli.plot import plot
from ddic.cli.tables import crack, opening
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
