"""How a camera sees unknowns that live in the specimen's frame, and the motion of its set-up between two pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.images.camera import CameraMapping
from ddic.kinematics.kinematics import Kinematics
from ddic.kinematics.seen_lines import see_parts
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_rotation

MotionKind = Literal["none", "translation", "rigid"]

N_MOTION_UNKNOWNS: dict[MotionKind, int] = {"none": 0, "translation": 2, "rigid": 3}
"""Unknowns of a set-up's motion: alpha_x, alpha_y, and theta times ``CameraSetup.length``."""


@dataclass(frozen=True)
class CameraSetup:
    """A camera, and how its set-up may move between its two pictures.

    A point that lies at Y in the specimen's frame is seen at phi(T(Y)), T(Y) = X0 + R(theta) (Y - X0) + alpha.

    Attributes
    ----------
    mapping : CameraMapping
        phi, from the specimen's frame to the camera's pixels.
    motion : MotionKind
        Which of alpha and theta are unknown.
    centre : (2,) array
        X0, specimen's frame.
    length : float
        Half the diagonal of what the camera sees, by which theta is multiplied so that all unknowns of the motion are
        pixels of the specimen's frame.
    """

    mapping: CameraMapping
    motion: MotionKind
    centre: NDArray[np.float64]
    length: float

    @property
    def n_motion_unknowns(self) -> int:
        """Number of unknowns of the motion."""
        return N_MOTION_UNKNOWNS[self.motion]

    def hold_still(self) -> CameraSetup:
        """Give the camera as if its set-up did not move between its pictures.

        Returns
        -------
        CameraSetup
            Without unknowns of a motion.
        """
        return replace(self, motion="none")

    def move(self, points: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply the motion T to points, Eq. 20 of [BP17].

        Parameters
        ----------
        points : (n, 2) array
            Points Y, specimen's frame.
        motion : (n_motion_unknowns,) array
            Unknowns of the motion, pixels of the specimen's frame.

        Returns
        -------
        (n, 2) array
            T(Y).
        """
        if self.n_motion_unknowns == 0:
            return points
        if self.n_motion_unknowns == 2:
            return np.asarray(points + motion)
        arms = points - self.centre
        turned = arms @ self._rotation(motion).T
        return np.asarray(self.centre + turned + motion[:2])

    def move_back(self, points: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Undo the motion T.

        Parameters
        ----------
        points : (n, 2) array
            Points T(Y), specimen's frame.
        motion : (n_motion_unknowns,) array
            Unknowns of the motion, pixels of the specimen's frame.

        Returns
        -------
        (n, 2) array
            Y.
        """
        if self.n_motion_unknowns == 0:
            return points
        if self.n_motion_unknowns == 2:
            return np.asarray(points - motion)
        turned = points - motion[:2] - self.centre
        # The inverse of a rotation is its transpose.
        arms = turned @ self._rotation(motion)
        return np.asarray(self.centre + arms)

    def motion_columns(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Differentiate T by the motion's unknowns at rest: R of Eq. 20 of [BP17].

        Parameters
        ----------
        points : (n, 2) array
            Points Y, specimen's frame.

        Returns
        -------
        (2 n, n_motion_unknowns) array
            R, no unit.
        """
        n_points = len(points)
        columns = np.zeros((n_points, 2, self.n_motion_unknowns))
        if self.n_motion_unknowns:
            columns[:, 0, 0] = 1.0
            columns[:, 1, 1] = 1.0
        if self.n_motion_unknowns == 3:
            arm = (points - self.centre) / self.length
            columns[:, 0, 2] = -arm[:, 1]
            columns[:, 1, 2] = arm[:, 0]
        return columns.reshape(2 * n_points, self.n_motion_unknowns)

    def _rotation(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        return build_rotation(float(motion[2]) / self.length)


@dataclass(frozen=True, eq=False)
class CameraKinematics(Kinematics):
    """Displacement of a subdomain's nodes in a camera's pixels.

    The unknowns are the field's, then those of motions; T stays as it is at rest over Gauss-Newton, as grad f does.

    Attributes
    ----------
    field : Kinematics
        From the field's unknowns to displacements in the specimen's frame.
    setup : CameraSetup
        The camera.
    mesh : Mesh
        The subdomain's mesh in the camera's pixels.
    numbers : (n_unknowns,) array of int64
        Numbers of all unknowns in the whole problem.
    matrix : (mesh.n_dofs, n_unknowns) csr_matrix
        The tangent T at rest.
    """

    field: Kinematics
    setup: CameraSetup
    mesh: Mesh
    numbers: NDArray[np.int64]
    matrix: sparse.csr_matrix

    @property
    def tangent(self) -> sparse.csr_matrix:
        """Derivative of the displacement in the image by the unknowns at rest, (mesh.n_dofs, n_unknowns)."""
        return self.matrix

    def displacement(self, unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displace the nodes in the image, phi(T(X + u)) - phi(X)."""
        nodes = self.field.mesh.nodes
        u = self.field.displacement(unknowns[:self.field.n_unknowns])
        moved = self.setup.move(nodes + u.reshape(nodes.shape), self._own_motion(unknowns))
        return np.asarray(self.setup.mapping.to_image(moved) - self.mesh.nodes).ravel()

    def fit(self, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
        """Find the field's unknowns that explain a displacement in the image, the motion's being zero."""
        return self.fit_with_motion(displacement, np.zeros(self.n_unknowns - self.field.n_unknowns))

    def fit_with_motion(self, displacement: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Find the field's unknowns that explain a displacement in the image beside a motion.

        Parameters
        ----------
        displacement : (mesh.n_dofs,) array
            Displacement of the nodes, the camera's pixels.
        motion : (n_unknowns - field.n_unknowns,) array
            Unknowns of motions, pixels of the specimen's frame.

        Returns
        -------
        (n_unknowns,) array
            Unknowns of the field, then the motions given.
        """
        nodes = self.field.mesh.nodes
        seen = self.mesh.nodes + displacement.reshape(nodes.shape)
        points = self.setup.mapping.to_specimen(seen)
        points = self.setup.move_back(points, motion[:self.setup.n_motion_unknowns])
        field_unknowns = self.field.fit(np.asarray(points - nodes).ravel())
        return np.concatenate([field_unknowns, motion])

    def hold_still(self) -> CameraKinematics:
        """Give the same for a set-up that does not move between its pictures."""
        return place_before_camera(self.field, self.setup.hold_still())

    def _own_motion(self, unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        first = self.field.n_unknowns
        return unknowns[first:first + self.setup.n_motion_unknowns]


def place_before_camera(field: Kinematics, setup: CameraSetup,
                        motion_numbers: NDArray[np.int64] | None = None) -> CameraKinematics:
    """Place a subdomain before a camera.

    Parameters
    ----------
    field : Kinematics
        From the field's unknowns to displacements in the specimen's frame.
    setup : CameraSetup
        The camera.
    motion_numbers : (n,) array of int64, optional
        Numbers of the motion's unknowns that the subdomain has: this camera's, or, where this camera has none,
        another's, on which what it sees does not depend. None by default.

    Returns
    -------
    CameraKinematics
        With the field's unknowns and these.
    """
    nodes = field.mesh.nodes
    numbers = np.zeros(0, np.int64) if motion_numbers is None else motion_numbers
    derivative = _block_diagonal(setup.mapping.jacobian(nodes))
    own_motion = sparse.csr_matrix(derivative @ setup.motion_columns(nodes))
    others_motion = sparse.csr_matrix((derivative.shape[0], len(numbers) - setup.n_motion_unknowns))
    tangent = sparse.hstack([derivative @ field.tangent, own_motion, others_motion]).tocsr()
    all_numbers = np.concatenate([field.numbers, numbers])
    return CameraKinematics(field, setup, see_mesh(field.mesh, setup), all_numbers, tangent)


def see_mesh(mesh: Mesh, setup: CameraSetup) -> Mesh:
    """Map a mesh into the camera's pixels.

    Edges stay straight, which a perspective keeps and distortion bends little.

    Parameters
    ----------
    mesh : Mesh
        The mesh, specimen's frame.
    setup : CameraSetup
        The camera.

    Returns
    -------
    Mesh
        The same cells, the camera's pixels.
    """
    parts = None if mesh.parts is None else see_parts(mesh.parts, mesh, setup.mapping)
    return Mesh(setup.mapping.to_image(mesh.nodes), mesh.connectivity, mesh.offsets, mesh.types, parts=parts)


def _block_diagonal(blocks: NDArray[np.float64]) -> sparse.bsr_matrix:
    """One block (2, 2) a node, (2 n, 2 n)."""
    n = len(blocks)
    return sparse.bsr_matrix((blocks, np.arange(n), np.arange(n + 1)), shape=(2 * n, 2 * n))
