"""The discontinuities that a result was measured with."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.result_reader import Result
from ddic.io.result_schema import CASE


def get_lines(result: Result) -> list[NDArray[np.float64]]:
    """Get the discontinuities that a result was measured with.

    Parameters
    ----------
    result : Result
        A measured field.

    Returns
    -------
    list of (n_vertices, 2) array
        Vertices, pixels; of lines that were found, as they were found.
    """
    case = json.loads(str(result.attributes.get(CASE, {}).get("json", "{}")))
    return [np.array(section["vertices"]) for section in case.get("discontinuity", ())]


def get_line(result: Result, number: int) -> NDArray[np.float64]:
    """Get one of the discontinuities that a result was measured with.

    Parameters
    ----------
    result : Result
        A measured field.
    number : int
        From 1.

    Returns
    -------
    (n_vertices, 2) array
        Vertices, pixels.

    Raises
    ------
    InputError
        Where there is no such line.
    """
    lines = get_lines(result)
    if not lines:
        raise InputError(f"{result.path}: was measured without discontinuities; give some in the case (where one was "
                         "to be found, the log says why none was)")
    if not 1 <= number <= len(lines):
        raise InputError(f"{result.path}: line {number}: there are {len(lines)}; give a number from 1 to {len(lines)}")
    return lines[number - 1]
