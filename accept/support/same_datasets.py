"""Two result files, dataset by dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

OF_TIME = ("history/phases", "series/records")
"""Parts of the names of datasets of seconds and what follows from them, which no run repeats."""


def find_unequal_datasets(one: Path, other: Path) -> tuple[int, list[str]]:
    """Compare all datasets of two result files to the last bit, but those of seconds.

    Parameters
    ----------
    one, other : Path
        Result files.

    Returns
    -------
    n_compared : int
        How many datasets the first has.
    unequal : list of str
        Names of those that differ, or that one file lacks.
    """
    first, second = _read(one), _read(other)
    missing = set(first) ^ set(second)
    unequal = [name for name in set(first) & set(second) if not _are_equal(first[name], second[name])]
    return len(first), sorted([*missing, *unequal])


def _read(path: Path) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}

    def keep(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not any(part in name for part in OF_TIME):
            found[name] = np.asarray(item[()])

    with h5py.File(path) as file:
        file.visititems(keep)
    return found


def _are_equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    may_be_nan = one.dtype.kind == "f" and other.dtype.kind == "f"
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=may_be_nan)
