"""Files of probes, tables of what they read, and tables of whole fields."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import ddic
from ddic.cli.tables import export, probe
from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.result_pieces import Piece
from ddic.io.result_writer import ResultWriter
from ddic.mesh.structured import build_structured_mesh
from ddic.probes.probes import format_probe, parse_probe, parse_probes
from probes.conftest import MakeResult

Array = NDArray[np.float64]
FILE = """
[point.A]
point = [12, 20.5]
[line.B]
start = [10, 20]
end = [50, 20]
spacing = 10
[gauge.C]
centre = [40, 40]
length = 20
angle = 90
[extensometer.D]
start = [10, 10]
end = [10, 90]
"""


def stretch(points: Array, strain: float) -> Array:
    return np.column_stack([np.zeros(len(points)), strain * points[:, 1]])


def write_result(path: Path, time: float, pixel_size: float | None = None) -> None:
    """A result of one piece, stretched by a hundredth for each unit of time."""
    mesh = build_structured_mesh((0, 0, 100, 100), 10)
    u = stretch(mesh.nodes, 0.01 * time)
    tensor = np.tile([0.0, 0.01 * time, 0.0, 0.0, 0.0, 0.0], (mesh.n_nodes, 1))
    unit = None if pixel_size is None else "mm"
    points = {schema.DISPLACEMENT: u, schema.DISPLACEMENT_MESH_UNITS: u, schema.GLOBAL_NODE_ID: np.arange(mesh.n_nodes),
              schema.NODAL_INFINITESIMAL: tensor, schema.NODAL_GREEN_LAGRANGE: tensor}
    if pixel_size is not None:
        points[schema.DISPLACEMENT_PHYSICAL] = u * pixel_size
    of_cells = {spec.name: np.zeros((mesh.n_cells, spec.n_components)[:1 + (spec.n_components > 1)], spec.dtype)
                for spec in schema.cell_fields()}
    of_cells[schema.GLOBAL_CELL_ID] = np.arange(mesh.n_cells)
    piece = Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, points, of_cells)
    nodal = [spec for spec in schema.nodal_strain_fields() if spec.name in points]
    with ResultWriter(path) as writer:
        writer.write_pieces([piece], (*schema.point_fields(unit), *nodal), schema.cell_fields())
        writer.write_attributes(schema.TIME, {"reference": 0.0, "deformed": time})
        writer.write_attributes(schema.CASE, {"noise_floor_px": 0.01})
        writer.write_attributes(schema.UNITS, {"pixel_size": pixel_size or 1.0, "length_unit": unit or "px"})


def read_table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_probes_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "probes.toml"
    path.write_text(FILE)
    assert ddic.load_probes(path) == [
        ddic.PointProbe("A", (12.0, 20.5)), ddic.LineProbe("B", (10.0, 20.0), (50.0, 20.0), 10.0),
        ddic.StrainGauge("C", (40.0, 40.0), 20.0, angle=90.0), ddic.Extensometer("D", (10.0, 10.0), (10.0, 90.0))]


@pytest.mark.parametrize(("text", "message"), [
    ("", "holds no probe"),
    ("[point]\npoint = [1, 2]", r"\[point\]: give each probe a name, as in \[point.A\]"),
    ("[spot.A]\npoint = [1, 2]", "spot: unknown kind of probe; there are point, line, extensometer, gauge"),
    ("[point.A]\npoint = [1, 2]\nsize = 3", "point.A.size: unknown key; valid here: point"),
    ("[gauge.A]\ncentre = [1, 2]", "gauge.A.length: this key is missing"),
    ("[gauge.A]\ncentre = [1, 2]\nlength = 'long'", "gauge.A.length = 'long': expected a number"),
    ("[point.A]\npoint = [1]", r"point.A.point = \[1\]: expected \[x, y\]"),
    ("[gauge.A]\ncentre = [1, 2]\nlength = -1", "A: length = -1; a positive number"),
    ("[point.A]\npoint = [1, 2]\n[gauge.A]\ncentre = [1, 2]\nlength = 4", "A: a name of several probes"),
    ("[point.A", "not valid TOML"),
])
def test_bad_files_of_probes(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "probes.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=f"probes.toml: {message}"):
        ddic.load_probes(path)


def test_probes_of_the_command_line() -> None:
    assert parse_probe("gauge", "g", "1,2,30,45,10") == ddic.StrainGauge("g", (1, 2), 30, 10, 45)
    assert parse_probe("line", "l", "1,2,3,4,0.5") == ddic.LineProbe("l", (1, 2), (3, 4), 0.5)
    for kind, text in (("point", "1"), ("point", "1,x"), ("gauge", "1,2"), ("extensometer", "1,2,3,4,5"),
                       ("point", "1,inf")):
        with pytest.raises(InputError, match=f"--{kind} {text}: "):
            parse_probe(kind, "a", text)


def test_table_over_time_in_pixels(tmp_path: Path) -> None:
    probes, table = tmp_path / "probes.toml", tmp_path / "out.csv"
    probes.write_text(FILE)
    for name, time in (("late", 2.0), ("early", 1.0)):
        write_result(tmp_path / f"{name}.vtkhdf", time)
    files = [str(tmp_path / f"{name}.vtkhdf") for name in ("late", "early")]
    ran = CliRunner().invoke(probe, [*files, "--probes", str(probes), "--point", "500,500", "--csv", str(table)])
    assert ran.exit_code == 0, ran.output
    rows = read_table(table)
    # A point, 5 places of the line, a gauge, an extensometer and the point outside, at two times.
    assert [row["time"] for row in rows] == ["1"] * 9 + ["2"] * 9
    by_probe = {row["probe"]: row for row in rows[9:]}
    assert float(by_probe["D"]["strain_along [1]"]) == pytest.approx(0.02)
    assert float(by_probe["C"]["strain_yy [1]"]) == pytest.approx(0.02)
    assert float(by_probe["A"]["u_y [px]"]) == pytest.approx(0.02 * 20.5)
    assert by_probe["point 1"]["u_y [px]"] == ""
    assert by_probe["point 1"]["note"] == "1 of 1 places outside the mesh or in a hole"
    assert float(by_probe["C"]["indicator_strain [px^2]"]) == pytest.approx(
        float(by_probe["C"]["noise_strain [1]"]) * float(by_probe["C"]["resolution_strain [px]"])**2, rel=1e-6)
    assert "late.vtkhdf: point 1: 1 of 1 places outside the mesh or in a hole" in ran.output


def test_table_in_millimetres(tmp_path: Path) -> None:
    table, result = tmp_path / "out.csv", tmp_path / "r.vtkhdf"
    write_result(result, 1.0, pixel_size=0.5)
    arguments = [str(result), "--extensometer", "10,10,10,90", "--point", "20,40", "--csv", str(table)]
    assert CliRunner().invoke(probe, arguments).exit_code == 0
    point, ends = read_table(table)
    assert [float(point[f"{name} [mm]"]) for name in ("x", "y", "u_y", "noise_u")] == pytest.approx(
        [10.0, 20.0, 0.2, 0.005], rel=0.01)  # the noise: sums over waves
    assert float(ends["gauge_length [mm]"]) == 40.0
    assert float(ends["strain_along [1]"]) == pytest.approx(0.01)


@pytest.mark.parametrize(("arguments", "message"), [
    ([], "no probe: give --point"),
    (["--point", "1"], "--point 1: x,y expected, numbers in pixels"),
    (["--point", "1,1", "--csv", "nowhere/out.csv"], "the folder nowhere does not exist"),
    (["--probes", "absent.toml"], "absent.toml: cannot read this file of probes"),
])
def test_bad_input_is_one_line(tmp_path: Path, arguments: list[str], message: str) -> None:
    write_result(tmp_path / "r.vtkhdf", 1.0)
    ran = CliRunner().invoke(probe, [str(tmp_path / "r.vtkhdf"), *arguments])
    assert ran.exit_code == 2
    assert message in ran.output
    assert ran.output.count("\n") == 1


def test_results_of_several_pixel_sizes_are_refused(tmp_path: Path) -> None:
    write_result(tmp_path / "a.vtkhdf", 1.0)
    write_result(tmp_path / "b.vtkhdf", 2.0, pixel_size=0.5)
    ran = CliRunner().invoke(probe, [str(tmp_path / "a.vtkhdf"), str(tmp_path / "b.vtkhdf"), "--point", "1,1"])
    assert ran.exit_code == 2
    assert "several pixel sizes" in ran.output


finite = st.floats(-1e6, 1e6)
places = st.tuples(finite, finite)
sizes = st.floats(1e-3, 1e6)
names = st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=8)
ends = st.tuples(places, places).filter(lambda both: math.dist(*both) > 0)
any_probe = st.one_of(
    st.builds(ddic.PointProbe, names, places),
    st.builds(lambda name, both, share: ddic.LineProbe(name, *both, spacing=share * math.dist(*both)), names, ends,
              st.floats(1e-4, 10)),
    st.builds(lambda name, both: ddic.Extensometer(name, *both), names, ends),
    st.builds(ddic.StrainGauge, names, places, sizes, st.none() | sizes, finite))


@given(st.lists(any_probe, max_size=4, unique_by=lambda probe: probe.name))
def test_what_is_written_of_probes_is_read_as_they_are(probes: list[ddic.PointProbe]) -> None:
    """To the last bit, with any name."""
    assert sorted(parse_probes("\n".join(map(format_probe, probes)), Path("p")), key=repr) == sorted(probes, key=repr)


def test_probes_are_written_as_by_a_person() -> None:
    gauge = ddic.StrainGauge("above the hole", (1234.5678, 20.0), 30.0, angle=0.1)
    assert format_probe(gauge) == ('[gauge."above the hole"]\ncentre = [1234.5678, 20]\nlength = 30\nangle = 0.1\n')
    assert format_probe(ddic.LineProbe("B", (10.0, 20.05), (50.0, 20.0))) == (
        "[line.B]\nstart = [10, 20.05]\nend = [50, 20]\n")


def test_a_table_without_a_name_is_refused(tmp_path: Path) -> None:
    write_result(tmp_path / "r.vtkhdf", 1.0)
    ran = CliRunner().invoke(export, [str(tmp_path / "r.vtkhdf"), "--csv", ""])
    assert ran.exit_code == 2
    assert ran.output == "--csv: give the name of a table, results.csv for instance\n"


def test_whole_fields(tmp_path: Path) -> None:
    result = tmp_path / "r.vtkhdf"
    write_result(result, 1.0, pixel_size=0.5)
    ran = CliRunner().invoke(export, [str(result)])
    assert ran.exit_code == 0, ran.output
    nodes, cells = read_table(tmp_path / "r.nodes.csv"), read_table(tmp_path / "r.cells.csv")
    assert (len(nodes), len(cells)) == (121, 100)
    u = np.array([[float(row["x [px]"]), float(row["y [px]"]), float(row["displacement_y [px]"]),
                   float(row["displacement_physical_y [mm]"])] for row in nodes])
    np.testing.assert_allclose(u[:, 2], 0.01 * u[:, 1], atol=1e-9)  # 9 digits are written
    np.testing.assert_allclose(u[:, 3], 0.005 * u[:, 1], atol=1e-9)
    assert {"cell", "residual_rms [grey level]", "strain_infinitesimal_xy [1]"} <= set(cells[0])


def test_nothing_is_written_where_nothing_was_measured(tmp_path: Path, make_result: MakeResult) -> None:
    known: Callable[[Array], Array] = np.zeros_like
    result = make_result(known)
    result.point_data[schema.DISPLACEMENT][7] = np.nan
    nodes, _ = ddic.write_field_tables(tmp_path / "fields.csv", result)
    rows = read_table(nodes)
    assert rows[7]["displacement_x [px]"] == ""
    assert rows[8]["displacement_x [px]"] == "0"
