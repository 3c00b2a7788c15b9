"""Displacements at points, from a CSV file."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.toml_file import read_text

COLUMNS = ("x", "y", "u", "v")
"""Columns that are read; others may stand beside them."""

_SEPARATORS = ",;\t"


@dataclass(frozen=True, eq=False)
class PointTable:
    """Displacements at points, as a file holds them.

    Attributes
    ----------
    values : (n, 4) array
        x, y, u, v.
    rows : (n,) array of int64
        Row of the file that each stands in, from 1.
    """

    values: NDArray[np.float64]
    rows: NDArray[np.int64]


def read_point_table(path: Path) -> PointTable:
    """Read displacements at points from a CSV file.

    Parameters
    ----------
    path : Path
        A header row that names the columns x, y, u and v, in any order, then a row for each point; separated by commas,
        semicolons or tabs. Empty rows are passed over.

    Returns
    -------
    PointTable
        Of one point at least.

    Raises
    ------
    InputError
        Where the file is missing or holds something else, with the row and the column.
    """
    text = read_text(path, "table of points", "check the path")
    lines = text.splitlines()
    separator = max(_SEPARATORS, key=lines[0].count) if lines else ","
    rows = [(number, row) for number, row in enumerate(csv.reader(lines, delimiter=separator), 1)
            if any(cell.strip() for cell in row)]
    if not rows:
        raise InputError(f"{path}: is empty; give a header row x,y,u,v and a row for each point")
    places = _find_columns(path, rows[0][1])
    if len(rows) == 1:
        raise InputError(f"{path}: holds a header and no point; give a row x,y,u,v for each point, pixels")
    values = [_convert_row(path, number, row, places) for number, row in rows[1:]]
    return PointTable(np.array(values), np.array([number for number, _ in rows[1:]], dtype=np.int64))


def _find_columns(path: Path, header: Sequence[str]) -> list[int]:
    """Place of x, y, u and v in a row."""
    names = [name.strip().lower() for name in header]
    for column in COLUMNS:
        if names.count(column) != 1:
            how = "no column" if column not in names else "more than one column"
            raise InputError(f'{path}: row 1: {how} "{column}" among {", ".join(header)}; name the columns x, y, u, v '
                             "in the first row")
    return [names.index(column) for column in COLUMNS]


def _convert_row(path: Path, number: int, row: Sequence[str], places: Sequence[int]) -> list[float]:
    values = []
    for name, place in zip(COLUMNS, places, strict=True):
        if place >= len(row):
            raise InputError(f"{path}: row {number}: column {name} is missing; give x, y, u and v of each point")
        try:
            value = float(row[place])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f'{path}: row {number}, column {name}: "{row[place].strip()}" is no finite number; give '
                             "pixels, with a decimal point")
        values.append(value)
    return values
