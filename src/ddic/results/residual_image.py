"""The residual image of each camera in the result file: rank 0 makes room, ranks compress and write their chunks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.functionals.correlation import Residual, RowBand
from ddic.functionals.view import FrameView
from ddic.images.window import Window
from ddic.io.image_chunks import ChunkGrid, pack_chunk
from ddic.io.new_hdf5 import Block
from ddic.io.result_writer import ResultWriter
from ddic.parallel.team import Team, require_held
from ddic.results.shared_file import write_blocks

if TYPE_CHECKING:
    from ddic.results.measurement import Measurement


CHUNKS_A_BATCH = 16
"""Compressed chunks written, or sent to rank 0, at a time: more make fewer messages and take more memory there."""

LARGE = 0.5
"""Share of a chunk's largest part from which on a rank may own it. A larger share sends less and spreads the
compression less evenly."""


@dataclass(frozen=True)
class Patch:
    """A box of the residual image.

    Attributes
    ----------
    window : Window
        Its pixels.
    values : array of the window's shape
        Grey levels, NaN where its subdomain has no pixel.
    """

    window: Window
    values: NDArray[np.float32]


_PackedChunk = tuple[int, bytes]
"""Place of a compressed chunk in the grid, and the chunk as the file holds it."""


@dataclass(frozen=True)
class _ChunkShares:
    """Ranks that hold pixels of each chunk that this rank's windows touch, and one of them, its owner; by number."""

    sharers: dict[int, list[int]]
    owner: dict[int, int]


def share_chunks(team: Team, grid: ChunkGrid, windows: Iterable[Window]) -> _ChunkShares:
    """Agree on the owner of every chunk that windows of owned subdomains touch; collective.

    A chunk's owner is found on one rank, to which only those that share it tell how much they have of it.
    """
    area: dict[int, Counter[int]] = {}
    for window in windows:
        for number in grid.find_chunks(window):
            n_pixels = window.intersection(grid.locate_chunk(number)).n_pixels
            area.setdefault(number % team.size, Counter())[number] += n_pixels
    # By chunk and rank, the pixels of the windows.
    n_pixels_of: dict[int, dict[int, int]] = {}
    for rank, areas in team.exchange(area).items():
        for number, n_pixels in areas.items():
            n_pixels_of.setdefault(number, {})[rank] = n_pixels
    answers: dict[int, _ChunkShares] = {}
    for number, of_rank in n_pixels_of.items():
        enough = LARGE * max(of_rank.values())
        candidates = [rank for rank, n_pixels in of_rank.items() if n_pixels >= enough]
        for rank in of_rank:
            answer = answers.setdefault(rank, _ChunkShares({}, {}))
            answer.sharers[number] = list(of_rank)
            answer.owner[number] = candidates[number % len(candidates)]
    shares = _ChunkShares({}, {})
    for found in team.exchange(answers).values():
        shares.sharers.update(found.sharers)
        shares.owner.update(found.owner)
    return shares


def _pack_chunks(team: Team, grid: ChunkGrid, windows: list[Window], patches: Iterator[Patch]) -> list[_PackedChunk]:
    """Put the chunks of this rank together and compress them; collective.

    A chunk is sent or compressed as soon as no further subdomain of this rank touches it. ``patches`` are those of the
    owned subdomains' windows, in this order, computed one by one. Chunks that have no correlated pixel are left out.
    """
    shares = share_chunks(team, grid, windows)
    done: list[_PackedChunk] = []
    waiting: dict[int, NDArray[np.float32]] = {}
    sent = []
    for number, chunk in _complete_chunks(grid, windows, patches):
        if shares.owner[number] != team.rank:
            sent.append(team.begin_send((number, chunk), shares.owner[number]))
        elif len(shares.sharers[number]) > 1:
            waiting[number] = chunk
        else:
            done += _pack(number, chunk)
    _receive_parts(team, shares, waiting)
    for number, chunk in waiting.items():
        done += _pack(number, chunk)
    team.finish_sends(sent)
    return done


def _receive_parts(team: Team, shares: _ChunkShares, chunks: dict[int, NDArray[np.float32]]) -> None:
    """Complete this rank's chunks with what other ranks send of them."""
    mine = [number for number, rank in shares.owner.items() if rank == team.rank]
    awaited = Counter(rank for number in mine for rank in shares.sharers[number] if rank != team.rank)
    for rank, n_chunks in awaited.items():
        for _ in range(n_chunks):
            number, part = team.receive(rank)
            np.copyto(chunks[number], part, where=~np.isnan(part))


def _complete_chunks(grid: ChunkGrid, windows: list[Window],
                     patches: Iterator[Patch]) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Chunks with all that this rank's subdomains hold of them, each as soon as that is so."""
    left = Counter(number for window in windows for number in grid.find_chunks(window))
    open_chunks: dict[int, NDArray[np.float32]] = {}
    for patch in patches:
        for number in grid.find_chunks(patch.window):
            chunk = open_chunks.setdefault(number, np.full(grid.shape, np.nan, dtype=np.float32))
            _lay(patch, grid.locate_chunk(number), chunk)
            left[number] -= 1
            if left[number] == 0:
                yield number, open_chunks.pop(number)


def _lay(patch: Patch, place: Window, chunk: NDArray[np.float32]) -> None:
    """Copy the part of a patch that lies in a chunk; place: the chunk's pixels."""
    common = patch.window.intersection(place)
    values = patch.values[patch.window.locate(common)]
    target = chunk[place.locate(common)]
    np.copyto(target, values, where=~np.isnan(values))


def _pack(number: int, chunk: NDArray[np.float32]) -> list[_PackedChunk]:
    """A chunk compressed; nothing where it has no pixel."""
    return [] if np.isnan(chunk).all() else [(number, pack_chunk(chunk))]


def write_residual_images(measurement: Measurement, writer: ResultWriter | None) -> None:
    """Write the residual image of each camera; collective: every rank compresses its chunks, rank 0 stores them."""
    views, residuals = measurement.whole.views, measurement.evaluation.residuals
    for camera in measurement.cameras:
        image = camera.reference.image
        grid = ChunkGrid(image.extent)
        # In bands of rows, or of planes: images of whole subdomains are as large as reference images.
        seen = [(view, q, residual, view.correlation.split_bands(grid.shape[0]))
                for view, q, residual in zip(views.flat, views.fill(measurement.q).flat, residuals.flat, strict=True)
                if view.camera == camera.number]
        windows = [band.window for *_, bands in seen for band in bands]
        write_patches(measurement.team, writer, grid, windows, _make_patches(measurement, seen))


def _make_patches(measurement: Measurement,
                  seen: list[tuple[FrameView, Array, Residual, list[RowBand]]]) -> Iterator[Patch]:
    """The residual on each band, computed one by one; of views with their unknowns and residual sums."""
    for view, q, residual, bands in seen:
        correction = measurement.whole.find_correction(measurement.evaluation, view.camera, residual)
        for band, image in zip(bands, view.compute_residual_bands(q, bands, *correction), strict=True):
            yield Patch(band.window, image)


def write_patches(team: Team, writer: ResultWriter | None, grid: ChunkGrid, windows: list[Window],
                  patches: Iterator[Patch]) -> None:
    """Write a residual image of which each rank has some patches, in their windows; collective."""
    chunks = _pack_chunks(team, grid, windows, patches)
    places = _make_room(team, writer, grid, chunks).tolist()
    blocks = [Block(place, data) for place, (_, data) in zip(places, chunks, strict=True)]
    batches = (blocks[first:first + CHUNKS_A_BATCH] for first in range(0, len(blocks), CHUNKS_A_BATCH))
    write_blocks(team, writer, batches)


def _make_room(team: Team, writer: ResultWriter | None, grid: ChunkGrid, chunks: list[_PackedChunk]) -> IntArray:
    """Places in the file of this rank's chunks, (n,); collective: of the others rank 0 learns number and size alone."""
    sizes = np.array([(number, len(data)) for number, data in chunks], np.int64).reshape(-1, 2)
    of_ranks = team.gather_to(sizes)

    def reserve() -> list[IntArray]:
        gathered = require_held(of_ranks)
        places = require_held(writer).create_residual_image(grid, *np.concatenate(gathered).T)
        return np.split(places, np.cumsum([len(of_rank) for of_rank in gathered])[:-1])

    return team.scatter_from_root(reserve)
