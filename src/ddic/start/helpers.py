"""Images in blocks, of which each rank holds some rows, and ranks that read and correlate for the one that searches."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TypeVar

import numpy as np

from ddic.images.binned import BinnedSource, Blocks, bin_rows, join_blocks
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.parallel.workers import Workers
from ddic.start.binned_pair import BinnedPair


@dataclass(frozen=True, eq=False)
class PairOfRank:
    """An image pair as a rank reads it: some rows, in small blocks, are in its memory.

    Attributes
    ----------
    reference, deformed : MaskedSource
        The images, in pixels.
    factor : int
        Side of the blocks, pixels.
    first_row : int
        The first of the rows.
    held : tuple of Blocks
        These rows of both images.
    """

    reference: MaskedSource
    deformed: MaskedSource
    factor: int
    first_row: int
    held: tuple[Blocks, Blocks]

    def get_pair(self, size: int) -> BinnedPair:
        """Give both images in blocks of ``size`` pixels, averaged where they are read."""
        ratio = size // self.factor
        reference, deformed = (self._get_pair(source, held, ratio)
                               for source, held in zip((self.reference, self.deformed), self.held, strict=True))
        return BinnedPair(reference, deformed, size, BinnedPair(self.reference, self.deformed, 1))

    def _get_pair(self, source: MaskedSource, held: Blocks, ratio: int) -> MaskedSource:
        grey, mask = (BinnedSource(source, held, self.first_row, self.factor, ratio, shows_mask)
                      for shows_mask in (False, True))
        return MaskedSource(grey, mask if source.may_exclude else None, excludes_taps=False)


def hold_rows(reference: MaskedSource, deformed: MaskedSource, factor: int, rows: range) -> PairOfRank:
    """Average some rows of both images over blocks, and keep them."""
    held = (bin_rows(reference, factor, rows), bin_rows(deformed, factor, rows))
    return PairOfRank(reference, deformed, factor, rows.start, held)


def split_rows(n_rows: int, n_ranks: int) -> list[range]:
    """Split rows into as many bands as there are ranks, about as high."""
    edges = np.linspace(0, n_rows, n_ranks + 1).astype(int).tolist()
    return [range(begin, end) for begin, end in pairwise(edges)]


Item = TypeVar("Item")
Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Helpers:
    """Ranks that read and correlate parts of a camera's images for the one that searches, which is one of them.

    Attributes
    ----------
    workers : Workers
        All ranks, each with its images of every camera.
    camera : int
        Number of the camera.
    """

    workers: Workers[list[PairOfRank]]
    camera: int

    def get_pair(self, size: int) -> BinnedPair:
        """Give the images in blocks of ``size`` pixels as this rank sees them, averaged where they are read."""
        return self.workers.held[self.camera].get_pair(size)

    def read_whole(self, size: int) -> BinnedPair:
        """Read the images as a whole in blocks of ``size`` pixels into memory, each rank some of their rows."""
        pair = self.get_pair(size)
        rows_of_ranks = split_rows(int(pair.size[-1]), self.workers.team.size)
        bands = self.apply(_read_rows, [(size, rows) for rows in rows_of_ranks])
        reference, deformed = (join_blocks(source, [of_band[k] for of_band in bands])
                               for k, source in enumerate((pair.reference, pair.deformed)))
        return BinnedPair(reference, deformed, size, pair.pixels)

    def apply(self, work: Callable[[PairOfRank, Item], Found], items: Sequence[Item]) -> list[Found]:
        """Have all ranks apply a function of a module to their images and to items, in turn."""
        return self.workers.map(partial(_apply_to_camera, self.camera, work), items)


def _apply_to_camera(camera: int, work: Callable[[PairOfRank, Item], Found], images: list[PairOfRank],
                     item: Item) -> Found:
    return work(images[camera], item)


def _read_rows(images: PairOfRank, asked: tuple[int, range]) -> tuple[Blocks, Blocks]:
    """Rows of both images in blocks of a size, pixels."""
    size, rows = asked
    pair = images.get_pair(size)
    reference, deformed = (_read_blocks(source, source.extent.take_rows(rows.start, rows.stop))
                           for source in (pair.reference, pair.deformed))
    return reference, deformed


def _read_blocks(source: MaskedSource, window: Window) -> Blocks:
    mask = source.mask.read(window) if source.mask is not None else None
    # No mask where nothing is left out, as in an image that one rank bins.
    return Blocks(source.image.read(window), mask if mask is not None and not mask.all() else None)
