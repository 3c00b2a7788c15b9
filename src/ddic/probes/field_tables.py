"""Whole fields as tables: a row for each node or cell, a column for each component."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.replace_on_exit import replaced_together
from ddic.io.result_reader import Result
from ddic.plots.canvas import find_length_unit

VECTOR_NAMES = ("x", "y")
TENSOR_NAMES = {"xx": 0, "yy": 1, "xy": 3}
"""Columns of a symmetric tensor in the plane, and their places in the file's XX, YY, ZZ, XY, YZ, XZ."""

N_DIGITS = 9
"""Of numbers in a table."""


def write_field_tables(path: Path | str, result: Result) -> tuple[Path, Path]:
    """Write all fields of a result as CSV, with units in the headers: NAME.nodes.csv and NAME.cells.csv.

    Parameters
    ----------
    path : Path or str
        NAME.csv; the two names follow from it.
    result : Result
        What was measured.

    Returns
    -------
    nodes, cells : Path
        The files.

    Raises
    ------
    InputError
        Where the folder cannot be written to.
    """
    nodes, cells = list_field_tables(Path(path))
    mesh = result.mesh
    with replaced_together() as files:
        _write_table(files.begin(nodes), _list_columns(result, "node", mesh.nodes, result.point_data))
        _write_table(files.begin(cells), _list_columns(result, "cell", mesh.centroids, result.cell_data))
    return nodes, cells


def list_field_tables(path: Path) -> tuple[Path, Path]:
    """Name the tables of nodes and of cells.

    Parameters
    ----------
    path : Path
        NAME.csv.

    Returns
    -------
    nodes, cells : Path
        NAME.nodes.csv and NAME.cells.csv.
    """
    nodes, cells = (path.with_name(f"{path.stem}.{what}{path.suffix or '.csv'}") for what in ("nodes", "cells"))
    return nodes, cells


def _list_columns(result: Result, what: str, places: NDArray[np.float64],
                  data: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Columns by their header: number, place, then all fields; numbers of nodes and cells are those of the file."""
    numbers = data[schema.GLOBAL_NODE_ID if what == "node" else schema.GLOBAL_CELL_ID]
    units = _list_units(result)
    columns: dict[str, NDArray[Any]] = {what: numbers, "x [px]": places[:, 0], "y [px]": places[:, 1]}
    for name, values in data.items():
        if name in (schema.GLOBAL_NODE_ID, schema.GLOBAL_CELL_ID):
            continue
        unit = units.get(name, "1")
        if values.ndim == 1:
            columns[f"{name} [{unit}]"] = values
        elif values.shape[1] == schema.VECTOR:
            columns |= {f"{name}_{axis} [{unit}]": values[:, k] for k, axis in enumerate(VECTOR_NAMES)}
        else:
            columns |= {f"{name}_{pair} [{unit}]": values[:, k] for pair, k in TENSOR_NAMES.items()}
    return columns


def _list_units(result: Result) -> dict[str, str]:
    """Units by the names of the fields."""
    length_unit = find_length_unit(result).name
    specs = (*schema.point_fields(length_unit), *schema.nodal_strain_fields(), *schema.cell_fields())
    return {spec.name: spec.unit for spec in specs}


def _write_table(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Columns as CSV; nothing where a value is nan."""
    texts = [_format_column(values) for values in columns.values()]
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(columns)
        table.writerows(zip(*texts, strict=True))


def _format_column(values: NDArray[Any]) -> list[str]:
    if np.issubdtype(values.dtype, np.integer):
        return [str(value) for value in values.tolist()]
    return ["" if value != value else f"{value:.{N_DIGITS}g}" for value in values.tolist()]  # noqa: PLR0124  nan alone
