"""A result file and what stands beside it, moved or removed together: the summary, what shows its images or units."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import h5py

from ddic.io import result_schema as schema
from ddic.io.json_file import write_json
from ddic.io.open_hdf5 import open_hdf5
from ddic.io.physical_sidecar import write_physical_sidecar
from ddic.io.replace_on_exit import replaced_together
from ddic.io.residual_sidecar import write_sidecar


def remove_result(result: Path) -> None:
    """Remove a result file and what stands beside it, as far as they are there.

    Parameters
    ----------
    result : Path
        The result file.
    """
    result.unlink(missing_ok=True)
    _remove_company(result)


def move_result(result: Path, target: Path) -> None:
    """Give a result file and what stands beside it another name, in place of what has that name.

    Parameters
    ----------
    result : Path
        The result file.
    target : Path
        Its new name, in the same folder.
    """
    # First, and at once: whatever fails afterwards, neither is lost.
    result.replace(target)
    _remove_company(target)
    for camera, sidecar in enumerate(list(_list_sidecars(result))):
        _write_moved_sidecar(sidecar, target, camera)
        sidecar.unlink()
    physical = schema.physical_path(result)
    if physical.is_file():
        physical.unlink()
        if _has_length_unit(target):
            with open_hdf5(target) as source, replaced_together() as files:
                write_physical_sidecar(target, source, files)
    summary = schema.summary_path(result)
    if summary.is_file():
        summary.rename(schema.summary_path(target))
        _write_new_name(schema.summary_path(target), target)


def _remove_company(result: Path) -> None:
    for path in (schema.summary_path(result), schema.physical_path(result), *_list_sidecars(result)):
        path.unlink(missing_ok=True)


def _list_sidecars(result: Path) -> Iterator[Path]:
    for camera in count():
        path = schema.sidecar_path(result, camera)
        if not path.is_file():
            return
        yield path


def _write_moved_sidecar(sidecar: Path, target: Path, camera: int) -> None:
    """Write anew what leads to a residual image by the name of its file."""
    with open_hdf5(sidecar) as file:
        _, last_column, _, last_row, _, _ = file[schema.VTKHDF].attrs["WholeExtent"]
        is_flipped = str(file.attrs["y_axis"]) == "up"
    with replaced_together() as files:
        write_sidecar(target, camera, width=int(last_column) + 1, height=int(last_row) + 1, flip_y=is_flipped,
                      files=files)


def _has_length_unit(result: Path) -> bool:
    """Whether a file holds displacements in a length unit; what is no result does not."""
    if not h5py.is_hdf5(result):
        return False
    with open_hdf5(result) as file:
        return schema.DISPLACEMENT_PHYSICAL in file.get(schema.POINT_DATA, ())


def _write_new_name(summary: Path, result: Path) -> None:
    try:
        content = json.loads(summary.read_text(encoding="utf-8"))
    except ValueError:
        # Whatever it is, it is not a summary that says a name.
        return
    if isinstance(content, dict) and "result_file" in content:
        write_json(summary, content | {"result_file": str(result)})
