"""Partitions read from text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.toml_file import read_text

MOST_DIGITS = 18
"""Digits of a whole number of 64 bits."""


def read_partition(path: Path, n_cells: int) -> NDArray[np.int64]:
    """Read the subdomain of each cell: one whole number per cell, from 0, without gaps.

    The numbers are separated by spaces or new lines; what follows a # is a comment.

    Parameters
    ----------
    path : Path
        A text file.
    n_cells : int
        Of the mesh.

    Returns
    -------
    (n_cells,) array
        Subdomains.

    Raises
    ------
    InputError
        Where the file cannot be read, has another length, or leaves a subdomain empty.
    """
    lines = read_text(path, "partition file", "check the path").splitlines()
    words = [word for line in lines for word in line.partition("#")[0].split()]
    bad = next((word for word in words if not (word.isascii() and word.isdecimal())), None)
    if bad is not None:
        raise InputError(f'{path}: "{bad}" is not a subdomain; give one whole number >= 0 per cell')
    if len(words) != n_cells:
        raise InputError(f"{path}: holds {len(words)} numbers, but the mesh has {n_cells} cells; "
                         "give one per cell, in the mesh's order")
    # As many subdomains as cells at most, none being empty: a larger number is a gap, however many digits it has.
    largest = max(words, key=lambda word: (len(word.lstrip("0")), word.lstrip("0")))
    if len(largest.lstrip("0")) > MOST_DIGITS or int(largest) >= n_cells:
        raise InputError(f"{path}: subdomain {largest[:MOST_DIGITS]}{'...' if len(largest) > MOST_DIGITS else ''}, but "
                         f"{n_cells} cells make {n_cells} subdomains at most; number them from 0 without gaps")
    parts = np.array([int(word) for word in words], dtype=np.int64)
    missing = np.setdiff1d(np.arange(parts.max() + 1), parts)
    if len(missing):
        raise InputError(f"{path}: subdomain {missing[0]} has no cell; number the subdomains without gaps")
    return parts
