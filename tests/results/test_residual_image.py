"""Chunks of the residual image, put together from the ranks' subdomains."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.io.hdf5_file import ChunkGrid
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.results import residual_image
from ddic.results.residual_image import PackedChunk, Patch, pack_chunks, share_chunks, stream_chunks

RANKS = [1, 3]
WIDTH, HEIGHT = 900, 700
GRID = ChunkGrid(WIDTH, HEIGHT)
N_PARTS = 7


def picture() -> NDArray[np.float32]:
    return np.random.default_rng(1).normal(size=(HEIGHT, WIDTH)).astype(np.float32)


def part_of_each_pixel() -> NDArray[np.int64]:
    """Slanted stripes, so that windows overlap and every chunk is shared; -1: no subdomain."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    part = ((x + y // 2) * N_PARTS // (WIDTH + HEIGHT // 2)).astype(np.int64)
    part[(x >= 512) & (y < 256)] = -1
    return part


def patches(numbers: range) -> list[Patch]:
    part, values = part_of_each_pixel(), picture()
    found = []
    for s in numbers:
        rows, columns = np.nonzero(part == s)
        window = Window((int(columns.min()), int(rows.min())), (int(columns.max()) + 1, int(rows.max()) + 1))
        place = np.s_[window.y0:window.y1, window.x0:window.x1]
        found.append(Patch(window, np.where(part[place] == s, values[place], np.float32(np.nan))))
    return found


def unpacked(chunk: PackedChunk) -> NDArray[np.float32]:
    planes = np.frombuffer(zlib.decompress(chunk.data), np.uint8).reshape(4, -1)
    return np.ascontiguousarray(planes.T).view("<f4").reshape(GRID.shape)


@pytest.mark.parallel(RANKS)
def test_root_gets_every_pixel_once_compressed(monkeypatch: pytest.MonkeyPatch) -> None:
    # Two a message: several messages from each rank.
    monkeypatch.setattr(residual_image, "CHUNKS_A_MESSAGE", 2)
    team = Team(MPI.COMM_WORLD)
    mine = patches(split_evenly(np.ones(N_PARTS), team.size)[team.rank])
    held = pack_chunks(team, GRID, [p.window for p in mine], iter(mine))
    everything: list[PackedChunk] = []
    stream_chunks(team, held, everything.append)
    image = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    for chunk in everything:
        place = GRID.locate_chunk(chunk.number)
        clipped = place.intersection(Window.of_size(WIDTH, HEIGHT))
        target = image[place.y0:place.y1, place.x0:place.x1]
        target[...] = unpacked(chunk)[:clipped.height, :clipped.width]
    numbers = [chunk.number for chunk in everything]
    n_held = team.comm.allreduce(len(held))
    if team.is_root:
        np.testing.assert_array_equal(image, np.where(part_of_each_pixel() >= 0, picture(), np.nan))
        assert len(set(numbers)) == len(numbers) == n_held
        # The chunks of the empty corner are not there at all.
        assert not {2, 3} & set(numbers)
    else:
        assert numbers == []


@pytest.mark.parallel(RANKS)
def test_ranks_agree_on_owners_and_share_the_work() -> None:
    team = Team(MPI.COMM_WORLD)
    windows = [p.window for p in patches(split_evenly(np.ones(N_PARTS), team.size)[team.rank])]
    shares = share_chunks(team, GRID, windows)
    assert team.gather_lists([shares]) == [shares] * team.size
    seen = {n for window in team.gather_lists(windows) for n in GRID.find_chunks(window)}
    assert set(shares.owner) == set(shares.sharers) == seen
    assert all(shares.owner[n] in ranks for n, ranks in shares.sharers.items())
    # Of slanted stripes, whose windows are far larger than they are, no rank is given more than twice its share.
    counts = np.bincount(list(shares.owner.values()), minlength=team.size)
    assert counts.max() <= 2 * counts.mean()


def test_patches_are_asked_for_one_by_one_and_chunks_let_go_when_complete() -> None:
    events: list[Any] = []

    def told() -> Iterator[Patch]:
        for number, patch in enumerate(everything):
            events.append(f"patch {number}")
            yield patch

    everything = patches(range(N_PARTS))
    for number, _ in residual_image._complete_chunks(GRID, [p.window for p in everything], told()):
        events.append(number)
    # The windows of the first four stripes reach the upper left chunk, that of the fifth does not.
    assert events.index(0) < events.index("patch 4")
    assert [e for e in events if isinstance(e, str)] == [f"patch {n}" for n in range(N_PARTS)]
