"""Partitions read from text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError


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
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read this partition file ({error})") from error
    words = [word for line in lines for word in line.partition("#")[0].split()]
    bad = next((word for word in words if not word.isdecimal()), None)
    if bad is not None:
        raise InputError(f'{path}: "{bad}" is not a subdomain; give one whole number >= 0 per cell')
    if len(words) != n_cells:
        raise InputError(f"{path}: holds {len(words)} numbers, but the mesh has {n_cells} cells; "
                         "give one per cell, in the mesh's order")
    parts = np.array([int(word) for word in words], dtype=np.int64)
    missing = np.setdiff1d(np.arange(parts.max() + 1), parts)
    if len(missing):
        raise InputError(f"{path}: subdomain {missing[0]} has no cell; number the subdomains without gaps")
    return parts
