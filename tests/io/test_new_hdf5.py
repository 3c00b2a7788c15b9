"""New HDF5 files, filled by whoever has the values; closed whatever the disk does, and the error is told."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from ddic.images.window import Window
from ddic.io.image_chunks import ChunkGrid, pack_chunk
from ddic.io.new_hdf5 import Block, NewHdf5, new_hdf5, write_block
from ddic.io.result_schema import sidecar_path
from ddic.io.result_writer import ResultWriter
from support.residual_images import write_residual_image

SMALL = 2048
"""Bytes, less than HDF5 writes of any file with a dataset."""


def _let_disk_take(monkeypatch: pytest.MonkeyPatch, n_bytes: int) -> Callable[[], int]:
    """Have the disk refuse what is beyond some bytes, as systems do: a part is written first. Counts what it took."""
    write, taken = os.pwrite, [0]

    def pwrite(descriptor: int, data: bytes, offset: int) -> int:
        room = n_bytes - taken[0]
        if room <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = write(descriptor, memoryview(data)[:room], offset)
        taken[0] += written
        return written

    monkeypatch.setattr(os, "pwrite", pwrite)
    return lambda: taken[0]


def _fill(file: h5py.File) -> None:
    rng = np.random.default_rng(0)
    for number in range(20):
        file[f"group {number}/values"] = rng.normal(size=(200, 3))
    chunked = file.create_dataset("chunked", (512, 512), "f4", chunks=(64, 64), compression="gzip")
    chunked[...] = rng.normal(size=(512, 512))


def test_the_file_is_that_of_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "new").touch()
    _let_disk_take(monkeypatch, 1 << 40)
    with new_hdf5(tmp_path / "new") as new:
        _fill(new.file)
    with h5py.File(tmp_path / "other", "w") as file:
        _fill(file)
    with h5py.File(tmp_path / "new") as found, h5py.File(tmp_path / "other") as other:
        np.testing.assert_array_equal(found["chunked"], other["chunked"])
        for number in range(20):
            np.testing.assert_array_equal(found[f"group {number}/values"], other[f"group {number}/values"])


def _make_room(new: NewHdf5) -> list[Block]:
    """Make room among what the library writes itself, and tell what belongs there: rows, and chunks of an image."""
    rng = np.random.default_rng(1)
    new.file["before"] = rng.normal(size=1000)
    values = rng.normal(size=(5000, 3))
    _, rows = new.create_rows("rows", values.shape, np.float64)
    blocks = [rows.place_values(first, values[first:first + 1000]) for first in range(0, 5000, 1000)]
    image = new.file.create_dataset("image", (500, 600), "<f4", chunks=(256, 256), compression="gzip", shuffle=True)
    for number in range(6):
        window = ChunkGrid(Window.of_size(600, 500)).locate_chunk(number)
        data = pack_chunk(rng.normal(size=(256, 256)).astype(np.float32))
        blocks.append(Block(new.create_chunk(image, (window.y0, window.x0), len(data)), data))
        new.file[f"after chunk {number}"] = rng.normal(size=500)
    # An empty array has no place, and nothing is written of it.
    assert new.create_rows("empty", (0, 3), np.float64)[1].place == 0
    return blocks


def _read(file: h5py.File) -> dict[str, np.ndarray]:
    return {name: file[name][...] for name in file}


def test_what_others_write_is_what_the_library_reads(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "library", "w") as file:
        # The same numbers in the same order, written by the library.
        rng = np.random.default_rng(1)
        file["before"] = rng.normal(size=1000)
        file["rows"] = rng.normal(size=(5000, 3))
        image = file.create_dataset("image", (500, 600), "<f4", chunks=(256, 256), compression="gzip", shuffle=True)
        for number in range(6):
            window = ChunkGrid(Window.of_size(600, 500)).locate_chunk(number)
            values = rng.normal(size=(256, 256)).astype(np.float32)
            image[window.y0:window.y1, window.x0:window.x1] = values[:500 - window.y0, :600 - window.x0]
            file[f"after chunk {number}"] = rng.normal(size=500)
        file["empty"] = np.zeros((0, 3))
        expected = _read(file)
    with new_hdf5(tmp_path / "disk") as new:
        blocks = _make_room(new)
        # From outside the library, in another order and while it has the file open.
        with (tmp_path / "disk").open("r+b") as other:
            for block in blocks[::-1]:
                write_block(other.fileno(), block)
        new.file["last"] = np.arange(100_000)
    with new_hdf5(None) as new:
        for block in _make_room(new):
            new.write(block)
        new.file["last"] = np.arange(100_000)
        # While it is open, as a frame of a series is read.
        in_memory = _read(new.file)
        (tmp_path / "memory").write_bytes(new.get_content())
    expected["last"] = np.arange(100_000)
    for found in (in_memory, *(_read(h5py.File(tmp_path / name)) for name in ("disk", "memory"))):
        assert set(found) == set(expected)
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_no_more_and_no_other_rows_than_there_are(tmp_path: Path) -> None:
    with new_hdf5(None) as new:
        dataset, rows = new.create_rows("rows", (10, 3), np.float64)
        for first, shape in ((0, (11, 3)), (8, (3, 3)), (0, (5, 2)), (0, (5,))):
            with pytest.raises(ValueError, match="announced"):
                rows.place_values(first, np.zeros(shape))
        with pytest.raises(ValueError, match="at least 16"):
            new.create_chunk(dataset, (0, 0), 15)


def test_a_full_disk_is_told_to_whoever_writes_a_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "new"
    with new_hdf5(path) as new:
        blocks = _make_room(new)
        with monkeypatch.context() as patch:
            _let_disk_take(patch, len(blocks[0].data) * 8 * 3 + 100)
            new.write(blocks[0])
            with pytest.raises(OSError, match="No space left") as caught:
                new.write(blocks[1])
    assert caught.value.filename == str(path)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.3, 0.5, 0.7, 0.9, 0.999])
def test_a_full_disk_is_told_and_the_file_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                    share: float) -> None:
    path = tmp_path / "new"
    with monkeypatch.context() as patch:
        count = _let_disk_take(patch, 1 << 40)
        with new_hdf5(path) as new:
            _fill(new.file)
        whole = count()
    _let_disk_take(monkeypatch, int(share * whole))
    with pytest.raises(OSError, match="No space left") as caught, new_hdf5(path) as new:
        _fill(new.file)
    assert caught.value.filename == str(path)
    # Nothing is left open, which the library would try to write when the process ends, and crash.
    assert h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE) == 0


def _write_result(path: Path) -> None:
    grid = ChunkGrid(Window.of_size(700, 600))
    with ResultWriter(path) as writer:
        write_residual_image(writer, grid, {number: np.random.default_rng(number).normal(size=grid.shape)
                                            for number in grid.find_chunks(Window.of_size(700, 600))})
        writer.write_curves("curves", [np.arange(1000.0)])


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9, 0.99, 0.999])
def test_an_older_result_and_what_stands_beside_it_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                        share: float) -> None:
    path = tmp_path / "result.vtkhdf"
    with monkeypatch.context() as patch:
        count = _let_disk_take(patch, 1 << 40)
        _write_result(path)
        whole = count()
    path.write_text("older")
    sidecar_path(path).write_text("older")
    before = sorted(tmp_path.iterdir())
    # The last bytes are those of the file that shows the residual image.
    _let_disk_take(monkeypatch, int(share * whole) if share < 0.99 else whole - (SMALL if share < 0.999 else 1))
    with pytest.raises(OSError, match="No space left"):
        _write_result(path)
    assert sorted(tmp_path.iterdir()) == before
    assert path.read_text() == sidecar_path(path).read_text() == "older"
