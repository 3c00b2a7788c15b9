"""A displacement to start from, as Python programs have it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.inputs.cameras import Camera
from ddic.inputs.start_points import StartPoints, check_start_points
from ddic.io.result_reader import Result
from ddic.parallel.team import Team
from ddic.start.given_start import GivenStart, keep_displacement

StartLike = Result | tuple[Any, Any]
"""A result, or points (n, 2) and their displacement (n, 2)."""

_NAME = "start"


def convert_start(team: Team, given: StartLike | None, far: Camera) -> GivenStart | None:
    """Look at a displacement that the user gave; collective.

    Parameters
    ----------
    team : Team
        All ranks, each with the same displacement.
    given : Result or pair of (n, 2) arrays
        What the user gave; pixels of the reference image.
    far : Camera
        Whose reference image it is.

    Returns
    -------
    EarlierResult, StartPoints or None
        None where nothing is given.

    Raises
    ------
    InputError
        On all ranks, where one of them has something else, or nothing.
    """
    converted = team.together(lambda: None if given is None else _convert(given, far))
    if team.sum(int(given is not None)) not in (0, team.size):
        raise InputError(f"{_NAME}: given on some of the ranks; under mpirun give it on every rank")
    return converted


def _convert(given: Any, far: Camera) -> GivenStart:
    if isinstance(given, Result):
        return keep_displacement(given, "the given result" if given.path == Path() else str(given.path))
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise InputError(f"{_NAME}: {type(given).__name__} given; give a result, or a pair (points, displacement) of "
                         "arrays (n, 2), pixels of the reference image")
    points, displacement = (_convert_array(array, what) for array, what in zip(given, ("points", "displacement"),
                                                                              strict=True))
    if points.shape != displacement.shape:
        raise InputError(f"{_NAME}: {len(points)} points and {len(displacement)} displacements; give one of each point")
    image = far.reference.image
    converted = StartPoints(points, displacement, _NAME)
    check_start_points(converted, image.width, image.height)
    return converted


def _convert_array(given: Any, what: str) -> NDArray[np.float64]:
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{_NAME}: {what}: {error}; give an array (n, 2) of numbers, pixels") from error
    if array.ndim != 2 or array.shape[1] != 2 or not len(array):
        raise InputError(f"{_NAME}: {what}: an array of shape {array.shape}, (n, 2) expected: x and y of each point, "
                         "pixels")
    return array
