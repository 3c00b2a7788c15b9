"""Chunks of the residual image, put together from the ranks' subdomains."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.io.image_chunks import ChunkGrid
from ddic.io.result_writer import ResultWriter
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.results import residual_image, shared_file
from ddic.results.residual_image import Patch, share_chunks, write_patches

RANKS = [1, 3]
WIDTH, HEIGHT = 900, 700
GRID = ChunkGrid(Window.of_size(WIDTH, HEIGHT))
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


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("way", ["straight", "through rank 0"])
def test_the_file_has_every_pixel_once(shared_path: Path, monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    # Two at a time: several batches on each rank.
    monkeypatch.setattr(residual_image, "CHUNKS_A_BATCH", 2)
    if way != "straight":
        monkeypatch.setattr(shared_file, "_can_write", lambda *_: False)
    team = Team(MPI.COMM_WORLD)
    mine = patches(split_evenly(np.ones(N_PARTS), team.size)[team.rank])
    path = shared_path / "field.vtkhdf"
    with ExitStack() as stack:
        writer = team.build_on_root(lambda: stack.enter_context(ResultWriter(path)))
        write_patches(team, writer, GRID, [p.window for p in mine], iter(mine))
    if team.is_root:
        with h5py.File(path) as file:
            image = file["residual_image/residual"]
            np.testing.assert_array_equal(image[...], np.where(part_of_each_pixel() >= 0, picture(), np.nan))
            # The two chunks of the empty corner, of 12, are not there at all.
            assert image.id.get_num_chunks() == 10


@pytest.mark.parallel(RANKS)
def test_ranks_agree_on_owners_and_share_the_work() -> None:
    team = Team(MPI.COMM_WORLD)
    windows = [p.window for p in patches(split_evenly(np.ones(N_PARTS), team.size)[team.rank])]
    shares = share_chunks(team, GRID, windows)
    # Each rank knows of the chunks that its windows touch, and of no others.
    seen = {n for window in windows for n in GRID.find_chunks(window)}
    assert set(shares.owner) == set(shares.sharers) == seen
    assert all(team.rank in ranks and shares.owner[n] in ranks for n, ranks in shares.sharers.items())
    owner: dict[int, int] = {}
    for found in team.gather_lists([shares.owner]):
        assert all(owner.get(n, rank) == rank for n, rank in found.items())
        owner |= found
    # Of slanted stripes, whose windows are far larger than they are, no rank is given more than twice its share.
    counts = np.bincount(list(owner.values()), minlength=team.size)
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
