"""What tells that tables, products and attributes of a result file are damaged: they are not what they are read as."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema

_NUMBERS = {
    schema.CASE: (schema.NOISE_FLOOR, "eta", "largest_jump_px", "half_amplitude_shear_px",
                  "half_amplitude_longitudinal_px"),
    schema.UNITS: ("pixel_size",), schema.TIME: ("reference", "deformed"), schema.UNCERTAINTY: ("noise_grey",),
}
"""Attributes that are read as numbers, by group."""

_LENGTHS = ("pixel_size", "half_amplitude_shear_px", "half_amplitude_longitudinal_px")
"""Of these, what others divide by."""

_LONGEST = 1e9
"""Beyond which a length is damage: of a pixel in any unit, or of a wave in pixels."""

_LISTS = ("discontinuity", "near")
"""Sections of a case of which there may be several."""


def require_sound_tables(tables: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
    """Refuse tables whose columns are no numbers or do not have the same rows.

    Parameters
    ----------
    tables : mapping of str to dict of (n,) arrays
        Columns by name, of each group; those of the Krylov histories have each its own length.

    Raises
    ------
    ValueError
        With the table.
    """
    for group, columns in tables.items():
        for name, values in columns.items():
            kinds = "OSU" if (group, name) == (schema.PHASES, "phase") else "iuf"
            if values.ndim != 1 or values.dtype.kind not in kinds:
                raise ValueError(f"{group}/{name}: an array of {values.dtype}, shape {values.shape}")
        if group != schema.KRYLOV and len({len(values) for values in columns.values()}) > 1:
            raise ValueError(f"{group}: columns of different lengths")


def require_sound_frames(times: NDArray[Any], numbers: NDArray[Any], records: Sequence[Any]) -> None:
    """Refuse a series whose frames are not told of as they stand in the file.

    Parameters
    ----------
    times, numbers : (n,) arrays
        Of the frames that were measured.
    records : sequence of dict
        Of all frames.

    Raises
    ------
    ValueError, TypeError, KeyError
        With what is wrong.
    """
    if times.ndim != 1 or times.dtype.kind != "f" or times.shape != numbers.shape or not len(times):
        raise ValueError(f"{schema.STEPS}: times of shape {times.shape} for frames of shape {numbers.shape}")
    for record in records:
        _require_number("the time of a frame", record["time"], is_length=False)
        if not record["converged"]:
            str(record["failure"])
    told = {record["number"] for record in records if record["converged"]}
    if not set(numbers.tolist()) <= told:
        raise ValueError(f"{schema.SERIES}.numbers: {numbers.tolist()[:3]} and so on, of which not all are told of")


def require_sound_products(data: Mapping[str, NDArray[Any]]) -> None:
    """Refuse functions of x and y that make no displacement.

    Parameters
    ----------
    data : dict of (...) arrays
        Nodes, functions and amplitudes of PGD-DIC.

    Raises
    ------
    ValueError
        With what is wrong.
    """
    for name, values in data.items():
        if values.dtype.kind != "f" or not np.isfinite(values).all():
            raise ValueError(f"{schema.SEPARATED}/{name}: finite numbers expected")
    for axis in "xy":
        nodes = data[f"nodes_{axis}"]
        if nodes.ndim != 1 or len(nodes) < 2 or not (np.diff(nodes) > 0).all():
            raise ValueError(f"{schema.SEPARATED}/nodes_{axis}: ascending numbers expected")
    amplitudes = data["amplitudes"]
    wanted = {"amplitudes": (len(amplitudes), 2) if amplitudes.ndim else (0, 2),
              **{axis: (*amplitudes.shape, len(data[f"nodes_{axis}"])) for axis in "xy"}}
    for name, shape in wanted.items():
        if data[name].shape != shape:
            raise ValueError(f"{schema.SEPARATED}/{name}: an array of shape {data[name].shape}, {shape} expected")


def require_sound_attributes(attributes: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse attributes that others read as numbers or as a case and that are none.

    Parameters
    ----------
    attributes : mapping
        Of groups.

    Raises
    ------
    ValueError, TypeError, KeyError
        Where they are something else.
    """
    for group, values in attributes.items():
        if group.startswith(schema.NEAR_PREFIX):
            _require_motion(group, values)
            continue
        for name, value in values.items():
            if np.ndim(value):
                raise ValueError(f"{group}.{name}: {np.ndim(value)} dimensions, one value expected")
    for group, names in _NUMBERS.items():
        for name in names:
            if name in attributes.get(group, {}):
                _require_number(f"{group}.{name}", attributes[group][name], is_length=name in _LENGTHS)
    _require_case(json.loads(str(attributes.get(schema.CASE, {}).get("json", "{}"))))


def _require_number(name: str, value: Any, *, is_length: bool) -> None:
    if np.asarray(value).dtype.kind not in "iuf":
        raise ValueError(f"{name}: a number expected")
    if is_length and not 0.0 <= float(value) <= _LONGEST:
        raise ValueError(f"{name}: {value:g} is no length")


def _require_motion(group: str, values: Mapping[str, Any]) -> None:
    """Refuse a motion of a near set-up that is none."""
    if "alpha_px" in values and np.asarray(values["alpha_px"], np.float64).shape != (2,):
        raise ValueError(f"{group}.alpha_px: two numbers expected")
    if "theta_rad" in values:
        _require_number(f"{group}.theta_rad", values["theta_rad"], is_length=False)


def _require_case(case: Any) -> None:
    """Refuse what is no case: sections by name, of keys by name."""
    if not isinstance(case, dict):
        raise TypeError("case.json: sections expected")
    for name, section in case.items():
        inner = section if name in _LISTS and isinstance(section, list) else [section]
        if name != "title" and not all(one is None or isinstance(one, dict) for one in inner):
            raise ValueError(f"case.json: {name} is no section")
    for section in case.get("discontinuity", ()):
        vertices = np.array(section["vertices"], dtype=float)
        if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 2 or not np.isfinite(vertices).all():
            raise ValueError("case.json: a discontinuity has no vertices")
