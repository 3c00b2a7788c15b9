"""The start of near-field set-ups' motions: least jumps between independent fields, Eq. 22 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, as_collective
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.cameras import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _InterfaceField:
    """What subdomains of one camera say of unknowns on their interfaces.

    numbers: (n,) of the unknowns; values: (n,); columns: (n, n_motion), what its motion does to them.
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
    pieces = team.gather_lists([_interface_field(cameras[s.camera], s, field)
                                for s, field in zip(subdomains, fields, strict=True)])
    by_camera = [_mean_of_copies([piece for piece in pieces if piece.camera == camera.number]) for camera in cameras]
    n_motion_unknowns = [camera.setup.n_motion_unknowns for camera in cameras]
    first = np.concatenate([[0], np.cumsum(n_motion_unknowns)])
    n_columns = int(first[-1])
    rows = [np.zeros((0, n_columns))]
    jumps = [np.zeros(0)]
    for a, of_a in enumerate(by_camera):
        for b in range(a + 1, len(cameras)):
            of_b = by_camera[b]
            _, at_a, at_b = np.intersect1d(of_a.numbers, of_b.numbers, return_indices=True)
            columns = np.zeros((len(at_a), n_columns))
            columns[:, first[a]:first[a + 1]] = of_a.columns[at_a]
            columns[:, first[b]:first[b + 1]] = -of_b.columns[at_b]
            rows.append(columns)
            jumps.append(of_a.values[at_a] - of_b.values[at_b])
    motions, _, rank, _ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(jumps), rcond=1e-9)
    if rank < n_columns:
        raise as_collective(InputError(
            "near: the elements of a near-field image share too few nodes with those of other images to tell how its "
            "set-up moved; enlarge the mesh around it, or give near.region"))
    return [motions[first[k]:first[k + 1]] for k in range(len(cameras))]


def _interface_field(camera: Camera, subdomain: Subdomain, field: Array) -> _InterfaceField:
    """A subdomain's field and the columns of its camera's motion on its interface."""
    at = subdomain.jumps.unknowns
    kinematics = subdomain.kinematics
    n_motion = camera.setup.n_motion_unknowns
    columns = np.zeros((len(at), n_motion))
    for k, displacement in enumerate(camera.setup.motion_columns(subdomain.mesh.nodes).T):
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
