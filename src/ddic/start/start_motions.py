"""The start of near-field set-ups' motions: least jumps between independent fields, Eq. 22 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, as_collective
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.cameras import Camera

Array = NDArray[np.float64]

SMALLEST_SINGULAR_VALUE = 1e-9
"""Of what motions do to jumps, relative to the largest, below which jumps do not tell a motion. A larger value refuses
more meshes."""


@dataclass(frozen=True)
class _InterfaceField:
    """What subdomains of one camera say of n unknowns on their interfaces.

    Attributes
    ----------
    camera : int
        Number of the camera.
    numbers : (n,) array of int64
        Of the unknowns.
    values : (n,) array
        Of the unknowns.
    columns : (n, n_motion_unknowns) array
        What the camera's motion does to them.
    """

    camera: int
    numbers: NDArray[np.int64]
    values: Array
    columns: Array


def start_motions(team: Team, cameras: Sequence[Camera], subdomains: Sequence[Subdomain],
                  fields: Sequence[Array]) -> list[Array]:
    """Find the motion of each camera that leaves the least jumps between independent fields, Eq. 22 of [BP17].

    Parameters
    ----------
    team : Team
        All ranks.
    cameras : sequence of Camera
        All of them.
    subdomains : sequence of Subdomain
        Owned ones.
    fields : sequence of (n_field,) array
        Field of each, as if no set-up had moved.

    Returns
    -------
    list of (n_motion_unknowns,) array
        Of each camera, on all ranks.

    Raises
    ------
    InputError
        On all ranks, where a camera shares too few unknowns with others.
    """
    owned = team.together(lambda: [_interface_field(cameras[subdomain.camera], subdomain, field)
                                   for subdomain, field in zip(subdomains, fields, strict=True)])
    pieces = team.gather_lists(owned)
    by_camera = [_mean_of_copies([piece for piece in pieces if piece.camera == camera.number]) for camera in cameras]
    n_motion_unknowns = [camera.setup.n_motion_unknowns for camera in cameras]
    columns, jumps = _find_jumps(by_camera, n_motion_unknowns)
    motions, _, rank, _ = np.linalg.lstsq(columns, jumps, rcond=SMALLEST_SINGULAR_VALUE)
    if rank < sum(n_motion_unknowns):
        raise as_collective(InputError(
            "near: the elements of a near-field image share too few nodes with those of other images to tell how its "
            "set-up moved; enlarge the mesh around it, or give near.region"))
    return np.split(motions, np.cumsum(n_motion_unknowns)[:-1])


def _find_jumps(by_camera: Sequence[_InterfaceField], n_motion_unknowns: Sequence[int]) -> tuple[Array, Array]:
    """What all motions do to the jumps between each two cameras, (n, n motion unknowns), and these jumps, (n,)."""
    ends = np.cumsum(n_motion_unknowns)
    of_camera = [slice(end - n, end) for end, n in zip(ends, n_motion_unknowns, strict=True)]
    n_columns = int(ends[-1])
    columns = [np.zeros((0, n_columns))]
    jumps = [np.zeros(0)]
    for (a, of_a), (b, of_b) in combinations(enumerate(by_camera), 2):
        _, at_a, at_b = np.intersect1d(of_a.numbers, of_b.numbers, return_indices=True)
        between = np.zeros((len(at_a), n_columns))
        between[:, of_camera[a]] = of_a.columns[at_a]
        between[:, of_camera[b]] = -of_b.columns[at_b]
        columns.append(between)
        jumps.append(of_a.values[at_a] - of_b.values[at_b])
    return np.concatenate(columns), np.concatenate(jumps)


def _interface_field(camera: Camera, subdomain: Subdomain, field: Array) -> _InterfaceField:
    """A subdomain's field and the columns of its camera's motion on its interface."""
    at = subdomain.jumps.unknowns
    kinematics = subdomain.kinematics
    displacements = camera.setup.motion_columns(subdomain.mesh.nodes).T
    columns = np.zeros((len(at), len(displacements)))
    for k, displacement in enumerate(displacements):
        columns[:, k] = kinematics.fit(displacement)[at]
    return _InterfaceField(camera.number, kinematics.numbers[at], field[at], columns)


def _mean_of_copies(pieces: Sequence[_InterfaceField]) -> _InterfaceField:
    """One value for each unknown from the subdomains of one camera."""
    if not pieces:
        return _InterfaceField(-1, np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0)))
    all_numbers = np.concatenate([piece.numbers for piece in pieces])
    all_values = np.concatenate([piece.values for piece in pieces])
    all_columns = np.concatenate([piece.columns for piece in pieces])
    numbers, place, copy_of, counts = np.unique(all_numbers, return_index=True, return_inverse=True,
                                                return_counts=True)
    sums = np.bincount(copy_of.reshape(-1), all_values, len(numbers))
    return _InterfaceField(pieces[0].camera, numbers, sums / counts, all_columns[place])
