"""Folders that are made for files, and go again where none comes of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; where the block fails, remove those that were made and are empty.

    Parameters
    ----------
    folder : Path
        It may be there.

    Yields
    ------
    None
        While files are written there.

    Raises
    ------
    OSError
        Where it cannot be made.
    """
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for one in made:
            with suppress(OSError):
                one.rmdir()
        raise
