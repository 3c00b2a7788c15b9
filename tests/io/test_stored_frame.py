"""A frame in the pieces of another one: the same values at the same nodes and cells, or the frame as it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from ddic.io import result_schema as schema
from ddic.io.series_reader import read_series
from ddic.io.series_writer import StoredFrame, has_same_geometry, partition_like, read_stored_frame
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from support.series_files import MESH, FrameFile, write_series_file


def read_frame(path: Path, frame: FrameFile) -> StoredFrame:
    """A frame in the pieces in which it is written."""
    series = write_series_file(path, [frame])
    with h5py.File(series, "r") as file:
        return read_stored_frame(file)


def test_values_stay_at_their_nodes_and_cells(tmp_path: Path) -> None:
    frame, other = (read_frame(tmp_path / f"{n}.vtkhdf", FrameFile(2.0, n)) for n in (3, 2))
    arranged = partition_like(frame, other)
    assert has_same_geometry(arranged, other)
    nodes, cells = (arranged.point_data[schema.GLOBAL_NODE_ID], arranged.cell_data[schema.GLOBAL_CELL_ID])
    np.testing.assert_array_equal(nodes, other.point_data[schema.GLOBAL_NODE_ID])
    np.testing.assert_array_equal(cells, other.cell_data[schema.GLOBAL_CELL_ID])
    # Both frames show the same time: only the pieces in which they are written differ, and what tells of these.
    for name, values in other.point_data.items():
        np.testing.assert_array_equal(arranged.point_data[name], values, err_msg=name)
    for name, values in other.cell_data.items():
        if name != schema.SUBDOMAIN_ID:
            np.testing.assert_array_equal(arranged.cell_data[name], values, err_msg=name)
    part_of = dict(zip(frame.cell_data[schema.GLOBAL_CELL_ID], frame.cell_data[schema.SUBDOMAIN_ID], strict=True))
    assert [part_of[cell] for cell in cells] == arranged.cell_data[schema.SUBDOMAIN_ID].tolist()
    assert set(part_of.values()) == {0, 1, 2}


def _move_a_node() -> Mesh:
    nodes = MESH.nodes.copy()
    nodes[-1] += 1e-6
    return replace(MESH, nodes=nodes)


def _turn_a_cell() -> Mesh:
    connectivity = MESH.connectivity.copy()
    connectivity[:4] = np.roll(connectivity[:4], 1)
    return replace(MESH, connectivity=connectivity)


@pytest.mark.parametrize("mesh", [_move_a_node(), _turn_a_cell(), build_structured_mesh((10.0, 10.0, 50.0, 30.0), 5.0)],
                         ids=["a node elsewhere", "a cell begins elsewhere", "other numbers"])
def test_another_mesh_keeps_its_pieces(tmp_path: Path, mesh: Mesh) -> None:
    frame = read_frame(tmp_path / "frame.vtkhdf", FrameFile(2.0, 3, mesh))
    other = read_frame(tmp_path / "other.vtkhdf", FrameFile(2.0, 2))
    assert partition_like(frame, other) is frame


def test_a_series_of_one_mesh_holds_its_geometry_once(tmp_path: Path) -> None:
    mixed = write_series_file(tmp_path / "mixed.vtkhdf", [FrameFile(1.0, 2), FrameFile(2.0, 3), FrameFile(3.0, 1)])
    alike = write_series_file(tmp_path / "alike.vtkhdf", [FrameFile(1.0, 2), FrameFile(2.0, 2), FrameFile(3.0, 2)])
    with h5py.File(mixed, "r") as file, h5py.File(alike, "r") as expected:
        for name in ("Points", "Types", "Connectivity", "NumberOfPoints", "Steps/NumberOfParts"):
            np.testing.assert_array_equal(file["VTKHDF"][name], expected["VTKHDF"][name])
    for frame, other in zip(read_series(mixed), read_series(alike), strict=True):
        np.testing.assert_array_equal(frame.displacement, other.displacement)
        np.testing.assert_array_equal(frame.cell_data[schema.RESIDUAL_RMS], other.cell_data[schema.RESIDUAL_RMS])
    assert [frame.n_subdomains for frame in read_series(mixed)] == [2, 3, 1]


@pytest.mark.parametrize("estimated", [(1, 3), (2,), (3,), (1, 2)])
def test_a_field_that_a_frame_does_not_have_is_unknown_there(tmp_path: Path, estimated: tuple[int, ...]) -> None:
    path = write_series_file(tmp_path / "all.vtkhdf", [FrameFile(float(k)) for k in range(3)], estimated=estimated)
    for number, frame in enumerate(read_series(path), start=1):
        expected = float(number) if number in estimated else np.nan
        np.testing.assert_array_equal(frame.point_data["sigma_u"], np.full(frame.mesh.n_nodes, expected))
