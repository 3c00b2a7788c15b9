"""Residual images written by one process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.io.image_chunks import ChunkGrid, pack_chunk
from ddic.io.new_hdf5 import Block
from ddic.io.result_writer import ResultWriter


def write_residual_image(writer: ResultWriter, grid: ChunkGrid, chunks: Mapping[int, NDArray[Any]]) -> None:
    """Write the next camera's residual image, of which these chunks are there, by number."""
    packed = [pack_chunk(values.astype(np.float32)) for values in chunks.values()]
    numbers = np.array(list(chunks), np.int64)
    places = writer.create_residual_image(grid, numbers, np.array([len(data) for data in packed], np.int64))
    for place, data in zip(places, packed, strict=True):
        writer.write_block(Block(int(place), data))
