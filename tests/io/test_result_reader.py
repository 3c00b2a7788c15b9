from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.cli.info import info
from ddic.cli.plot import plot
from ddic.errors import InputError
from ddic.io.result_reader import displacement_at, read_result, require_known_displacement
from ddic.io.result_schema import flip_components
from ddic.io.series_reader import is_series_file
from ddic.mesh.mesh import Mesh

Write = Callable[..., Path]
Field = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@pytest.mark.parametrize("flip_y", [False, True])
def test_the_whole_mesh_and_field_come_back(tmp_path: Path, write_result: Write, mesh: Mesh, field: Field,
                                            residual: NDArray[np.float32], flip_y: bool) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf", flip_y=flip_y))
    np.testing.assert_array_equal(result.mesh.nodes, mesh.nodes)
    np.testing.assert_array_equal(result.mesh.connectivity, mesh.connectivity)
    np.testing.assert_array_equal(result.mesh.offsets, mesh.offsets)
    np.testing.assert_array_equal(result.mesh.types, mesh.types)
    np.testing.assert_array_equal(result.displacement, field(mesh.nodes))
    cells = np.arange(mesh.n_cells)
    np.testing.assert_array_equal(result.cell_data["residual_rms"], 1.0 + cells)
    np.testing.assert_array_equal(result.cell_data["strain_infinitesimal"], np.arange(6.0) + cells[:, None])
    np.testing.assert_array_equal(result.subdomain_ids, mesh.centroids[:, 0] > 25)
    np.testing.assert_array_equal(result.residual_image, residual)
    assert result.flipped is flip_y


def test_histories_and_attributes_come_back(tmp_path: Path, write_result: Write) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf", reference="f.tif", residual=False))
    np.testing.assert_array_equal(result.gauss_newton["residual_std_grey"], [3.0, 2.5])
    assert [h.tolist() for h in result.krylov] == [[1.0, 0.1, 0.001], [1.0, 1e-4]]
    assert result.attributes["provenance"]["reference_path"] == "f.tif"
    assert result.attributes["case"]["toml"].startswith("title = 'é'")
    assert result.residual_image is None
    assert result.n_subdomains == 2


def test_displacement_is_exact_at_the_nodes_in_any_order(tmp_path: Path, write_result: Write, mesh: Mesh,
                                                         field: Field) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf"))
    points = mesh.nodes[::-1]
    np.testing.assert_array_equal(displacement_at(result, points), field(points))


def test_displacement_between_nodes_is_interpolated_and_outside_the_nearest(
        tmp_path: Path, write_result: Write, mesh: Mesh, field: Field) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf"))
    inside = np.array([[11.0, 12.5], [33.0, 30.1]])
    # Linear interpolation on triangles with legs h = 10: error <= (|u_xx| + |u_yy|) h^2 / 8 < 0.06 px here.
    np.testing.assert_allclose(displacement_at(result, inside), field(inside), atol=0.06)
    outside = np.array([[-100.0, 7.0]])
    np.testing.assert_array_equal(displacement_at(result, outside), field(mesh.nodes[:1]))


def test_fields_are_arrays_by_name(tmp_path: Path, write_result: Write, mesh: Mesh, field: Field) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf"))
    np.testing.assert_array_equal(result.fields["displacement"], field(mesh.nodes))
    assert result.fields["strain_infinitesimal"].shape == (mesh.n_cells, 6)
    assert result.fields["residual_rms"].shape == (mesh.n_cells,)
    assert set(result.fields) == {*result.point_data, *result.cell_data}


@pytest.mark.parametrize("flip_y", [False, True])
def test_displacement_at_points_is_that_of_the_shape_functions(tmp_path: Path, write_result: Write, mesh: Mesh,
                                                               field: Field, flip_y: bool) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf", flip_y=flip_y))
    np.testing.assert_allclose(result.at(mesh.nodes), field(mesh.nodes), rtol=0, atol=1e-12)
    # The middle of a Q4, and of a T3: means of the nodes'.
    quad = mesh.cells[0]
    triangle = next(cell[:3] for cell in mesh.cells if cell[3] < 0)
    middles = np.array([mesh.nodes[quad].mean(axis=0), mesh.nodes[triangle].mean(axis=0)])
    expected = [field(mesh.nodes[quad]).mean(axis=0), field(mesh.nodes[triangle]).mean(axis=0)]
    np.testing.assert_allclose(result.at(middles), expected, rtol=0, atol=1e-12)


def test_there_is_no_displacement_outside_the_mesh_and_in_its_holes(tmp_path: Path, write_result: Write) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf"))
    inner = np.flatnonzero((np.abs(result.mesh.centroids - (20.0, 22.0)) < 1).all(axis=1))
    assert len(inner) == 1
    kept = np.delete(np.arange(result.mesh.n_cells), inner)
    holed, nodes = result.mesh.create_submesh(kept)
    result = dataclasses.replace(result, mesh=holed, displacement=result.displacement[nodes])
    found = result.at(np.array([[20.0, 22.0], [-3.0, 8.0], [10.0, 12.0]]))
    np.testing.assert_array_equal(np.isnan(found), [[True, True], [True, True], [False, False]])


def test_meshio_gets_the_mesh_and_all_fields(tmp_path: Path, write_result: Write, mesh: Mesh) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf"))
    result.to_meshio().write(tmp_path / "r.vtu")
    back = meshio.read(tmp_path / "r.vtu")
    np.testing.assert_array_equal(back.points[:, :2], mesh.nodes)
    assert {block.type: len(block.data) for block in back.cells} == {"quad": 9, "triangle": 6}
    np.testing.assert_array_equal(back.point_data["displacement"], result.point_data["displacement"])
    for block, numbers, strain in zip(back.cells, back.cell_data["GlobalCellId"],
                                      back.cell_data["strain_infinitesimal"], strict=True):
        np.testing.assert_array_equal(block.data, mesh.cells[numbers][:, :block.data.shape[1]])
        np.testing.assert_array_equal(strain, result.cell_data["strain_infinitesimal"][numbers])
    assert set(back.point_data) | set(back.cell_data) == set(result.fields)


def test_pyvista_gets_the_mesh_and_all_fields(tmp_path: Path, write_result: Write, mesh: Mesh) -> None:
    pytest.importorskip("pyvista")
    result = read_result(write_result(tmp_path / "r.vtkhdf"))
    grid = result.to_pyvista()
    np.testing.assert_array_equal(grid.points[:, :2], mesh.nodes)
    np.testing.assert_array_equal(grid.celltypes, mesh.types)
    np.testing.assert_array_equal(grid.cell_connectivity, mesh.connectivity)
    np.testing.assert_allclose(grid.cell_centers().points[:, :2], mesh.centroids, rtol=0, atol=1e-12)
    for name, values in {**result.point_data, **result.cell_data}.items():
        np.testing.assert_array_equal(grid[name], values)


def test_a_missing_pyvista_is_named_with_its_remedy(tmp_path: Path, write_result: Write,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    result = read_result(write_result(tmp_path / "r.vtkhdf"))
    # None makes ``import pyvista`` fail.
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(InputError, match="pip install pyvista"):
        result.to_pyvista()


@given(st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6))
def test_flipping_a_tensor_is_the_change_of_axes_and_its_own_inverse(values: list[float]) -> None:
    tensor = np.array([values])
    xx, yy, zz, xy, yz, xz = values
    full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mirror = np.diag([1.0, -1.0, 1.0])
    expected = mirror @ full @ mirror
    flipped = flip_components(tensor)[0]
    np.testing.assert_array_equal(flipped, expected[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]])
    np.testing.assert_array_equal(flip_components(flip_components(tensor)), tensor)


@pytest.mark.parametrize("version", ["1.3", "1.4"])
def test_displacement_in_the_meshs_axes_is_read_as_its_schema_wrote_it(tmp_path: Path, write_result: Write,
                                                                       version: str) -> None:
    name = "displacement_mesh_units"
    expected = read_result(write_result(tmp_path / "down.vtkhdf")).point_data[name]
    path = write_result(tmp_path / "up.vtkhdf", flip_y=True)
    if version == "1.3":
        # It had no such attribute, and turned this field over with the others.
        with h5py.File(path, "r+") as file:
            file.attrs["ddic_schema"] = version
            for group in ("PointData", "CellData"):
                for field in file["VTKHDF"][group].values():
                    del field.attrs["axes"]
            values = file["VTKHDF/PointData"][name][...]
            values[:, 1] *= -1
            file["VTKHDF/PointData"][name][...] = values
    np.testing.assert_array_equal(read_result(path).point_data[name], expected)


def test_missing_foreign_sidecar_and_newer_files_are_input_errors(tmp_path: Path, write_result: Write) -> None:
    (tmp_path / "text.vtkhdf").write_text("no HDF5")
    with h5py.File(tmp_path / "foreign.vtkhdf", "w") as file:
        file.create_group("VTKHDF")
    write_result(tmp_path / "r.vtkhdf")
    for name in ("missing.vtkhdf", "text.vtkhdf", "foreign.vtkhdf", "r.residual.vtkhdf"):
        with pytest.raises(InputError, match=name):
            read_result(tmp_path / name)
    with h5py.File(tmp_path / "r.vtkhdf", "r+") as file:
        file.attrs["ddic_schema"] = "2.0"
    with pytest.raises(InputError, match=r"schema 2\.0"):
        read_result(tmp_path / "r.vtkhdf")


def test_a_file_cut_short_is_an_input_error(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(InputError, match=r"r\.vtkhdf"):
        read_result(path)


def _remove_node_numbers(file: h5py.File) -> None:
    del file["VTKHDF/PointData/GlobalNodeId"]


def _lead_to_no_node(file: h5py.File) -> None:
    file["VTKHDF/Connectivity"][0] = -1


def _shift_cells(file: h5py.File) -> None:
    file["VTKHDF/Offsets"][1] = 3


def _lose_points(file: h5py.File) -> None:
    points = file["VTKHDF/Points"][...]
    del file["VTKHDF/Points"]
    file["VTKHDF/Points"] = points[:-1]


def _move_a_node_away(file: h5py.File) -> None:
    file["VTKHDF/Points"][0] = 1e300


def _displace_without_end(file: h5py.File) -> None:
    file["VTKHDF/PointData/displacement"][0] = np.inf


def _write_words(file: h5py.File) -> None:
    del file["VTKHDF/PointData/displacement"]
    file["VTKHDF/PointData/displacement"] = ["a", "b"]


def _claim_gigabytes(file: h5py.File) -> None:
    # 80 GB of which nothing was written.
    del file["VTKHDF/Points"]
    file.create_dataset("VTKHDF/Points", (10**10,), "f8", chunks=(1000,))


def _break_the_case(file: h5py.File) -> None:
    file["case"].attrs["json"] = '{"title": "'


@pytest.mark.parametrize("damage", [
    _remove_node_numbers, _lead_to_no_node, _shift_cells, _lose_points, _move_a_node_away, _displace_without_end,
    _write_words, _claim_gigabytes, _break_the_case])
def test_a_result_that_is_not_of_one_piece_is_refused_in_a_line(tmp_path: Path, write_result: Write,
                                                                damage: Callable[[h5py.File], None]) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(InputError) as refused:
        read_result(path)
    assert len(refused.value.problems) == 1
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("place", "damage", "said"), [
    ("VTKHDF/Points", np.zeros_like, "cells are flat, crossed or not convex"),
    ("VTKHDF/PointData/displacement", lambda old: old[:, :2], "rows of 3 numbers expected"),
    ("VTKHDF/CellData/SubdomainId", lambda old: old[:, None], "rows of 1 numbers expected"),
    ("VTKHDF/CellData/SubdomainId", lambda old: old + 1000, "fewer than cells"),
    ("history/krylov/0000", lambda old: np.full(len(old), b"word"), "history/krylov/0000: an array of"),
    ("history/krylov/0000", lambda old: 1.0, "history/krylov/0000: an array of float64, shape ()"),
    ("history/gauss_newton/residual_std_grey", lambda old: old[:1], "columns of different lengths"),
    ("residual_image/residual", lambda old: old[0], "rows of numbers expected"),
    # That of a volume, where the mesh is plane.
    ("residual_image/residual", lambda old: old[None], "rows of numbers expected")])
def test_arrays_of_other_shapes_are_told_when_they_are_read(tmp_path: Path, write_result: Write, place: str,
                                                            damage: Callable[[Any], Any], said: str) -> None:
    # Each was a traceback in plot, info, report, export, or a run that started from it.
    path = write_result(tmp_path / "r.vtkhdf")
    with h5py.File(path, "r+") as file:
        old = file[place][...]
        del file[place]
        file[place] = damage(old)
    told = CliRunner().invoke(info, [str(path)])
    assert told.exit_code == 2
    assert len(told.stderr.splitlines()) == 1
    assert said in told.stderr


@pytest.mark.parametrize(("group", "name", "value"), [
    ("case", "half_amplitude_shear_px", "a b"), ("case", "half_amplitude_shear_px", 1e308),
    ("case", "json", "[1, 2]"), ("case", "json", '{"regularization": "a"}'), ("units", "pixel_size", "a"),
    ("time", "deformed", np.arange(3.0)), ("provenance", "reference_path", np.arange(3.0))])
def test_attributes_of_another_kind_are_told_when_they_are_read(tmp_path: Path, write_result: Write, group: str,
                                                                name: str, value: object) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    with h5py.File(path, "r+") as file:
        file.require_group(group).attrs[name] = value
    with pytest.raises(InputError, match="not a readable ddic result file"):
        read_result(path)


def test_a_damaged_residual_image_is_an_input_error(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    with h5py.File(path, "r+") as file:
        begin, length = file["residual_image/residual"].id.get_chunk_info(0)[2:]
    content = bytearray(path.read_bytes())
    content[begin:begin + length] = bytes(length)
    path.write_bytes(content)
    result = read_result(path)
    with pytest.raises(InputError, match=r"r\.vtkhdf"):
        _ = result.residual_image


def test_a_start_from_a_result_with_numbers_lost_is_refused(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    with h5py.File(path, "r+") as file:
        file["VTKHDF/CellData/residual_n_pixels"][...] = 100
        file["VTKHDF/CellData/excluded"][...] = 0
    require_known_displacement(read_result(path))
    with h5py.File(path, "r+") as file:
        file["VTKHDF/PointData/displacement"][3] = np.nan
    with pytest.raises(InputError, match="1 nodes of cells that were measured have no displacement"):
        require_known_displacement(read_result(path))
    with h5py.File(path, "r+") as file:
        file["VTKHDF/PointData/displacement"][...] = np.nan
    with pytest.raises(InputError, match="no displacement of any node"):
        require_known_displacement(read_result(path))


def test_a_damaged_series_is_read_as_a_line_and_not_as_an_error_of_the_folder(tmp_path: Path,
                                                                              write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    path.write_bytes(path.read_bytes()[:5000])
    assert not is_series_file(path)
    for command in (info, plot):
        outcome = CliRunner().invoke(command, [str(path)])
        assert outcome.exit_code == 2
        assert "not a readable ddic result file" in outcome.stderr
        assert len(outcome.stderr.splitlines()) == 1


@pytest.mark.parametrize(("group", "columns", "reason"), [
    ("history/gauss_newton", {"iteration": [1, 2]}, "no column residual_std_grey"),
    ("history/gauss_newton", {"iteration": [1], "residual_std_grey": [1e308]}, "larger than any grey level"),
    ("history/phases", {"seconds": [1.0]}, "no column phase"),
])
def test_a_table_without_what_others_read_of_it_is_damaged(tmp_path: Path, write_result: Write, group: str,
                                                           columns: dict[str, list[float]], reason: str) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    with h5py.File(path, "r+") as file:
        if group in file:
            del file[group]
        for name, values in columns.items():
            file[f"{group}/{name}"] = values
    with pytest.raises(InputError, match=reason):
        read_result(path)


def test_another_schema_is_told_in_a_line_whatever_it_is(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    with h5py.File(path, "r+") as file:
        file.attrs["ddic_schema"] = "a\nb"
    with pytest.raises(InputError, match=r"schema a b, this program reads") as refused:
        read_result(path)
    assert "\n" not in str(refused.value)
