"""How much memory each rank may still take.

Images that can only be decoded whole: once a node, for all of its ranks.
"""

import os
import resource
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

_SYSTEM = Path("/proc/meminfo")
_OF_PROCESS = Path("/proc/self/statm")
_GROUPS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current"), Path("/sys/fs/cgroup/memory.stat"))
"""Limit, use and use by kind of the control group in which a container, or a job of a batch system, runs."""


def measure_available_memory(team: Team) -> int:
    """Measure the memory, bytes, that each rank may still take where all take as much; collective.

    It is the same on all ranks: the least of what a node has left over its ranks, and of what a limit of the rank
    itself (``ulimit -v``) leaves.
    """
    share = read_available_memory() // team.count_beside()
    return -team.maximum(-min(share, _read_own_limit()))


def read_available_memory() -> int:
    """Read what this machine has left, or the control group that this process runs in, bytes."""
    left = _read_fields(_SYSTEM).get("MemAvailable:", 0) * 1024
    if not left:
        # Not Linux: what there is at all.
        left = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min(left, _read_group_limit(left))


def _read_group_limit(otherwise: int) -> int:
    """What the control group leaves, bytes; ``otherwise`` where there is no limit, or no such group."""
    limit, current, kinds = _GROUPS
    try:
        allowed, used = limit.read_text(encoding="ascii").strip(), int(current.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return otherwise
    if allowed == "max":
        return otherwise
    # Pages of files that are not in use count as used, and are given up when memory is wanted.
    return max(int(allowed) - used + _read_fields(kinds).get("inactive_file", 0), 0)


def _read_own_limit() -> int:
    """What the limit of this process's address space leaves, bytes."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return 2**62
    try:
        used = int(_OF_PROCESS.read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        used = 0
    return max(limit - used, 0)


def _read_fields(path: Path) -> dict[str, int]:
    """The first number of each line of a file, by the word before it; nothing where there is no such file."""
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except OSError:
        return {}
    words = [line.split() for line in lines]
    return {line[0]: int(line[1]) for line in words if len(line) > 1 and line[1].isdigit()}


@dataclass(frozen=True)
class _Offer:
    """What the first rank of a node opened: the image and, where it was decoded whole, its pixels or a file of them.

    The pixels themselves, (height, width), where the rank is alone on its node; else other ranks map the file.
    """

    source: ImageSource
    pixels: NDArray[Any] | None = None
    file: Path | None = None


def open_once_a_node(team: Team, opened: Callable[[], tuple[ImageSource, NDArray[Any] | None]]) -> ImageSource:
    """Open an image on the first rank of each node and share it with the node's other ranks; collective.

    ``opened`` gives the image and, where it had to be decoded whole, its pixels, (height, width). Several ranks of a
    node map these from a temporary file (in TMPDIR) that is unlinked at once: the node holds one copy, which goes with
    the last rank that lets go of the image. Raises InputError on all ranks where the temporary file cannot be written;
    and what ``opened`` raises.
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
    return _Offer(source, file=_store(source.path, pixels))


def _store(path: Path, pixels: NDArray[Any]) -> Path:
    """Write pixels to a temporary file and return its name."""
    file: Path | None = None
    try:
        with tempfile.NamedTemporaryFile(prefix="ddic-image-", delete=False) as stream:
            file = Path(stream.name)
            np.save(stream, pixels)
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
    pixels = offer.pixels if offer.file is None else np.asarray(np.load(offer.file, mmap_mode="r"))
    return offer.source if pixels is None else ArraySource(offer.source.path, pixels, offer.source.saturation)
