from __future__ import annotations

import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.io.image_chunks import CHUNK_SIDES, ChunkGrid, pack_chunk

SIDE = CHUNK_SIDES[2]


def noise() -> NDArray[np.float32]:
    return np.random.default_rng(0).normal(0.0, 2.0, (SIDE, SIDE)).astype(np.float32)


def half_missing() -> NDArray[np.float32]:
    values = noise()
    values[:, 100:] = np.nan
    return values


def grey_levels() -> NDArray[np.float32]:
    return np.round(noise())


def missing_here_and_there() -> NDArray[np.float32]:
    values = grey_levels()
    values[np.hypot(*np.mgrid[-100:SIDE - 100, -100:SIDE - 100]) < 60] = np.nan
    return values


def extremes() -> NDArray[np.float32]:
    """Values whose bytes are all there are: both zeros, infinities, the smallest numbers, NaN."""
    special = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-45, -1e38], np.float32)
    return np.resize(special, (SIDE, SIDE))


CHUNKS = {"noise": noise, "half missing": half_missing, "grey levels": grey_levels, "a hole": missing_here_and_there,
          "extremes": extremes, "constant": lambda: np.zeros((SIDE, SIDE), np.float32),
          "one pixel": lambda: np.ones((1, 1), np.float32)}


@pytest.mark.parametrize("name", CHUNKS)
def test_hdf5_reads_the_very_bytes_back(tmp_path: Path, name: str) -> None:
    chunk = CHUNKS[name]()
    with h5py.File(tmp_path / "c.h5", "w") as file:
        data = file.create_dataset("image", chunk.shape, "<f4", chunks=chunk.shape, compression="gzip",
                                   compression_opts=1, shuffle=True)
        data.id.write_direct_chunk((0, 0), pack_chunk(chunk))
    with h5py.File(tmp_path / "c.h5") as file:
        assert file["image"][...].tobytes() == chunk.tobytes()


def test_a_flipped_byte_does_not_pass() -> None:
    data = bytearray(pack_chunk(noise()))
    data[len(data) // 2] ^= 1
    with pytest.raises(zlib.error):
        zlib.decompress(bytes(data))


@pytest.mark.parametrize("name", ["noise", "half missing", "grey levels", "a hole", "constant"])
def test_chunks_are_no_larger_than_with_the_filters_themselves(tmp_path: Path, name: str) -> None:
    chunk = CHUNKS[name]()
    with h5py.File(tmp_path / "c.h5", "w") as file:
        data = file.create_dataset("image", data=chunk, chunks=chunk.shape, compression="gzip", compression_opts=1,
                                   shuffle=True)
        # 5 %: what coding by frequency alone may lose where there are some repetitions; elsewhere it gains.
        assert len(pack_chunk(chunk)) <= 1.05 * data.id.get_storage_size()


@given(width=st.integers(1, 1000), height=st.integers(1, 1000), data=st.data())
def test_chunks_under_a_window_are_those_that_hold_its_pixels(width: int, height: int, data: st.DataObject) -> None:
    grid = ChunkGrid(Window.of_size(width, height))
    x0, y0 = data.draw(st.integers(-50, width)), data.draw(st.integers(-50, height))
    window = Window((x0, y0), (x0 + data.draw(st.integers(0, 600)), y0 + data.draw(st.integers(0, 600))))
    n_chunks = -(-height // grid.shape[0]) * -(-width // grid.shape[1])
    seen = [n for n in range(n_chunks)
            if grid.locate_chunk(n).intersection(Window.of_size(width, height)).intersection(window).n_pixels]
    assert grid.find_chunks(window) == seen
    parts = [grid.locate_chunk(n).intersection(Window.of_size(width, height)) for n in range(n_chunks)]
    assert sum(part.n_pixels for part in parts) == width * height
