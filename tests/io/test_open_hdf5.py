"""A damaged HDF5 file holds no reader for ever; a good one is opened as it is."""

from __future__ import annotations

import mmap
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from ddic.cli.info import info
from ddic.errors import InputError
from ddic.io import hdf5_file
from ddic.io.hdf5_file import open_hdf5, read_array
from support.commands import ddic

HEAP = b"GCOL"
"""Begins a collection of texts of variable length."""


def _write(path: Path, values: np.ndarray, **options: object) -> Path:
    with h5py.File(path, "w") as file:
        file.attrs["title"] = "a text of variable length"
        file.create_dataset("values", data=values, **options)
        file["values"].attrs["unit"] = "px"
    return path


def _overwrite(path: Path, place: int, n_bytes: int) -> None:
    content = bytearray(path.read_bytes())
    content[place:place + n_bytes] = bytes(len(content[place:place + n_bytes]))
    path.write_bytes(content)


# What is zero from the first object's header on, or only from within its text on.
@pytest.mark.parametrize("behind", [16, 40])
def test_zeros_in_a_heap_are_found(tmp_path: Path, behind: int) -> None:
    path = _write(tmp_path / "a.h5", np.arange(5000.0))
    _overwrite(path, path.read_bytes().index(HEAP) + behind, 3000)
    with pytest.raises(InputError, match="damaged: a part of it was overwritten"):
        open_hdf5(path)


def test_a_command_says_so(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.vtkhdf", np.arange(5000.0))
    _overwrite(path, path.read_bytes().index(HEAP) + 16, 3000)
    job = ddic("info", path)
    assert job.code == 2
    assert len(job.errors) == 1
    assert job.errors[0].startswith(f"{path}: damaged")


def test_a_command_says_so_of_a_file_that_cannot_be_looked_through(tmp_path: Path) -> None:
    # What holds the names of a group is damaged: h5py raises a RuntimeError where one is looked for.
    path = _write(tmp_path / "a.h5", np.arange(5000.0))
    _overwrite(path, path.read_bytes().index(b"HEAP") + 4, 16)
    told = CliRunner().invoke(info, [str(path)])
    assert told.exit_code == 2
    assert len(told.stderr.splitlines()) == 1
    assert str(path) in told.stderr


@pytest.mark.parametrize("options", [{}, {"chunks": (512,)}, {"chunks": (512,), "compression": "gzip"}])
def test_a_good_file_is_opened(tmp_path: Path, options: dict[str, object]) -> None:
    # Values that look like a collection with an object of no size: they are no part of the file's structure.
    fake = HEAP + b"\1\0\0\0" + (4096).to_bytes(8, "little") + bytes(4080)
    values = np.frombuffer(fake * 8)
    path = _write(tmp_path / "a.h5", values, **options)
    with open_hdf5(path) as file:
        np.testing.assert_array_equal(file["values"][...], values)
        assert file.attrs["title"] == "a text of variable length"


def test_nothing_beyond_a_file_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[tuple[int, int]] = []

    class Content(mmap.mmap):
        def find(self, sub: bytes, begin: int, end: int) -> int:
            searched.append((end, len(self)))
            return super().find(sub, begin, end)

    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.attrs["title"] = "no array, which would not be searched"
    monkeypatch.setattr(hdf5_file.mmap, "mmap", Content)
    open_hdf5(path).close()
    # Python before 3.11.5 reads one byte more than it is asked to search.
    size = path.stat().st_size
    assert set(searched) == {(size - 1, size)}


def test_what_cannot_be_listed_is_damaged(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.h5", np.arange(5000.0))
    _overwrite(path, path.read_bytes().index(b"SNOD"), 100)
    with pytest.raises(InputError, match="damaged"):
        open_hdf5(path)


def test_a_part_is_read_of_what_is_nearly_empty_and_the_whole_of_what_is_damaged_is_not(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "sparse.h5", "w") as file:
        sparse = file.create_dataset("residual", (2048, 2048, 2048), np.float32, chunks=(64,) * 3, compression="gzip",
                                     fillvalue=np.nan)
        sparse[64:128, 64:128, 64:128] = 1.0
    with h5py.File(tmp_path / "sparse.h5") as file:
        plane = read_array(file["residual"], (slice(100, 101), slice(0, 128), slice(0, 128)))
        assert np.isnan(plane[0, :64]).all()
        assert (plane[0, 64:, 64:] == 1.0).all()
        # 34 GB beside a chunk of a few hundred bytes.
        with pytest.raises(ValueError, match=f"claims {4 * 2048**3} bytes"):
            read_array(file["residual"])
