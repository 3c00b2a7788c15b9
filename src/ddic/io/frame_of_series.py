"""One result where a file may hold those of a series: a frame by its number."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ddic.errors import InputError
from ddic.io.input_file import is_readable_file
from ddic.io.result_reader import Result, read_result
from ddic.io.series_reader import SeriesResult, is_series_file, read_series


def read_frame(path: Path, number: int | None = None, asked_by: str = "--frame") -> Result:
    """Read the result of a pair, or a frame of a series.

    Parameters
    ----------
    path : Path
        Result file.
    number : int, optional
        Of the frame, from 1; of a series only.
    asked_by : str, optional
        The option or key that gives the number, for messages.

    Returns
    -------
    Result
        One field.

    Raises
    ------
    InputError
        Where a series is given without a number, a pair with one, or the file does not hold that frame.
    """
    if not is_series_file(path):
        if number is not None and is_readable_file(path):
            raise InputError(f"{asked_by} {number}: {path} is the result of a pair, not of a series; leave it out")
        return read_result(path)
    series = read_series(path)
    if number is None:
        raise InputError(f"{path}: holds the frames {_list_numbers(series)} of a series; choose one by {asked_by}")
    return pick_frame(series, number, asked_by)


def pick_frame(series: SeriesResult, number: int, asked_by: str = "--frame") -> Result:
    """Pick a frame of a series.

    Parameters
    ----------
    series : SeriesResult
        Opened.
    number : int
        Of the frame, from 1.
    asked_by : str, optional
        The option or key that gives the number, for messages.

    Returns
    -------
    Result
        Its field.

    Raises
    ------
    InputError
        Where the series does not hold that frame.
    """
    found = np.flatnonzero(series.numbers == number)
    if len(found):
        return series[int(found[0])]
    failures = [str(record["failure"]) for record in series.records if record["number"] == number]
    reason = f"was not measured ({failures[0].partition(';')[0]})" if failures else "is none of this series"
    raise InputError(f"{asked_by} {number}: {series.path}: frame {number} {reason}; choose one of "
                     f"{_list_numbers(series)}")


def read_frame_or_last(path: Path, number: int | None, asked_by: str = "--frame") -> tuple[Result, str]:
    """Read the result of a pair, or a frame of a series: the last one that was measured unless another is asked for.

    Parameters
    ----------
    path : Path
        Of a pair or a series.
    number : int or None
        Of the frame, from 1; of a series only.
    asked_by : str, optional
        The option or key that gives the number, for messages.

    Returns
    -------
    result : Result
        Its field.
    name : str
        What to call it.

    Raises
    ------
    InputError
        Where it cannot be read, a pair is given with a number, or the series does not hold that frame.
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
