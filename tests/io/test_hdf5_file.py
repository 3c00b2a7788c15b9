"""HDF5 files are closed whatever the disk does, and the error is told."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from ddic.images.window import Window
from ddic.io.hdf5_file import ChunkGrid, new_hdf5, pack_chunk
from ddic.io.result_schema import sidecar_path
from ddic.io.result_writer import ResultWriter

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
    with new_hdf5(tmp_path / "new") as (file, _):
        _fill(file)
    with h5py.File(tmp_path / "other", "w") as file:
        _fill(file)
    with h5py.File(tmp_path / "new") as new, h5py.File(tmp_path / "other") as other:
        np.testing.assert_array_equal(new["chunked"], other["chunked"])
        for number in range(20):
            np.testing.assert_array_equal(new[f"group {number}/values"], other[f"group {number}/values"])


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.3, 0.5, 0.7, 0.9, 0.999])
def test_a_full_disk_is_told_and_the_file_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                    share: float) -> None:
    path = tmp_path / "new"
    with monkeypatch.context() as patch:
        count = _let_disk_take(patch, 1 << 40)
        with new_hdf5(path) as (file, _):
            _fill(file)
        whole = count()
    _let_disk_take(monkeypatch, int(share * whole))
    with pytest.raises(OSError, match="No space left") as caught, new_hdf5(path) as (file, _):
        _fill(file)
    assert caught.value.filename == str(path)
    # Nothing is left open, which the library would try to write when the process ends, and crash.
    assert h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE) == 0


def _write_result(path: Path) -> None:
    with ResultWriter(path) as writer:
        grid = ChunkGrid(700, 600)
        writer.create_residual_image(grid)
        for number in grid.find_chunks(Window.of_size(700, 600)):
            values = np.random.default_rng(number).normal(size=grid.shape).astype(np.float32)
            writer.write_residual_chunk(number, pack_chunk(values))
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
