from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.result_reader import displacement_at, read_result
from ddic.io.result_schema import flip_components
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
