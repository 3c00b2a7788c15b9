"""``ddic info``: what a result file, a series or an image holds; ``ddic report``: one page on a measurement."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ddic.cli.app import frame_option
from ddic.cli.failures import failures_as_lines, warnings_as_lines
from ddic.errors import InputError

if TYPE_CHECKING:
    from ddic.arrays import Array
    from ddic.io.result_reader import Result
    from ddic.io.series_reader import SeriesResult


Lines = list[tuple[str, str]]

MOST_MODES = 10
"""Modes of PGD-DIC whose sizes are listed."""


@click.command()
@click.argument("file", metavar="FILE", type=click.Path(path_type=Path))
@frame_option
def info(file: Path, frame: int | None) -> None:
    """Describe a result file, an image or a volume: size, type, range, saturation, gradient energy.

    Of a series: its frames, in a table, and what all have in common; one of them with --frame.
    """
    with failures_as_lines(), warnings_as_lines():
        lines = _describe(file, frame)
    for line in lines:
        click.echo(line)


def _format(lines: Lines) -> list[str]:
    """Names and values in two columns."""
    return [f"{name:<27} {value}" for name, value in lines]


def _describe(file: Path, frame: int | None) -> list[str]:
    """What a file holds, in lines."""
    # Imported here because HDF5 and OpenCV are not needed by --help.
    from ddic.io.input_file import require_file, split_dataset
    from ddic.io.series_reader import is_series_file, read_frame, read_series

    if not file.is_dir():
        require_file(split_dataset(file)[0], "file")
    if file.is_dir() or not _is_result(file):
        if frame is not None:
            raise InputError(f"--frame {frame}: {file} is no result file; leave it out")
        return _format(_image_lines(file))
    if frame is None and is_series_file(file):
        return _list_series_lines(read_series(file))
    return _format(_result_lines(read_frame(file, frame)))


def _is_result(file: Path) -> bool:
    """Whether it is an HDF5 file with what results have, or called as they are."""
    import h5py

    from ddic.io.result_schema import VTKHDF

    try:
        if not h5py.is_hdf5(file):
            return False
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({os.strerror(error.errno) if error.errno else error}); check its "
                         "permissions") from error
    # Who reads a damaged file says what is wrong with it.
    with suppress(OSError, RuntimeError, KeyError), h5py.File(file, "r") as opened:
        return VTKHDF in opened or file.suffix == ".vtkhdf"
    return True


def _image_lines(file: Path) -> Lines:
    """Of an image or a volume."""
    from ddic.images.binned import ArraySource
    from ddic.images.grey_levels import measure_grey_levels
    from ddic.io.image_file import ImageFile
    from ddic.io.volume_file import is_volume, open_source

    dim = 3 if is_volume(file) else 2
    image, pixels = open_source(file, dim)
    n_bits = image.layout.bits if isinstance(image, ImageFile) else 8 * image.dtype.itemsize
    report = measure_grey_levels(image if pixels is None else ArraySource(file, pixels, image.saturation))
    saturated = "none possible (floating point)"
    if report.saturation is not None:
        saturated = f"{100 * report.n_saturated / image.extent.n_pixels:.3f} % (at {report.saturation:.0f})"
    return [
        ("image" if dim == 2 else "volume", str(file)),
        ("size", f"{image.extent.describe()} px"),
        ("type", f"{image.dtype}, {n_bits} bit"),
        ("range", f"{report.lowest:g} to {report.highest:g} grey levels, mean {report.mean:.4g}"),
        ("saturated", saturated),
        ("not finite", f"{report.n_not_finite} px"),
        ("gradient energy", f"{report.gradient_energy:.4g} (grey level / px)^2, mean of |grad f|^2"),
    ]


def _list_series_lines(series: SeriesResult) -> list[str]:
    """What all frames of a series, at least one, come to, a table of them, and what the first of them holds."""
    # Imported here because HDF5 is not needed by --help.
    from ddic.io.series_reader import find_displacement_range

    times = [float(record["time"]) for record in series.records]
    n_failed = len(series.records) - len(series)
    failed = f", {n_failed} of them not measured" if n_failed else ""
    low, high = find_displacement_range(series)
    of_all = [
        ("series", str(series.path)),
        ("frames", f"{len(series.records)}{failed}"),
        ("times", f"{times[0]:g} to {times[-1]:g}"),
        *((name, f"{text} in all frames") for name, text in _list_ranges(low, high)),
    ]
    said = ("result", *(name for name, _ in _list_ranges(low, high)))
    of_first = [line for line in _result_lines(series[0]) if line[0] not in said]
    return [*_format(of_all), *_list_frame_rows(series), f"of frame {series.numbers[0]}:", *_format(of_first)]


def _list_ranges(low: Array, high: Array) -> Lines:
    """Least and largest displacement along each axis, (dim,) each, pixels."""
    return [(f"displacement {axis}", f"{first:.4f} to {last:.4f} px")
            for axis, first, last in zip("xyz", low, high, strict=False)]


def _find_residual(result: Result) -> float | None:
    """Standard deviation of the residual image, grey levels; None without one.

    Of a volume's, which takes long to read, that before the last correction.
    """
    import numpy as np

    if result.mesh.dim == 3:
        values = result.gauss_newton.get("residual_std_grey", np.empty(0)) if result.residual_extent else np.empty(0)
        return next((float(value) for value in values[::-1] if np.isfinite(value)), None)
    image = result.residual_image
    return float(np.nanstd(image)) if image is not None and np.isfinite(image).any() else None


def _result_lines(result: Result) -> Lines:
    """Of a result."""
    import numpy as np

    from ddic.fracture.opening import get_lines

    low, high = np.fmin.reduce(result.displacement), np.fmax.reduce(result.displacement)
    n_unmeasured = int((~result.measured_nodes).sum())
    unmeasured = [("not measured", f"{n_unmeasured} nodes, whose cells all are excluded")] if n_unmeasured else []
    residual = _find_residual(result)
    cut = [(f"discontinuity {number}", " to ".join(f"({x:.2f}, {y:.2f})" for x, y in line) + " px")
           for number, line in enumerate(get_lines(result), start=1)]
    lines = [
        ("result", str(result.path)),
        *([] if result.converged else [("status", f"NOT CONVERGED: {result.failure}")]),
        *([] if result.verdict is None or not result.converged else [("verdict", result.verdict.describe())]),
        ("mesh", f"{result.mesh.n_nodes} nodes, {result.mesh.n_cells} cells, {result.mesh.n_dofs} unknowns"),
        ("subdomains", str(result.n_subdomains)),
        ("y axis in the file", "up" if result.flipped else "down"),
        *_list_ranges(low, high),
        *unmeasured,
        *cut,
    ]
    if residual is not None:
        lines.append(("residual", f"standard deviation {residual:.4g} grey levels"))
    lines += [(f"{place} field", name) for place, fields in (("node", result.point_data),
                                                             ("cell", result.cell_data)) for name in fields]
    if result.separated is not None:
        separated, n_corrections = result.separated, len(result.corrections.get("correction", ()))
        lines.append(("PGD-DIC", f"{separated.n_modes} modes after {n_corrections} corrections, functions of "
                                 f"{separated.along_x.n_nodes} and {separated.along_y.n_nodes} nodes"))
        amplitudes = np.sqrt((separated.amplitudes**2).sum(axis=1))
        lines.append(("RMS of modes", ", ".join(f"{size:.3g}" for size in amplitudes[:MOST_MODES]) + " px"))
    else:
        table = result.gauss_newton
        n_local = int(sum(table.get("of_slow_nodes", ())))
        alone = f", {n_local} of them of slow nodes alone" if n_local else ""
        lines += [("Gauss-Newton", f"{max(map(len, table.values()), default=0)} iterations{alone}"),
                  ("Krylov", ", ".join(str(max(len(h) - 1, 0)) for h in result.krylov) or "none")]
    for group, values in result.attributes.items():
        lines += [(f"{group}.{name}", _short(value)) for name, value in sorted(values.items())]
    return lines


def _short(value: Any) -> str:
    """One line for an attribute: long texts (the case file) are told by their length."""
    text = str(value.tolist() if hasattr(value, "tolist") else value)
    return text if "\n" not in text and len(text) <= 100 else f"text of {len(text)} characters"


COLUMNS = ("frame", "time", "image", "iterations", "residual", "noise floor/px", "started from")
"""Heads of the table; the residual in grey levels, as in the log."""

TEXTS = ("image", "started from")
"""Columns that begin where their heads begin; numbers end where theirs end."""


def _list_frame_rows(series: SeriesResult) -> list[str]:
    """List the frames of a series as lines of a table, below a head; where one was not measured, its line says why."""
    rows = [_list_cells(record) for record in series.records]
    widths = [max(len(head), *(len(row[k]) for row in rows if k < len(row) - 1 or len(row) == len(COLUMNS)))
              for k, head in enumerate(COLUMNS)]
    aligned = [[cell.ljust(width) if head in TEXTS else cell.rjust(width)
                for cell, head, width in zip(row, COLUMNS, widths, strict=False)] for row in (list(COLUMNS), *rows)]
    return ["  ".join(row).rstrip() for row in aligned]


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


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@click.option("--image", type=click.Path(path_type=Path),
              help="Reference image; by default the one named in the result, if it is still there.")
@frame_option
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False),
              help="Page to write; by default RESULT.report.html beside it.")
def report(file: Path, image: Path | None, frame: int | None, output: Path | None) -> None:
    """Write one self-contained HTML page on a result: fields, residual, convergence, what guides ask to be stated.

    Of a series its last frame is taken where --frame names none.
    """
    # Imported here because matplotlib is not needed by --help.
    from ddic.case.own_outputs import PAGE, require_own_output
    from ddic.io.series_reader import read_frame_or_last
    from ddic.report.page import write_report

    target = file.parent / f"{file.stem}.report.html" if output is None else output
    with failures_as_lines(target), warnings_as_lines():
        require_own_output(target, PAGE, (file, image))
        result, _ = read_frame_or_last(file, frame)
        write_report(result, target, image)
    click.echo(target)

