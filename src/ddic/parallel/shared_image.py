"""Images that can only be decoded whole: once a node, for all of its ranks."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.source import ImageSource
from ddic.parallel.team import Team, require_held


@dataclass(frozen=True)
class _Offer:
    """What the first rank of a node opened.

    Attributes
    ----------
    source : ImageSource
        The image.
    pixels : (height, width) array or None
        Where the rank is alone on its node, and the image had to be decoded whole.
    file, shape, dtype
        Where other ranks map the pixels from.
    """

    source: ImageSource
    pixels: NDArray[Any] | None = None
    file: Path | None = None
    shape: tuple[int, ...] = ()
    dtype: np.dtype[Any] | None = None


def open_once_a_node(team: Team, opened: Callable[[], tuple[ImageSource, NDArray[Any] | None]]) -> ImageSource:
    """Open an image on the first rank of each node and share it with the node's other ranks; collective.

    Several ranks of a node map the pixels of an image that had to be decoded whole from a temporary file (in TMPDIR)
    that is unlinked at once: the node holds one copy, which goes with the last rank that lets go of the image.

    Parameters
    ----------
    team : Team
        All ranks.
    opened : callable
        Gives the image and, where it had to be decoded whole, its pixels, of shape (height, width).

    Returns
    -------
    ImageSource
        The image, on all ranks.

    Raises
    ------
    InputError
        On all ranks, where the temporary file cannot be written; and what ``opened`` raises.
    """
    # A map of a file and no MPI window: where shared memory is short, MPI_Win_allocate_shared fails on one rank
    # alone and leaves the others waiting (Open MPI 4.1), and a window could only be freed by all ranks together.
    with team.of_this_node() as node:
        own = team.together(lambda: _offer(*opened(), alone=node.size == 1) if node.is_root else None)
        # Pixels that nobody else needs are not copied through MPI.
        offer = require_held(own) if node.size == 1 else node.broadcast(own)
        try:
            return team.together(partial(_accept, offer))
        finally:
            if node.is_root and offer.file is not None:
                offer.file.unlink(missing_ok=True)


def _offer(source: ImageSource, pixels: NDArray[Any] | None, *, alone: bool) -> _Offer:
    """What the node's other ranks are given."""
    if pixels is None or alone:
        return _Offer(source, pixels)
    return _Offer(source, None, _store(source.path, pixels), pixels.shape, pixels.dtype)


def _store(path: Path, pixels: NDArray[Any]) -> Path:
    """Write pixels to a temporary file and return its name."""
    file: Path | None = None
    try:
        with tempfile.NamedTemporaryFile(prefix="ddic-image-", delete=False) as stream:
            file = Path(stream.name)
            pixels.tofile(stream)
    except OSError as error:
        if file is not None:
            file.unlink(missing_ok=True)
        raise InputError(
            f"{path}: its {pixels.nbytes} bytes, decoded once for all ranks of a node, do not fit into "
            f"{tempfile.gettempdir()} ({error}); make room there, set TMPDIR to another folder, or save the image as "
            "uncompressed TIFF, which is read window by window") from error
    return file


def _accept(offer: _Offer) -> ImageSource:
    """The image that was offered."""
    pixels = offer.pixels
    if offer.file is not None:
        pixels = np.asarray(np.memmap(offer.file, offer.dtype, mode="r", shape=offer.shape))
    return offer.source if pixels is None else ArraySource(offer.source.path, pixels, offer.source.saturation)
