"""What ``ddic info`` says of a series: of all frames, and a table of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ddic.io.series_reader import SeriesResult

COLUMNS = ("frame", "time", "image", "iterations", "residual", "noise floor/px", "started from")
"""Heads of the table; the residual in grey levels, as in the log."""

TEXTS = ("image", "started from")
"""Columns that begin where their heads begin; numbers end where theirs end."""


def describe_frames(series: SeriesResult) -> list[tuple[str, str]]:
    """Describe what all frames of a series come to.

    Parameters
    ----------
    series : SeriesResult
        Of at least one frame.

    Returns
    -------
    list of (str, str)
        Names and values.
    """
    # Imported here because HDF5 is not needed by --help.
    from ddic.io.series_reader import find_displacement_range

    times = [float(record["time"]) for record in series.records]
    n_failed = len(series.records) - len(series)
    failed = f", {n_failed} of them not measured" if n_failed else ""
    low, high = find_displacement_range(series)
    return [
        ("series", str(series.path)),
        ("frames", f"{len(series.records)}{failed}"),
        ("times", f"{times[0]:g} to {times[-1]:g}"),
        ("displacement x", f"{low[0]:.4f} to {high[0]:.4f} px in all frames"),
        ("displacement y", f"{low[1]:.4f} to {high[1]:.4f} px in all frames"),
    ]


def list_frame_rows(series: SeriesResult) -> list[str]:
    """List the frames of a series as lines of a table.

    Parameters
    ----------
    series : SeriesResult
        With the records of its frames.

    Returns
    -------
    list of str
        A head, and a line each; why it was not measured in place of its numbers.
    """
    rows = [_list_cells(record) for record in series.records]
    widths = [max(len(head), *(len(row[k]) for row in rows if k < len(row) - 1 or len(row) == len(COLUMNS)))
              for k, head in enumerate(COLUMNS)]
    aligned = [[_align(*cell) for cell in zip(row, COLUMNS, widths, strict=False)] for row in (list(COLUMNS), *rows)]
    return ["  ".join(row).rstrip() for row in aligned]


def _align(cell: str, head: str, width: int) -> str:
    return cell.ljust(width) if head in TEXTS else cell.rjust(width)


def _list_cells(record: Mapping[str, Any]) -> list[str]:
    """Cells of a row; fewer where a frame was not measured: the last one says why."""
    begin = [str(record["number"]), f"{record['time']:g}", Path(str(record.get("image", ""))).name]
    if not record["converged"]:
        reason = "; ".join(str(record["failure"]).splitlines())
        return [*begin, f"not measured: {reason}"]
    return [*begin, str(record.get("iterations", "")), _format_number(record.get("residual_std_grey"), ".3f"),
            _format_number(record.get("noise_floor_px"), ".4f"), str(record.get("started_from", ""))]


def _format_number(value: float | None, form: str) -> str:
    """A number, or a dash where it is not known (null in the record)."""
    return "-" if value is None else format(value, form)
