"""The motion of near-field set-ups: its start, Eq. 22 of [BP17], and its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, on_all_ranks
from ddic.kinematics.pose import Rig
from ddic.parallel.team import Team
from ddic.problem.cameras import Camera
from ddic.solvers.dual.motion import motion_scales
from ddic.solvers.gauss_newton import OwnedPart
from ddic.solvers.linear_step import Leave, Step
from ddic.solvers.local_system import LocalSystem

ENOUGH = Leave(1e-4)
"""Error of a field of about a pixel that is left in what makes the covariance: four digits of it."""


@dataclass(frozen=True)
class SetupMotion:
    """Measured motion of a near-field set-up between its pictures, T(Y) = X0 + R(theta) (Y - X0) + alpha.

    camera: its number; rig: phi and X0; alpha: (2,) px of the far image; theta: radians, 0 where it was not asked for.
    covariance: of (alpha_x, alpha_y) or (alpha_x, alpha_y, theta), px and radians.
    """

    camera: int
    rig: Rig
    alpha: NDArray[np.float64]
    theta: float
    covariance: NDArray[np.float64]


def start_of_motion(team: Team, cameras: Sequence[Camera], parts: Sequence[OwnedPart],
                    u: Sequence[NDArray[np.float64]], shared: NDArray[np.int64]) -> list[NDArray[np.float64]]:
    """Motion of each camera (n_shifts,) that leaves the least jumps between independent fields, Eq. 22 of [BP17].

    u: of the nodes as if no set-up had moved, (n_dofs,) each; shared: nodes of several cameras. Collective; raises
    InputError on all ranks where a camera shares too few nodes with others.
    """
    found = [(p.subdomain.camera, p.subdomain.node_ids[at], p.subdomain.nodes[at],
              u_s.reshape(-1, 2)[at]) for p, u_s in zip(parts, u, strict=True)
             for at in [np.isin(p.subdomain.node_ids, shared)]]
    pieces = team.gather_lists(found)
    n_shifts = [camera.rig.n_shifts for camera in cameras]
    first = np.concatenate([[0], np.cumsum(n_shifts)])
    rows: list[NDArray[np.float64]] = []
    jumps: list[NDArray[np.float64]] = []
    means = [_means([piece for piece in pieces if piece[0] == number]) for number in range(len(cameras))]
    for a in range(len(cameras)):
        for b in range(a + 1, len(cameras)):
            common, at_a, at_b = np.intersect1d(means[a][0], means[b][0], return_indices=True)
            if len(common) == 0:
                continue
            columns = np.zeros((2 * len(common), int(first[-1])))
            points = means[a][1][at_a]
            columns[:, first[a]:first[a + 1]] = cameras[a].rig.rigid_columns(points)
            columns[:, first[b]:first[b + 1]] = -cameras[b].rig.rigid_columns(points)
            rows.append(columns)
            jumps.append((means[a][2][at_a] - means[b][2][at_b]).ravel())
    columns = np.concatenate([*rows, np.zeros((0, int(first[-1])))])
    solution, _, rank, _ = np.linalg.lstsq(columns, np.concatenate([*jumps, np.zeros(0)]), rcond=1e-9)
    if rank < columns.shape[1]:
        raise on_all_ranks(InputError(
            "near: the elements of a near-field image share too few nodes with those of other images to tell how its "
            "set-up moved; enlarge the mesh around it, or give near.region"))
    return [solution[first[k]:first[k + 1]] for k in range(len(cameras))]


def covariance(team: Team, parts: Sequence[OwnedPart], systems: Sequence[LocalSystem], step: Step,
               noise: float) -> dict[int, NDArray[np.float64]]:
    """Covariance of every moving set-up's unknowns, (n_shifts, n_shifts), by camera; collective.

    The columns x = A^-1 e of the unknowns give 2 sigma^2 x^T M x: b has the covariance 2 sigma^2 M, since noise is
    in both pictures and M is weighted by the noise. noise: sigma of the first camera, grey levels.
    """
    found = {}
    for number, scale in motion_scales(team, systems).items():
        columns = []
        for k, kappa in enumerate(scale):
            # As large as what moves the set-up by about a pixel: steps start from their last solution.
            b = [kappa * _unit(p, number, k) for p in parts]
            columns.append([x / kappa for x in step.solve([np.zeros_like(v) for v in b], b, ENOUGH).dq])
        products = [np.stack([x[s] for x in columns], axis=1) for s in range(len(parts))]
        total = team.ordered_sum([x.T @ (system.hessian @ x) for x, system in zip(products, systems, strict=True)])
        found[number] = 2 * noise**2 * total
    return found


def setup_motions(cameras: Sequence[Camera], shifts: Sequence[NDArray[np.float64]],
                  covariances: dict[int, NDArray[np.float64]]) -> tuple[SetupMotion, ...]:
    """The motions in pixels and radians; shifts: unknowns of each camera's motion."""
    out = []
    for number, camera in enumerate(cameras):
        n = camera.rig.n_shifts
        if n == 0:
            continue
        units = np.array([1.0, 1.0, 1.0 / camera.rig.length])[:n]
        values = shifts[number] * units
        out.append(SetupMotion(number, camera.rig, values[:2], float(values[2]) if n == 3 else 0.0,
                               covariances[number] * np.outer(units, units)))
    return tuple(out)


def _unit(part: OwnedPart, camera: int, k: int) -> NDArray[np.float64]:
    """A unit right-hand side of one unknown of a camera's motion, on the one subdomain that owns it."""
    shifts = part.subdomain.shifts
    n = part.n_dofs
    b = np.zeros(n if shifts is None else n + len(shifts.numbers))
    if shifts is not None and shifts.owned and part.subdomain.camera == camera:
        b[n + k] = 1.0
    return b


def _means(pieces: list[tuple[int, NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]],
           ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Nodes of several subdomains of one camera: numbers, positions and mean displacements."""
    if not pieces:
        return np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2))
    numbers, place, inverse, counts = np.unique(np.concatenate([p[1] for p in pieces]), return_index=True,
                                                return_inverse=True, return_counts=True)
    values = np.concatenate([p[3] for p in pieces])
    mean = np.stack([np.bincount(inverse, values[:, axis], len(numbers)) for axis in range(2)], axis=1)
    return numbers, np.concatenate([p[2] for p in pieces])[place], mean / counts[:, None]
