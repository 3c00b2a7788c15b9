"""How a camera sees unknowns that live in the specimen's frame, and the motion of its set-up between two pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.images.camera import CameraMapping
from ddic.kinematics.tie import Tie
from ddic.mesh.mesh import Mesh

Motion = Literal["none", "translation", "rigid"]

N_SHIFTS: dict[Motion, int] = {"none": 0, "translation": 2, "rigid": 3}
"""Unknowns of a set-up's motion: alpha_x, alpha_y, and theta times ``Rig.length``."""


@dataclass(frozen=True)
class Rig:
    """A camera, and how its set-up may move between its two pictures.

    A point that lies at Y in the specimen's frame is seen at phi(T(Y)), T(Y) = X0 + R(theta) (Y - X0) + alpha.

    mapping: phi, from the specimen's frame to the camera's pixels; motion: which of alpha and theta are unknown.
    centre: X0, (2,); length: half the diagonal of what the camera sees, by which theta is multiplied so that all
    unknowns of the motion are pixels of the specimen's frame.
    """

    mapping: CameraMapping
    motion: Motion
    centre: NDArray[np.float64]
    length: float

    @property
    def n_shifts(self) -> int:
        """Number of unknowns of the motion."""
        return N_SHIFTS[self.motion]

    def moved(self, points: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float64]:
        """T(Y) of points (n, 2) for the motion's unknowns (n_shifts,), specimen's frame."""
        if self.n_shifts == 0:
            return points
        if self.n_shifts == 2:
            return np.asarray(points + shift)
        angle = float(shift[2]) / self.length
        c, s = np.cos(angle), np.sin(angle)
        return np.asarray(self.centre + (points - self.centre) @ np.array([[c, s], [-s, c]]) + shift[:2])

    def unmoved(self, points: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float64]:
        """Y with T(Y) = points, (n, 2)."""
        if self.n_shifts < 3:
            return np.asarray(points - shift) if self.n_shifts else points
        angle = float(shift[2]) / self.length
        c, s = np.cos(angle), np.sin(angle)
        return np.asarray(self.centre + (points - shift[:2] - self.centre) @ np.array([[c, -s], [s, c]]))

    def rigid_columns(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """R: derivative of T by the motion's unknowns at rest, (2 n, n_shifts)."""
        n = len(points)
        columns = np.zeros((n, 2, self.n_shifts))
        if self.n_shifts:
            columns[:, 0, 0] = columns[:, 1, 1] = 1.0
        if self.n_shifts == 3:
            arm = (points - self.centre) / self.length
            columns[:, 0, 2], columns[:, 1, 2] = -arm[:, 1], arm[:, 0]
        return columns.reshape(2 * n, self.n_shifts)


@dataclass(frozen=True)
class Pose:
    """One subdomain before one camera.

    rig: the camera; nodes: X, (n_nodes, 2), specimen's frame; image_nodes: phi(X), (n_nodes, 2), the camera's pixels.
    tangent: (n_dofs, n_unknowns), d(displacement in the image) by the unknowns (u of the nodes, motion) at rest; it
    stays as it is over Gauss-Newton, as grad f does. weight: of this camera's squared grey levels in the functional.
    tie: from the unknown nodes to the nodes, None where they are the same.
    """

    rig: Rig
    nodes: NDArray[np.float64]
    image_nodes: NDArray[np.float64]
    tangent: sparse.csr_matrix
    weight: float
    tie: Tie | None = None

    def displacement(self, unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        """phi(T(X + u)) - phi(X) at the nodes, (n_dofs,), the camera's pixels; unknowns: (n_unknowns,)."""
        n = self.nodes.size if self.tie is None else self.tie.nodes.size
        u = unknowns[:n] if self.tie is None else self.tie.matrix @ unknowns[:n]
        points = self.nodes + u.reshape(self.nodes.shape)
        seen = self.rig.mapping.to_image(self.rig.moved(points, unknowns[n: n + self.rig.n_shifts]))
        return np.asarray(seen - self.image_nodes).ravel()

    def unknowns(self, displacement: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float64]:
        """Nodal u (n_dofs,) from a displacement in the image, pixels, and the motion (n_shifts,)."""
        points = self.rig.mapping.to_specimen(self.image_nodes + displacement.reshape(self.nodes.shape))
        u = np.asarray(self.rig.unmoved(points, shift) - self.nodes).ravel()
        return u if self.tie is None else np.asarray(self.tie.inverse @ u)


def pose(rig: Rig, nodes: NDArray[np.float64], weight: float, n_more: int = 0, tie: Tie | None = None) -> Pose:
    """Place nodes (n, 2), specimen's frame, before a camera.

    n_more: unknowns of another camera's motion, on which what this one sees does not depend. tie: from unknown nodes
    to these, None where they are the same.
    """
    n = len(nodes)
    blocks = rig.mapping.jacobian(nodes)
    derivative = sparse.bsr_matrix((blocks, np.arange(n), np.arange(n + 1)), shape=(2 * n, 2 * n))
    columns = [derivative if tie is None else derivative @ tie.matrix,
               sparse.csr_matrix(derivative @ rig.rigid_columns(nodes)), sparse.csr_matrix((2 * n, n_more))]
    return Pose(rig, nodes, rig.mapping.to_image(nodes), sparse.hstack(columns).tocsr(), weight, tie)


def seen_mesh(mesh: Mesh, placed: Pose) -> Mesh:
    """The mesh in the camera's pixels: edges stay straight, which a perspective keeps and distortion bends little."""
    return Mesh(placed.image_nodes, mesh.connectivity, mesh.offsets, mesh.types)
