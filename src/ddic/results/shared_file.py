"""A result file that all ranks write: rank 0 makes room, and each rank writes its own where it sees the file."""

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ddic.io.new_hdf5 import Block, write_block
from ddic.io.result_writer import ResultWriter
from ddic.parallel.distribution import stream_to_root
from ddic.parallel.team import Team, require_held

COHERENT = ("beegfs", "ceph", "gpfs", "lustre", "panfs", "pvfs2", "wekafs")
"""File systems, as Linux names them, on which machines may write neighbouring bytes at the same time. On others, NFS
above all, a machine writes whole pages from its memory, and with them what another one has since written there."""


def write_blocks(team: Team, writer: ResultWriter | None, batches: Iterator[list[Block]]) -> None:
    """Write all ranks' blocks, each batch made when the one before is written; collective, the writer is rank 0's.

    A rank that cannot write to the file sends its blocks to rank 0: the file is in memory, or on another machine's
    disk, or on a file system that machines cannot share so. What fails on a rank, a full disk, say, is raised on all.
    """
    begun, path, machine = team.broadcast(None if writer is None else (writer.begun, writer.path, platform.node()))

    def write_what_can_be() -> Iterator[list[Block]]:
        """Yield the other batches, for rank 0."""
        if team.is_root or begun is None or path is None or not _can_write(begun, machine):
            yield from batches
            return
        with _opened(begun, path) as descriptor:
            for batch in batches:
                with _named(path):
                    for block in batch:
                        write_block(descriptor, block)

    def take(batch: list[Block]) -> None:
        for block in batch:
            require_held(writer).write_block(block)

    stream_to_root(team, write_what_can_be(), take)


def _can_write(begun: Path, machine: str) -> bool:
    """Whether this rank can write to a file while rank 0, on a machine of that name, does."""
    return begun.exists() and (platform.node() == machine or _name_file_system(begun) in COHERENT)


def _name_file_system(path: Path) -> str:
    """Name the kind of file system that a file is on, as Linux does; empty where it cannot be told."""
    device = path.stat().st_dev
    mounts = Path("/proc/self/mountinfo")
    for line in mounts.read_text(encoding="utf-8").splitlines() if mounts.exists() else ():
        # Of each mount: its number, its parent's, major:minor of the device, ...; behind a dash the kind comes first.
        mount, _, kind = line.partition(" - ")
        if mount.split()[2] == f"{os.major(device)}:{os.minor(device)}":
            return kind.split()[0]
    return ""


@contextmanager
def _opened(begun: Path, path: Path) -> Iterator[int]:
    """Open what rank 0 has begun; closing it may be what tells that a disk is full."""
    with _named(path):
        descriptor = os.open(begun, os.O_WRONLY | os.O_NOFOLLOW)
    try:
        yield descriptor
    finally:
        with _named(path):
            os.close(descriptor)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name the file as the user knows it in what a disk refuses."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
