"""Reads the result file of a series: its frames one by one, each as the result of a pair, and numbers over time."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.damaged_result import require_sound_fields, require_sound_frames
from ddic.io.hdf5_file import NONE_KNOWN, READ_ERRORS, open_hdf5, read_array
from ddic.io.input_file import FileStamps, as_path, is_readable_file
from ddic.io.result_reader import Result, get_dim, opened_result, read_open_file, read_result
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_covered_areas


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
    known : FileStamps
        Of the file when it was looked through for damage, which takes longer than to read a frame.
    """

    path: Path
    times: Array
    numbers: IntArray
    records: tuple[Mapping[str, Any], ...]
    known: FileStamps = NONE_KNOWN

    def __repr__(self) -> str:
        return f"<ddic.SeriesResult {self.path}: {len(self)} of {len(self.records)} frames measured>"

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

    def view(self) -> Any:
        """Look at the frames on a page, which a notebook shows, as ``ddic view`` does.

        Returns
        -------
        NotebookPage
            With its address.

        Raises
        ------
        InputError
            Where ``ddic[page]`` is not installed.
        """
        return import_module("ddic.page").view_results(self.path)

    def _read(self, step: int) -> Result:
        number = self.numbers[step]
        with opened_result(self.path, self.known) as (_, file):
            if schema.STEPS not in file:
                return read_open_file(self.path, file)
            # Kept with what is told of the frames: it is estimated at the first one of each run that goes on.
            floor = next((record.get(schema.NOISE_FLOOR) for record in self.records if record["number"] == number),
                         None)
            known = {} if floor is None else {schema.NOISE_FLOOR: floor}
            frame = file[schema.frame_group(int(number))]
            if "deformed" not in frame[schema.TIME].attrs:
                raise ValueError(f"{frame.name}: no time")
            return read_open_file(self.path, file, rest=frame, pick=_build_row_reader(file, step), known=known)


def is_series_file(path: Path) -> bool:
    """Tell whether a file holds the frames of a series, be it one; what is no file, or damaged, does not."""
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
    known = FileStamps.take([as_path(path, "result")])
    with opened_result(path) as (name, file):
        return replace(_read_contents(name, file), known=known)


def read_frames(path: Path | str) -> Iterator[Result]:
    """Read the frames of a result file one after the other, whether it holds a series or a pair.

    Those are read that were measured; of a pair the one, with a UserWarning where it did not converge. Raises
    InputError where the file is missing, foreign, damaged or of a newer major schema.
    """
    series = read_series(path)
    return iter(series) if is_series_file(series.path) else iter([read_result(path)])


def _read_contents(path: Path, file: Any) -> SeriesResult:
    if schema.SERIES not in file or "records" not in file[schema.SERIES]:
        time = float(file[schema.TIME].attrs["deformed"])
        return SeriesResult(path, np.array([time]), np.array([1]), ({"number": 1, "time": time, "converged": True},))
    series = file[schema.SERIES]
    records = tuple(json.loads(text) for text in series["records"].asstr()[...])
    times, numbers = read_array(file[schema.STEPS]["Values"]), np.asarray(series.attrs["numbers"])
    require_sound_frames(times, numbers, records)
    return SeriesResult(path, times, numbers.astype(np.int64), records)


def _build_row_reader(file: Any, step: int) -> Callable[[Any], NDArray[Any]]:
    """A function that reads the rows of a step from a dataset of the geometry or of a field."""
    grid, steps = file[schema.VTKHDF], file[schema.STEPS]
    part, n_parts = int(steps["PartOffsets"][step]), int(steps["NumberOfParts"][step])
    point, cell = int(steps["PointOffsets"][step]), int(steps["CellOffsets"][step, 0])
    connectivity = int(steps["ConnectivityIdOffsets"][step, 0])
    n_points, n_cells, n_ids = (int(grid[name][part:part + n_parts].sum()) for name in schema.PIECES)
    # The first row and the number of rows.
    rows = {**dict.fromkeys(schema.PIECES, (part, n_parts)), "Points": (point, n_points), "Types": (cell, n_cells),
            "Offsets": (cell + part, n_cells + n_parts), "Connectivity": (connectivity, n_ids)}
    n_values = {"PointData": n_points, "CellData": n_cells}

    def read_rows(dataset: Any) -> NDArray[Any]:
        group, name = dataset.name.split("/")[-2:]
        begin, n = (int(steps[f"{group}Offsets/{name}"][step]), n_values[group]) if group in n_values else rows[name]
        return np.asarray(dataset[begin:begin + n])

    return read_rows


ROWS = 1 << 18
"""Nodes that are read at a time; a larger value takes more memory."""


def find_displacement_range(series: SeriesResult) -> tuple[Array, Array]:
    """Find the least and the largest displacement of a series, (dim,) each, pixels, y down.

    Nodes that were not measured do not count; nan where none was. The series has at least one frame.
    """
    with opened_result(series.path, series.known) as (_, file):
        dim = get_dim(file[schema.VTKHDF]["Types"])
        low, high = np.full(dim, np.nan), np.full(dim, np.nan)
        stored = file[schema.POINT_DATA][schema.DISPLACEMENT]
        require_sound_fields({schema.DISPLACEMENT: stored}, len(stored))
        for begin in range(0, len(stored), ROWS):
            displacement = stored[begin:begin + ROWS, :dim]
            low = np.fmin(low, np.fmin.reduce(displacement))
            high = np.fmax(high, np.fmax.reduce(displacement))
        if schema.is_flipped(file):
            low[1], high[1] = -high[1], -low[1]
    return low, high


@dataclass(frozen=True)
class SeriesHistory:
    """Numbers of the frames of a series; nan for those that were not measured.

    Attributes
    ----------
    times : (n,) array
        Unit chosen by the user.
    is_measured : (n,) array of bool
        Of each frame.
    lowest, highest, mean : (n, dim) array
        Displacement components of measured nodes, pixels.
    principal_strains : (n, dim) array
        Means over the measured specimen, the largest one first; of the logarithmic strain.
    residual : (n,) array
        Standard deviation, grey levels.
    noise_floor : (n,) array
        RMS displacement, pixels.
    iterations : (n,) array
        Of Gauss-Newton.
    """

    times: Array
    is_measured: BoolArray
    lowest: Array
    highest: Array
    mean: Array
    principal_strains: Array
    residual: Array
    noise_floor: Array
    iterations: Array


def gather_history(series: SeriesResult) -> SeriesHistory:
    """Gather what the frames of a series, at least one, come to, measured or not; they are read one after the other."""
    records = series.records
    is_measured = np.isin([record["number"] for record in records], series.numbers)
    measured = np.array([_measure_sizes(result) for result in series])
    sizes = np.full((len(records), *measured.shape[1:]), np.nan)
    sizes[is_measured] = measured

    def list_numbers(key: str) -> Array:
        # None becomes nan.
        return np.array([record.get(key) if measured else None
                         for record, measured in zip(records, is_measured, strict=True)], float)

    return SeriesHistory(
        times=np.array([record["time"] for record in records], float), is_measured=is_measured, lowest=sizes[:, 0],
        highest=sizes[:, 1], mean=sizes[:, 2], principal_strains=sizes[:, 3],
        residual=list_numbers("residual_std_grey"), noise_floor=list_numbers("noise_floor_px"),
        iterations=list_numbers("iterations"))


def _measure_sizes(result: Result) -> Array:
    """Least, largest and mean displacement and the mean principal strains, (4, dim); nan where nothing was measured."""
    displacement, dim = result.displacement[result.measured_nodes], result.mesh.dim
    if not len(displacement):
        return np.full((4, dim), np.nan)
    strains = [_average(result.mesh, result.point_data[name]) for name in schema.NODAL_PRINCIPAL[:dim]]
    return np.array([displacement.min(axis=0), displacement.max(axis=0), displacement.mean(axis=0), strains])


def _average(mesh: Mesh, values: Array) -> float:
    """Mean of values at nodes (n_nodes,) over the cells that know them all, by their areas or volumes."""
    areas, _ = measure_covered_areas(mesh)
    of_cells = np.add.reduceat(values[mesh.connectivity], mesh.offsets[:-1]) / np.diff(mesh.offsets)
    is_known = np.isfinite(of_cells)
    return float((areas * of_cells)[is_known].sum() / areas[is_known].sum()) if is_known.any() else float("nan")


def read_frame(path: Path, number: int | None = None, asked_by: str = "--frame") -> Result:
    """Read the result of a pair, or a frame of a series by its number, from 1.

    ``asked_by`` is the option or key that gives the number, for messages. Raises InputError where a series is given
    without a number, a pair with one, or the file does not hold that frame.
    """
    if not is_series_file(path):
        if number is not None and is_readable_file(path):
            raise InputError(f"{asked_by} {number}: {path} is the result of a pair, not of a series; leave it out")
        return read_result(path)
    series = read_series(path)
    if number is None:
        raise InputError(f"{path}: holds the frames {_list_numbers(series)} of a series; choose one by {asked_by}")
    found = np.flatnonzero(series.numbers == number)
    if len(found):
        return series[int(found[0])]
    failures = [str(record["failure"]) for record in series.records if record["number"] == number]
    reason = f"was not measured ({failures[0].partition(';')[0]})" if failures else "is none of this series"
    raise InputError(f"{asked_by} {number}: {path}: frame {number} {reason}; choose one of {_list_numbers(series)}")


def read_frame_or_last(path: Path, number: int | None, asked_by: str = "--frame") -> tuple[Result, str]:
    """Read the result of a pair, or a frame of a series: the last one that was measured unless another is asked for.

    ``number`` counts from 1, of a series only; ``asked_by`` is the option or key that gives it, for messages. Beside
    the field comes what to call it. Raises InputError where it cannot be read, a pair is given with a number, or the
    series does not hold that frame.
    """
    if number is None and is_series_file(path):
        series = read_series(path)
        return series[-1], f"{path}, frame {series.numbers[-1]}, the last one that was measured"
    frame = "" if number is None else f", frame {number}"
    return read_frame(path, number, asked_by), f"{path}{frame}"


def _list_numbers(series: SeriesResult) -> str:
    """Numbers of the frames that were measured, stretches of them as one."""
    stretches = np.split(series.numbers, np.flatnonzero(np.diff(series.numbers) > 1) + 1)
    return ", ".join(str(part[0]) if len(part) == 1 else f"{part[0]} to {part[-1]}" for part in stretches)
