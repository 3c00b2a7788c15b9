from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.window import Window
from ddic.io import result_schema as schema
from ddic.io.image_chunks import CHUNK_SIDES, ChunkGrid
from ddic.io.new_hdf5 import write_block
from ddic.io.result_pieces import NOTHING, Piece, add_counts, count_piece, join_pieces
from ddic.io.result_writer import ResultWriter
from support.cases import contents
from support.residual_images import write_residual_image

vtk = pytest.importorskip("vtk")
numpy_support = pytest.importorskip("vtk.util.numpy_support")

Write = Callable[..., Path]


def vtk_read(path: Path) -> Any:
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    errors: list[str] = []
    reader.AddObserver("ErrorEvent", lambda *_: errors.append("error"))
    reader.Update()
    assert errors == []
    return reader.GetOutputDataObject(0)


def array(data: Any, name: str) -> NDArray[np.float64]:
    return numpy_support.vtk_to_numpy(data.GetArray(name))


def test_vtk_reads_one_partition_per_subdomain(tmp_path: Path, write_result: Write, pieces: list[Piece]) -> None:
    output = vtk_read(write_result(tmp_path / "r.vtkhdf"))
    assert output.GetNumberOfPartitions() == 2
    for index, piece in enumerate(pieces):
        part = output.GetPartition(index)
        assert (part.GetNumberOfPoints(), part.GetNumberOfCells()) == (len(piece.points), len(piece.types))
        points = numpy_support.vtk_to_numpy(part.GetPoints().GetData())
        np.testing.assert_array_equal(points[:, :2], piece.points)
        assert not points[:, 2].any()
        for cell, kind in enumerate(piece.types):
            ids = part.GetCell(cell).GetPointIds()
            nodes = [ids.GetId(k) for k in range(ids.GetNumberOfIds())]
            assert nodes == piece.connectivity[piece.offsets[cell]:piece.offsets[cell + 1]].tolist()
            assert part.GetCellType(cell) == kind


def test_vtk_sees_vectors_of_three_and_tensors_of_six(tmp_path: Path, write_result: Write,
                                                     pieces: list[Piece]) -> None:
    output = vtk_read(write_result(tmp_path / "r.vtkhdf", length_unit="mm"))
    for index, piece in enumerate(pieces):
        part = output.GetPartition(index)
        u = array(part.GetPointData(), "displacement")
        np.testing.assert_array_equal(u, np.pad(piece.point_data["displacement"], ((0, 0), (0, 1))))
        np.testing.assert_array_equal(array(part.GetPointData(), "displacement_physical"), u * 0.02)
        strain = array(part.GetCellData(), "strain_infinitesimal")
        assert strain.shape == (len(piece.types), 6)
        np.testing.assert_array_equal(strain, piece.cell_data["strain_infinitesimal"])
        np.testing.assert_array_equal(array(part.GetCellData(), "SubdomainId"), index)
        assert array(part.GetPointData(), "GlobalNodeId").dtype == np.int64


def test_flip_mirrors_points_vectors_and_tensors(tmp_path: Path, write_result: Write,
                                                 pieces: list[Piece]) -> None:
    path = write_result(tmp_path / "r.vtkhdf", flip_y=True)
    with h5py.File(path) as file:
        assert file.attrs["y_axis"] == "up"
    part = vtk_read(path).GetPartition(0)
    points = numpy_support.vtk_to_numpy(part.GetPoints().GetData())
    np.testing.assert_array_equal(points[:, :2], pieces[0].points * [1, -1])
    np.testing.assert_array_equal(array(part.GetPointData(), "displacement")[:, :2],
                                  pieces[0].point_data["displacement"] * [1, -1])
    # Mirroring in y changes the sign of the components with exactly one y: XY and YZ.
    np.testing.assert_array_equal(array(part.GetCellData(), "strain_infinitesimal"),
                                  pieces[0].cell_data["strain_infinitesimal"] * [1, 1, 1, -1, -1, 1])


@pytest.mark.parametrize("flip_y", [False, True])
def test_vtk_reads_the_residual_as_image_data(tmp_path: Path, write_result: Write,
                                              residual: NDArray[np.float32], flip_y: bool) -> None:
    write_result(tmp_path / "r.vtkhdf", flip_y=flip_y)
    image = vtk_read(tmp_path / "r.residual.vtkhdf")
    height, width = residual.shape
    assert image.GetDimensions() == (width, height, 1)
    values = array(image.GetPointData(), "residual").reshape(height, width)
    np.testing.assert_array_equal(values, residual)
    assert image.GetPoint(2 * width + 5) == (5.0, -2.0 if flip_y else 2.0, 0.0)


def test_layout_of_the_file(tmp_path: Path, write_result: Write, pieces: list[Piece]) -> None:
    with h5py.File(write_result(tmp_path / "r.vtkhdf")) as file:
        kind = file["VTKHDF"].attrs.get_id("Type").get_type()
        assert not kind.is_variable_str()
        assert kind.get_cset() == h5py.h5t.CSET_ASCII
        assert list(file["VTKHDF"].attrs["Version"]) == [2, 0]
        assert file.attrs["ddic_schema"] == "1.11"
        assert file["VTKHDF/Offsets"].shape == (sum(len(p.types) + 1 for p in pieces),)
        assert file["VTKHDF/PointData/displacement"].attrs["unit"] == "px"
        image = file["residual_image/residual"]
        assert (image.compression, image.shuffle, image.compression_opts) == ("gzip", True, 1)
        assert image.dtype == np.float32
        # An attribute longer than 64 KiB, which the case's text may be.
        assert len(file["case"].attrs["toml"]) > 1 << 16


def test_residual_is_nan_where_no_chunk_was_written(tmp_path: Path) -> None:
    path, grid = tmp_path / "r.vtkhdf", ChunkGrid(Window.of_size(2 * CHUNK_SIDES[2] + 6, CHUNK_SIDES[2] + 5))
    with ResultWriter(path) as writer:
        # Whoever has them, they come in any order.
        write_residual_image(writer, grid, {number: np.full(grid.shape, number) for number in (5, 1)})
    with h5py.File(path) as file:
        image = file["residual_image/residual"][...]
    expected = np.full(grid.extent.shape, np.nan, np.float32)
    expected[:CHUNK_SIDES[2], CHUNK_SIDES[2]:2 * CHUNK_SIDES[2]] = 1
    expected[CHUNK_SIDES[2]:, 2 * CHUNK_SIDES[2]:] = 5
    np.testing.assert_array_equal(image, expected)


def test_pieces_are_placed_by_what_comes_before_whoever_writes_them(tmp_path: Path, pieces: list[Piece]) -> None:
    fields = schema.point_fields(None), schema.cell_fields()
    with ResultWriter(tmp_path / "all.vtkhdf") as writer:
        writer.write_pieces(pieces, *fields)
    counts = [count_piece(piece) for piece in pieces]
    with ResultWriter(tmp_path / "others.vtkhdf") as writer:
        layout = writer.create_mesh(add_counts(counts), *fields)
        assert writer.begun is not None
        # The last first, and past the library, as another process would.
        for k in (1, 0):
            with writer.begun.open("r+b") as other:
                for block in layout.place(add_counts(counts[:k]), counts[k:k + 1], pieces[k]):
                    write_block(other.fileno(), block)
    with ResultWriter(None) as writer:
        writer.write_pieces(pieces, *fields)
        (tmp_path / "memory.vtkhdf").write_bytes(writer.read_image())
    expected = contents(tmp_path / "all.vtkhdf")
    for other in ("others", "memory"):
        found = contents(tmp_path / f"{other}.vtkhdf")
        assert set(found) == set(expected)
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)


@contextmanager
def opened(path: Path, pieces: list[Piece]) -> Iterator[ResultWriter]:
    with ResultWriter(path) as writer:
        writer.write_pieces(pieces, schema.point_fields(None), schema.cell_fields())
        yield writer


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_exception_leaves_no_file_and_the_earlier_result_untouched(
        tmp_path: Path, pieces: list[Piece], error: type[BaseException]) -> None:
    path = tmp_path / "r.vtkhdf"
    path.write_text("earlier")

    def interrupted() -> None:
        with opened(path, pieces):
            assert len(list(tmp_path.iterdir())) == 2
            raise error

    with pytest.raises(error):
        interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["r.vtkhdf"]
    assert path.read_text() == "earlier"


def test_pieces_other_than_announced_are_refused_and_leave_no_file(tmp_path: Path, pieces: list[Piece]) -> None:
    first = pieces[0]
    short = {name: values[:-1] for name, values in first.cell_data.items()}
    fewer = {name: values for name, values in first.cell_data.items() if name != schema.DOUBTFUL}
    spoilt = (replace(first, cell_data=short), replace(first, cell_data=fewer), replace(first, types=first.types[1:]))
    for bad in spoilt:
        with pytest.raises(ValueError, match="announced"), opened(tmp_path / "r.vtkhdf", [bad, pieces[1]]):
            pass
        assert list(tmp_path.iterdir()) == []


def test_pieces_behind_the_end_are_refused(tmp_path: Path, pieces: list[Piece]) -> None:
    counts = [count_piece(piece) for piece in pieces]
    with ResultWriter(tmp_path / "r.vtkhdf") as writer:
        layout = writer.create_mesh(add_counts(counts[:1]), schema.point_fields(None), schema.cell_fields())
        with pytest.raises(ValueError, match="announced"):
            layout.place(NOTHING, counts, join_pieces(pieces))


def test_a_stale_residual_image_file_goes_with_the_run_that_has_none(tmp_path: Path, write_result: Write) -> None:
    write_result(tmp_path / "r.vtkhdf")
    assert (tmp_path / "r.residual.vtkhdf").exists()
    write_result(tmp_path / "r.vtkhdf", residual=False)
    assert [p.name for p in tmp_path.iterdir()] == ["r.vtkhdf"]


def test_a_folder_that_does_not_exist_is_an_input_error(tmp_path: Path, pieces: list[Piece]) -> None:
    with pytest.raises(InputError, match="nowhere"), opened(tmp_path / "nowhere" / "r.vtkhdf", pieces):
        pass
