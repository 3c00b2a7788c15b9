"""Reads the result file of a series: its frames one by one, each as the result of a pair."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.damaged_result import READ_ERRORS, read_array
from ddic.io.damaged_tables import require_sound_frames
from ddic.io.input_file import is_readable_file
from ddic.io.open_hdf5 import open_hdf5
from ddic.io.result_reader import Result, opened_result, read_open_file, read_result


@dataclass(frozen=True)
class SeriesResult:
    """The frames of a series; each is read when it is asked for.

    Attributes
    ----------
    path : Path
        The file.
    times : (n,) array
        Of the frames that were measured, unit chosen by the user.
    numbers : (n,) int64 array
        Of them among all frames, from 1.
    records : tuple of dict
        Of all frames, measured or not: number, image, time, converged, iterations, failure and more.
    """

    path: Path
    times: NDArray[np.float64]
    numbers: NDArray[np.int64]
    records: tuple[Mapping[str, Any], ...]

    def __len__(self) -> int:
        return len(self.times)

    @overload
    def __getitem__(self, key: int) -> Result: ...

    @overload
    def __getitem__(self, key: slice) -> list[Result]: ...

    def __getitem__(self, key: int | slice) -> Result | list[Result]:
        if isinstance(key, slice):
            return [self._read(step) for step in range(*key.indices(len(self)))]
        if not -len(self) <= key < len(self):
            raise IndexError(f"{self.path}: frame {key} of {len(self)} that were measured")
        return self._read(key % len(self))

    def __iter__(self) -> Iterator[Result]:
        return (self._read(step) for step in range(len(self)))

    def _read(self, step: int) -> Result:
        with (opened_result(self.path) as (_, file),
              h5py.File("frame", "w", driver="core", backing_store=False) as frame):
            _extract(file, step, int(self.numbers[step]), frame)
            result = read_open_file(Path(), frame)
        floor = next((record.get(schema.NOISE_FLOOR) for record in self.records
                      if record["number"] == self.numbers[step]), None)
        case = dict(result.attributes.get(schema.CASE, {}))
        if floor is not None:
            # Kept with what is told of the frames: it is estimated at the first one of each run that goes on.
            case[schema.NOISE_FLOOR] = floor
        return _name(result, self.path, {**result.attributes, schema.CASE: case})


def is_series_file(path: Path) -> bool:
    """Tell whether a file holds the frames of a series, be it one.

    Parameters
    ----------
    path : Path
        Any file.

    Returns
    -------
    bool
        False for what is no file, no HDF5, damaged or the result of a pair.
    """
    if not is_readable_file(path) or not h5py.is_hdf5(path):
        return False
    try:
        with open_hdf5(path) as file:
            return schema.STEPS in file
    except (InputError, *READ_ERRORS):
        # Whoever reads it says what is wrong with it.
        return False


def read_series(path: Path | str) -> SeriesResult:
    """Read the result file of a series; the file of a pair is a series of one frame.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    SeriesResult
        Of its frames.

    Raises
    ------
    InputError
        Where it is missing, foreign, damaged or of a newer major schema.
    """
    with opened_result(path) as (name, file):
        return _read_contents(name, file)


def read_frames(path: Path | str) -> Iterator[Result]:
    """Read the frames of a result file one after the other, whether it holds a series or a pair.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    iterator of Result
        Those that were measured; of a pair the one, with a UserWarning where it did not converge.

    Raises
    ------
    InputError
        Where it is missing, foreign, damaged or of a newer major schema.
    """
    series = read_series(path)
    return iter(series) if is_series_file(series.path) else iter([read_result(path)])


def _read_contents(path: Path, file: Any) -> SeriesResult:
    if schema.SERIES not in file or "records" not in file[schema.SERIES]:
        time = float(file[schema.TIME].attrs["deformed"])
        return SeriesResult(path, np.array([time]), np.array([1]), ({"number": 1, "time": time, "converged": True},))
    series = file[schema.SERIES]
    records = tuple(json.loads(text) for text in series["records"].asstr()[...])
    times, numbers = read_array(file[schema.STEPS]["Values"]), np.asarray(series.attrs["numbers"]).astype(np.int64)
    require_sound_frames(times, numbers, records)
    return SeriesResult(path, times, numbers, records)


def _extract(file: Any, step: int, number: int, frame: Any) -> None:
    """Write a step as the result file of a pair has it."""
    for key in ("ddic_schema", "y_axis"):
        frame.attrs[key] = file.attrs[key]
    if schema.STEPS not in file:
        for name in file:
            file.copy(name, frame)
        frame.attrs.update(dict(file.attrs))
        return
    rest = file[schema.frame_group(number)]
    for name in rest:
        rest.copy(name, frame)
    for key in (schema.STATUS, schema.FAILURE):
        frame.attrs[key] = rest.attrs[key]
    grid, steps, target = file[schema.VTKHDF], file[schema.STEPS], frame.create_group(schema.VTKHDF)
    part, n_parts = int(steps["PartOffsets"][step]), int(steps["NumberOfParts"][step])
    point, cell = int(steps["PointOffsets"][step]), int(steps["CellOffsets"][step, 0])
    connectivity = int(steps["ConnectivityIdOffsets"][step, 0])
    counts = {}
    for name in ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds"):
        target[name] = grid[name][part:part + n_parts]
        counts[name] = int(target[name][...].sum())
    n_points, n_cells = counts["NumberOfPoints"], counts["NumberOfCells"]
    target["Points"] = grid["Points"][point:point + n_points]
    target["Types"] = grid["Types"][cell:cell + n_cells]
    target["Offsets"] = grid["Offsets"][cell + part:cell + part + n_cells + n_parts]
    target["Connectivity"] = grid["Connectivity"][connectivity:connectivity + counts["NumberOfConnectivityIds"]]
    for kind, n in (("PointData", n_points), ("CellData", n_cells)):
        fields = target.create_group(kind)
        for name, values in grid[kind].items():
            begin = int(steps[f"{kind}Offsets/{name}"][step])
            fields[name] = values[begin:begin + n]
            fields[name].attrs.update(dict(values.attrs))


def _name(result: Result, path: Path, attributes: Mapping[str, Mapping[str, Any]]) -> Result:
    """The same with its file's name, other attributes, and the residual image that it holds already."""
    residual = result.residual_image
    named = replace(result, path=path, attributes=attributes)
    # A copy forgets what was computed at first use, and would look for it in the file of the series.
    named.__dict__["residual_image"] = residual
    return named
