"""How a camera sees unknowns and discontinuities of the specimen's frame, and its set-up's motion between pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.images.camera import CameraMapping
from ddic.kinematics.enriched import Discontinuities, Opening
from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.cell_parts import CellParts, Lines
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree, compute_normals, find_runs, subdivide
from ddic.mesh.rotation import Rotation

REACH = 2.0
"""Distance from a mesh's nodes, in diameters of its largest cell, up to which a camera sees a line. Within one diameter
are the cells, and pixels beside a line that do not count are to be found there whole."""

LONGEST = 8.0
"""Pixels of the specimen between vertices of a line that a camera sees: its mapping bends little over so many. The same
whatever the partition."""


def _see_parts(parts: CellParts, mesh: Mesh, mapping: CameraMapping) -> CellParts:
    """Parts of cut cells of ``mesh``, specimen's frame, in a camera's pixels; edges stay straight."""
    polylines = [piece for line in parts.lines.polylines for piece in _see_line(line, mesh, mapping)]
    # What a bend cuts off lies in one cell.
    near = [bend for bend in parts.lines.bends if _is_near(bend, mesh).all()]
    bends = tuple(mapping.to_image(bend) for bend in near)
    return replace(parts, corners=mapping.to_image(parts.corners), lines=Lines(tuple(polylines), bends))


def see_discontinuities(discontinuities: Discontinuities, mesh: Mesh, mapping: CameraMapping) -> Discontinuities:
    """Map those pieces of lines that a camera sees from the specimen's frame into its pixels.

    ``mesh`` are the cells that the camera measures, specimen's frame: elsewhere its mapping may not hold.
    """
    lines: list[Array] = []
    openings: list[Opening] = []
    for line, opening in zip(discontinuities.lines, discontinuities.openings, strict=True):
        pieces = _see_line(line, mesh, mapping)
        lines += pieces
        openings += [opening] * len(pieces)
    return Discontinuities(tuple(lines), tuple(openings))


def _see_line(line: Array, mesh: Mesh, mapping: CameraMapping) -> list[Array]:
    """Pieces of a line near a mesh, the camera's pixels: as straight within a cell as the cells' edges are."""
    vertices = subdivide(line, LONGEST)
    return [mapping.to_image(vertices[run]) for run in find_runs(_is_near(vertices, mesh))]


def _is_near(points: Array, mesh: Mesh) -> BoolArray:
    """Whether points lie in a mesh or not far beyond its edge."""
    low, high = mesh.whole_outlines.find_boxes()
    diameter = float(np.linalg.norm(high - low, axis=1).max())
    distances, _ = build_tree(mesh.nodes).query(points)
    return np.asarray(distances <= REACH * diameter)


MotionKind = Literal["none", "translation", "rigid"]

N_MOTION_UNKNOWNS: dict[MotionKind, int] = {"none": 0, "translation": 2, "rigid": 3}
"""Unknowns of a set-up's motion: alpha_x, alpha_y, and theta times ``CameraSetup.length``."""


@dataclass(frozen=True)
class CameraSetup:
    """A camera, and how its set-up may move between its two pictures.

    A point that lies at Y in the specimen's frame is seen at phi(T(Y)), T(Y) = X0 + R(theta) (Y - X0) + alpha.

    Attributes
    ----------
    phi : CameraMapping or None
        From the specimen's frame to the camera's pixels; None where these are the specimen's frame.
    motion : MotionKind
        Which of alpha and theta are unknown.
    centre : (2,) array
        X0, specimen's frame.
    length : float
        Half the diagonal of what the camera sees, by which theta is multiplied so that all unknowns of the motion are
        pixels of the specimen's frame.
    """

    phi: CameraMapping | None
    motion: MotionKind
    centre: Array
    length: float

    @property
    def mapping(self) -> CameraMapping:
        """Phi of a camera whose pixels are not the specimen's frame."""
        if self.phi is None:
            raise ValueError("a camera whose pixels are the specimen's frame")
        return self.phi

    def to_image(self, points: Array) -> Array:
        """Map points, (n, dim), from the specimen's frame to the camera's pixels."""
        return points if self.phi is None else self.phi.to_image(points)

    def to_specimen(self, points: Array) -> Array:
        """Map points, (n, dim), from the camera's pixels to the specimen's frame."""
        return points if self.phi is None else self.phi.to_specimen(points)

    @property
    def n_motion_unknowns(self) -> int:
        """Number of unknowns of the motion."""
        return N_MOTION_UNKNOWNS[self.motion]

    def hold_still(self) -> CameraSetup:
        """Give the camera as if its set-up did not move between its pictures, without unknowns of a motion."""
        return replace(self, motion="none")

    def move(self, points: Array, motion: Array) -> Array:
        """Apply the motion T to points Y of the specimen's frame, (n, 2).

        ``motion`` are its unknowns, (n_motion_unknowns,), pixels of the specimen's frame. Eq. 20 of [BP17] says
        u_n = u_f - alpha: there it has the other sign, and no rotation.
        """
        if self.n_motion_unknowns == 0:
            return points
        if self.n_motion_unknowns == 2:
            return np.asarray(points + motion)
        turned = self._rotation(motion).apply(points - self.centre)
        return np.asarray(self.centre + turned + motion[:2])

    def move_back(self, points: Array, motion: Array) -> Array:
        """Undo the motion T: from points T(Y) to Y, as ``move`` takes them."""
        if self.n_motion_unknowns == 0:
            return points
        if self.n_motion_unknowns == 2:
            return np.asarray(points - motion)
        turned = points - motion[:2] - self.centre
        return np.asarray(self.centre + self._rotation(motion).apply_inverse(turned))

    def motion_columns(self, points: Array) -> Array:
        """Differentiate T by the motion's unknowns at rest: alpha's columns R, Boolean in Eq. 20 of [BP17].

        R is (2 n, n_motion_unknowns), no unit, at points Y of the specimen's frame, (n, 2).
        """
        columns = np.zeros((*points.shape, self.n_motion_unknowns))
        if self.n_motion_unknowns:
            columns[:, :, :2] = np.eye(2)
        if self.n_motion_unknowns == 3:
            columns[:, :, 2] = compute_normals((points - self.centre) / self.length)
        return columns.reshape(points.size, self.n_motion_unknowns)

    def _rotation(self, motion: Array) -> Rotation:
        return Rotation(motion[2:3] / self.length)


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
    numbers: IntArray
    matrix: sparse.csr_matrix

    @property
    def tangent(self) -> sparse.csr_matrix:
        """Derivative of the displacement in the image by the unknowns at rest, (mesh.n_dofs, n_unknowns)."""
        return self.matrix

    def displacement(self, unknowns: Array) -> Array:
        """Displace the nodes in the image, phi(T(X + u)) - phi(X)."""
        nodes = self.field.mesh.nodes
        u = self.field.displacement(unknowns[:self.field.n_unknowns])
        # Unknowns of another camera's motion may follow.
        first = self.field.n_unknowns
        motion = unknowns[first:first + self.setup.n_motion_unknowns]
        moved = self.setup.move(nodes + u.reshape(nodes.shape), motion)
        return np.asarray(self.setup.to_image(moved) - self.mesh.nodes).ravel()

    def fit(self, displacement: Array) -> Array:
        """Find the field's unknowns that explain a displacement in the image, the motion's being zero."""
        return self.fit_with_motion(displacement, np.zeros(self.n_unknowns - self.field.n_unknowns))

    def fit_with_motion(self, displacement: Array, motion: Array) -> Array:
        """Find the field's unknowns that explain a displacement in the image beside a motion.

        The displacement is that of the nodes, (mesh.n_dofs,), the camera's pixels; the motion's unknowns, pixels of the
        specimen's frame, come back after those of the field.
        """
        nodes = self.field.mesh.nodes
        seen = self.mesh.nodes + displacement.reshape(nodes.shape)
        points = self.setup.to_specimen(seen)
        points = self.setup.move_back(points, motion[:self.setup.n_motion_unknowns])
        field_unknowns = self.field.fit(np.asarray(points - nodes).ravel())
        return np.concatenate([field_unknowns, motion])

    def hold_still(self) -> CameraKinematics:
        """Give the same for a set-up that does not move between its pictures."""
        return place_before_camera(self.field, self.setup.hold_still())


def place_before_camera(field: Kinematics, setup: CameraSetup,
                        motion_numbers: IntArray | None = None) -> CameraKinematics:
    """Place a subdomain, with the field's unknowns in the specimen's frame, before a camera.

    ``motion_numbers`` are those of the motion's unknowns that the subdomain has: this camera's, or, where this camera
    has none, another's, on which what it sees does not depend. None by default.
    """
    nodes = field.mesh.nodes
    numbers = np.zeros(0, np.int64) if motion_numbers is None else motion_numbers
    n = len(nodes)
    # One block a node.
    derivative = sparse.bsr_matrix((setup.mapping.jacobian(nodes), np.arange(n), np.arange(n + 1)), (2 * n, 2 * n))
    own_motion = sparse.csr_matrix(derivative @ setup.motion_columns(nodes))
    others_motion = sparse.csr_matrix((derivative.shape[0], len(numbers) - setup.n_motion_unknowns))
    tangent = sparse.hstack([derivative @ field.tangent, own_motion, others_motion]).tocsr()
    all_numbers = np.concatenate([field.numbers, numbers])
    return CameraKinematics(field, setup, see_mesh(field.mesh, setup), all_numbers, tangent)


def see_mesh(mesh: Mesh, setup: CameraSetup) -> Mesh:
    """Map a mesh from the specimen's frame into the camera's pixels, edges straight, which distortion bends little."""
    parts = None if mesh.parts is None else _see_parts(mesh.parts, mesh, setup.mapping)
    return Mesh(setup.mapping.to_image(mesh.nodes), mesh.connectivity, mesh.offsets, mesh.types, parts=parts)
