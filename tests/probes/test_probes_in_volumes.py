"""Probes in volumes: what they read on fields that are known, how they are written, and their tables."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import meshio
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import ddic
from ddic.cli.tables import export, probe
from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.result_pieces import Piece
from ddic.io.result_reader import Result
from ddic.io.result_writer import ResultWriter
from ddic.mesh.cell_type import TET4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.probes.probes import KINDS, format_probe, list_samples, parse_probe, parse_probes
from probes.conftest import MakeResult
from support.random_meshes import WAYS

Array = NDArray[np.float64]
# Six strain components that are all different, xz and yz too, and a rotation.
GRADIENT = np.array([[0.004, -0.002, 0.007], [0.001, -0.003, 0.002], [0.005, -0.009, 0.006]])
SHIFT = np.array([1.3, -0.4, 2.2])
CENTRE = (41.3, 38.1, 35.7)


def box_mesh(cells: str = "Hex8", size: float = 8.0) -> Mesh:
    """A box of 80 x 72 x 64 voxels, of cubes or of six tetrahedra each."""
    mesh = GridLines(tuple(np.arange(0.0, side + size, size) for side in (80.0, 72.0, 64.0))).build_mesh()
    return mesh if cells == "Hex8" else build_mesh(mesh.nodes, {TET4: mesh.cells[:, WAYS].reshape(-1, 4)})


def linear(points: Array) -> Array:
    return np.asarray(SHIFT + points @ GRADIENT.T)


def six(tensor: Array) -> Array:
    """xx, yy, zz, xy, yz, xz."""
    return np.asarray(tensor[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]])


def stretch_along(direction: tuple[float, ...], gradient: Array = GRADIENT) -> float:
    e = np.array(direction) / np.linalg.norm(direction)
    return float(np.linalg.norm((np.eye(3) + gradient) @ e) - 1.0)


@pytest.mark.parametrize("cells", ["Hex8", "Tet4"])
@pytest.mark.parametrize("direction", [None, (0.0, 0.0, -2.0), (1.0, 2.0, -3.0)])
def test_gauge_is_exact_on_linear_fields_in_any_direction(make_result: MakeResult, cells: str,
                                                          direction: tuple[float, float, float] | None) -> None:
    gauge = ddic.StrainGauge("g", CENTRE, 20, width=11, direction=direction)
    reading = ddic.measure_probe(make_result(linear, mesh=box_mesh(cells)), gauge)
    # Rounding of sums over some thousand samples.
    np.testing.assert_allclose(reading.strain[0], six(0.5 * (GRADIENT + GRADIENT.T)), atol=1e-13)
    np.testing.assert_allclose(reading.displacement[0], linear(np.array([CENTRE]))[0], atol=1e-12)
    assert reading.along[0] == pytest.approx(stretch_along(direction or (1.0, 0.0, 0.0)), abs=1e-13)
    assert reading.note == ""


@pytest.mark.parametrize("cells", ["Hex8", "Tet4"])
@pytest.mark.parametrize("measure", ["infinitesimal", "green-lagrange", "hencky"])
def test_strain_tensors_of_all_probes(make_result: MakeResult, cells: str, measure: str) -> None:
    large = 8.0 * GRADIENT
    result = make_result(lambda points: points @ large.T, mesh=box_mesh(cells))
    deformation = np.eye(3) + large
    squares, axes = np.linalg.eigh(deformation.T @ deformation)
    expected = {"infinitesimal": 0.5 * (large + large.T),
                "green-lagrange": 0.5 * (deformation.T @ deformation - np.eye(3)),
                "hencky": (axes * (0.5 * np.log(squares))) @ axes.T}[measure]
    line = ddic.LineProbe("l", (11.0, 12.0, 13.0), (60.0, 50.0, 40.0), spacing=9.0)
    for one in (ddic.StrainGauge("g", CENTRE, 15), ddic.PointProbe("p", CENTRE), line):
        reading = ddic.measure_probe(result, one, measure)  # type: ignore[arg-type]
        # Rounding of the nodes' gradients.
        np.testing.assert_allclose(reading.strain, [six(expected)] * len(reading.points), atol=1e-12)
    assert reading.along == pytest.approx(stretch_along((49.0, 38.0, 27.0), large), abs=1e-12)
    np.testing.assert_allclose(reading.displacement, reading.points @ large.T, atol=1e-12)
    assert math.dist(*reading.points[[0, -1]]) == pytest.approx(line.length)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.9, -1.7, 2.1)])
def test_elongation_knows_no_rotation(make_result: MakeResult, vector: tuple[float, float, float]) -> None:
    stretch = Rotation.from_rotvec(vector).as_matrix() @ np.diag([1.0, 1.0, 1.013])
    result = make_result(lambda points: points @ (stretch - np.eye(3)).T, mesh=box_mesh())
    along_z = [ddic.Extensometer("e", (20.0, 33.0, 3.0), (20.0, 33.0, 61.0)),
               ddic.StrainGauge("g", CENTRE, 30, direction=(0.0, 0.0, 1.0)),
               ddic.LineProbe("l", (20.0, 40.0, 5.0), (20.0, 40.0, 50.0), spacing=7.0)]
    for one in along_z:
        assert ddic.measure_probe(result, one).along == pytest.approx(0.013, abs=1e-12)
    across = ddic.Extensometer("e", (20.0, 33.0, 3.0), (70.0, 51.0, 3.0))
    assert ddic.measure_probe(result, across).along[0] == pytest.approx(0.0, abs=1e-13)


def test_a_gauge_is_a_bar_of_square_section(make_result: MakeResult) -> None:
    result = make_result(linear, mesh=box_mesh())
    gauge = ddic.StrainGauge("g", CENTRE, 24, width=10, direction=(1.0, 2.0, -3.0))
    np.testing.assert_allclose(gauge.axes @ gauge.axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(gauge.axes) == pytest.approx(1.0)
    local = (list_samples(result, gauge) - CENTRE) @ gauge.axes.T
    # The middles of parts of a voxel.
    np.testing.assert_allclose(np.abs(local).max(axis=0), [11.5, 4.5, 4.5], atol=1e-12)
    np.testing.assert_allclose(local.mean(axis=0), 0.0, atol=1e-12)
    upright = ddic.StrainGauge("g", CENTRE, 24, direction=(0.0, 0.0, 5.0))
    np.testing.assert_array_equal(np.sort(np.abs(upright.axes), axis=1), [[0, 0, 1]] * 3)


def test_what_is_outside_or_was_not_measured_is_said(make_result: MakeResult) -> None:
    mesh = box_mesh()
    # A hole of a few cells, whose inner nodes have no strain.
    mesh = mesh.keep_cells(np.flatnonzero(np.abs(mesh.centroids - 36.0).max(axis=1) > 9.0))
    result = make_result(linear, mesh=mesh)
    reading = ddic.measure_probe(result, ddic.StrainGauge("g", (36.0, 36.0, 50.0), 20))
    assert np.isnan(reading.along).all()
    assert "places outside the mesh or in a hole" in reading.note
    whole = ddic.measure_probe(result, ddic.Extensometer("e", (36.0, 36.0, 10.0), (36.0, 36.0, 60.0)))
    assert whole.along[0] == pytest.approx(stretch_along((0.0, 0.0, 1.0)), abs=1e-13)


def test_probes_of_the_other_dimension_are_refused(make_result: MakeResult) -> None:
    volume, image = make_result(linear, mesh=box_mesh(size=16.0)), make_result(np.zeros_like)
    of_image = [ddic.PointProbe("A", (1.0, 2.0)), ddic.LineProbe("A", (1.0, 2.0), (3.0, 4.0)),
                ddic.StrainGauge("A", (30.0, 30.0), 10.0), ddic.Extensometer("A", (1.0, 2.0), (3.0, 4.0))]
    of_volume = [ddic.PointProbe("A", (1.0, 2.0, 3.0)), ddic.LineProbe("A", (1.0, 2.0, 3.0), (3.0, 4.0, 5.0)),
                 ddic.StrainGauge("A", CENTRE, 10.0), ddic.Extensometer("A", (1.0, 2.0, 3.0), (3.0, 4.0, 5.0))]
    uses = (ddic.measure_probe, ddic.estimate_metrology, lambda result, one: ddic.measure_probes([result], [one]))
    for result, others, dim, what in ((volume, of_image, 2, "a volume; give x, y and z"),
                                      (image, of_volume, 3, "an image; give x and y")):
        for one in others:
            message = f"^A: a {KINDS[type(one)]} of {dim} numbers a place, but known.vtkhdf is of {what}$"
            for use in uses:
                with pytest.raises(InputError, match=message):
                    use(result, one)


@pytest.mark.parametrize(("make", "text"), [
    (lambda: ddic.StrainGauge("g", CENTRE, 9, angle=30), "g: angle is of a gauge in the plane; give direction"),
    (lambda: ddic.StrainGauge("g", (1, 2), 9, direction=(1, 0)), "g: direction is of a gauge in a volume; give angle"),
    (lambda: ddic.StrainGauge("g", CENTRE, 9, direction=(0, 0, 0)), "g: direction = \\(0, 0, 0\\); give a vector"),
    (lambda: ddic.StrainGauge("g", CENTRE, 9, direction=(0, 1)), r"g: .*: \(x, y\) expected, or \(x, y, z\) in a vol"),
    (lambda: ddic.LineProbe("l", (1, 1, 1), (1, 1)), r"l: \(1, 1, 1\), \(1, 1\): \(x, y\) expected, or \(x, y, z\)"),
    (lambda: ddic.LineProbe("l", (1, 1, 1), (1, 1, 1)), r"l: both ends are \(1, 1, 1\)"),
    (lambda: ddic.PointProbe("p", (1, 2, 3, 4)), r"p: \(1, 2, 3, 4\): \(x, y\) expected"),
    (lambda: ddic.PointProbe("p", (1, 2, float("inf"))), "p: 1, 2, inf: finite numbers expected"),
])
def test_impossible_probes_are_refused(make, text: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=text):
        make()


def test_probes_of_the_command_line() -> None:
    assert parse_probe("point", "p", "1,2,3", 3) == ddic.PointProbe("p", (1, 2, 3))
    assert parse_probe("line", "l", "1,2,3,4,5,6,0.5", 3) == ddic.LineProbe("l", (1, 2, 3), (4, 5, 6), 0.5)
    assert parse_probe("extensometer", "e", "1,2,3,4,5,6", 3) == ddic.Extensometer("e", (1, 2, 3), (4, 5, 6))
    assert parse_probe("gauge", "g", "1,2,3,30", 3) == ddic.StrainGauge("g", (1, 2, 3), 30)
    assert parse_probe("gauge", "g", "1,2,3,30,0,0,1,8", 3) == ddic.StrainGauge("g", (1, 2, 3), 30, 8, 0, (0, 0, 1))
    for kind, text in (("point", "1,2"), ("gauge", "1,2,3"), ("gauge", "1,2,3,4,5"), ("gauge", "1,2,3,4,5,6"),
                       ("line", "1,2,3,4"), ("extensometer", "1,2,3,4,5,6,7"), ("point", "1,2,nan")):
        with pytest.raises(InputError, match=f"--{kind} {text}: .* expected of a volume, numbers in pixels"):
            parse_probe(kind, "a", text, 3)


def test_what_is_written_of_probes_is_read_as_they_are() -> None:
    probes = [ddic.PointProbe("A", (1.5, 2.0, 3.0)), ddic.LineProbe("B", (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.5),
              ddic.StrainGauge("C", CENTRE, 9.0, 4.0, direction=(1.0, 2.0, 3.0)),
              ddic.Extensometer("D", (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))]
    text = "\n".join(map(format_probe, probes))
    assert parse_probes(text, Path("p")) == probes
    assert "direction = [1, 2, 3]" in text
    with pytest.raises(InputError, match=r"p: gauge.A.direction = 3: expected \[x, y\], or \[x, y, z\] in a volume"):
        parse_probes("[gauge.A]\ncentre = [1, 2, 3]\nlength = 4\ndirection = 3", Path("p"))


def write_result(path: Path, result: Result, voxel_size: float | None = None) -> None:
    mesh, unit = result.mesh, None if voxel_size is None else "mm"
    u = result.point_data[schema.DISPLACEMENT]
    points = {**result.point_data, schema.DISPLACEMENT_MESH_UNITS: u}
    if voxel_size is not None:
        points[schema.DISPLACEMENT_PHYSICAL] = u * voxel_size
    of_cells = {spec.name: np.zeros((mesh.n_cells, spec.n_components)[:1 + (spec.n_components > 1)], spec.dtype)
                for spec in schema.cell_fields()}
    of_cells[schema.GLOBAL_CELL_ID] = np.arange(mesh.n_cells)
    of_cells[schema.RESIDUAL_RMS] = np.arange(mesh.n_cells, dtype=np.float64)
    nodal = [spec for spec in schema.nodal_strain_fields(3) if spec.name in points]
    with ResultWriter(path) as writer:
        writer.write_pieces([Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, points, of_cells)],
                            (*schema.point_fields(unit), *nodal), schema.cell_fields())
        writer.write_attributes(schema.TIME, {"reference": 0.0, "deformed": 3.0})
        writer.write_attributes(schema.CASE, {"noise_floor_px": 0.01})
        writer.write_attributes(schema.UNITS, {"pixel_size": voxel_size or 1.0, "length_unit": unit or "px"})


def read_table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_table_of_a_file_in_millimetres(tmp_path: Path, make_result: MakeResult) -> None:
    table, file = tmp_path / "out.csv", tmp_path / "r.vtkhdf"
    write_result(file, make_result(linear, mesh=box_mesh("Tet4", 16.0)), voxel_size=0.5)
    probes = ["--extensometer", "10,10,10,10,60,10", "--point", "20,30,40", "--gauge", "40,36,32,20,0,0,1"]
    ran = CliRunner().invoke(probe, [str(file), *probes, "--csv", str(table)])
    assert ran.exit_code == 0, ran.output
    point, gauge, ends = read_table(table)
    assert list(point) == [
        "time", "result", "probe", "kind", "distance [mm]", "x [mm]", "y [mm]", "z [mm]", "gauge_length [mm]",
        "u_x [mm]", "u_y [mm]", "u_z [mm]", "strain_xx [1]", "strain_yy [1]", "strain_zz [1]", "strain_xy [1]",
        "strain_yz [1]", "strain_xz [1]", "strain_along [1]", "noise_u [mm]", "resolution_u [mm]",
        "indicator_u [mm^2]", "noise_strain [1]", "resolution_strain [mm]", "indicator_strain [mm^2]", "note"]
    # 9 digits are written.
    read = [float(point[f"{name} [mm]"]) for name in ("x", "y", "z", "u_x", "u_y", "u_z")]
    np.testing.assert_allclose(read, [10, 15, 20, *0.5 * linear(np.array([[20.0, 30.0, 40.0]]))[0]], rtol=1e-8)
    for row in (point, gauge):
        strains = [float(row[f"strain_{name} [1]"]) for name in ("xx", "yy", "zz", "xy", "yz", "xz")]
        np.testing.assert_allclose(strains, six(0.5 * (GRADIENT + GRADIENT.T)), rtol=1e-8)
    assert float(gauge["strain_along [1]"]) == pytest.approx(stretch_along((0.0, 0.0, 1.0)))
    assert float(ends["strain_along [1]"]) == pytest.approx(stretch_along((0.0, 1.0, 0.0)))
    assert float(ends["gauge_length [mm]"]) == 25.0
    assert all(name in ran.output for name in ("u_z [mm]", "strain xx", "zz", "yz", "xz"))


def test_probes_of_an_image_on_a_file_of_a_volume(tmp_path: Path, make_result: MakeResult) -> None:
    file, probes = tmp_path / "r.vtkhdf", tmp_path / "probes.toml"
    write_result(file, make_result(linear, mesh=box_mesh(size=16.0)))
    probes.write_text("[point.A]\npoint = [1, 2]\n")
    for options, message in ((["--point", "1,2"], "--point 1,2: x,y,z expected of a volume, numbers in pixels\n"),
                             (["--probes", str(probes)],
                              "A: a point of 2 numbers a place, but r.vtkhdf is of a volume; give x, y and z\n")):
        ran = CliRunner().invoke(probe, [str(file), *options])
        assert (ran.exit_code, ran.output) == (2, message)


def test_whole_fields(tmp_path: Path, make_result: MakeResult) -> None:
    file = tmp_path / "r.vtkhdf"
    mesh = box_mesh(size=16.0)
    write_result(file, make_result(linear, mesh=mesh), voxel_size=0.5)
    ran = CliRunner().invoke(export, [str(file)])
    assert ran.exit_code == 0, ran.output
    nodes, cells = read_table(tmp_path / "r.nodes.csv"), read_table(tmp_path / "r.cells.csv")
    assert (len(nodes), len(cells)) == (mesh.n_nodes, mesh.n_cells)
    places = np.array([[float(row[f"{axis} [px]"]) for axis in "xyz"] for row in nodes])
    read = np.array([[float(row[f"displacement_{axis} [px]"]) for axis in "xyz"] for row in nodes])
    np.testing.assert_allclose(read, linear(places), rtol=1e-8)
    strains = [float(nodes[7][f"nodal_strain_infinitesimal_{name} [1]"]) for name in schema.COMPONENTS]
    np.testing.assert_allclose(strains, six(0.5 * (GRADIENT + GRADIENT.T)), rtol=1e-8)
    assert "strain_green_lagrange_xz [1]" in cells[0]


@pytest.mark.parametrize("cells", ["Hex8", "Tet4", "Q4"])
def test_fields_for_meshio(tmp_path: Path, make_result: MakeResult, cells: str) -> None:
    """Every digit, cells in their order; no tables unless they are asked for, and no foreign file is replaced."""
    file, vtu = tmp_path / "r.vtkhdf", tmp_path / "r.vtu"
    write_result(file, make_result(np.zeros_like) if cells == "Q4" else make_result(linear, mesh=box_mesh(cells, 16.0)))
    tables = ["--csv", str(tmp_path / "t.csv")]
    for options, written in (([], {"r.vtu"}), (tables, {"r.vtu", "t.nodes.csv", "t.cells.csv"})):
        ran = CliRunner().invoke(export, [str(file), "--vtu", str(vtu), *options])
        assert ran.exit_code == 0, ran.output
        assert {path.name for path in tmp_path.iterdir()} == {"r.vtkhdf", *written}
    result, raw = ddic.open(file), meshio.read(vtu)
    assert isinstance(result, Result)
    np.testing.assert_array_equal(raw.points[:, :result.mesh.dim], result.mesh.nodes)
    for name, values in result.point_data.items():
        np.testing.assert_array_equal(raw.point_data[name], values)
    for name, values in result.cell_data.items():
        np.testing.assert_array_equal(np.concatenate(raw.cell_data[name]), values)
    np.testing.assert_array_equal(np.concatenate([block.data.ravel() for block in raw.cells]), result.mesh.connectivity)
    vtu.write_text("of someone else")
    ran = CliRunner().invoke(export, [str(file), "--vtu", str(vtu)])
    assert ran.exit_code == 2
    assert "no VTU file that ddic wrote" in ran.output
