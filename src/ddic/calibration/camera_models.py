"""Families of camera mappings with few parameters, for their identification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ddic.images.camera import CameraMapping

Array = NDArray[np.float64]

Kind = Literal["translation", "similarity", "homography"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Camera mappings of one kind; parameters are image px, but for the distortion, so that they are of like size.

    kind: what the homography may be; a translation keeps the ratio and does not turn.
    ratio: image px per specimen px, of a translation. middle: (2,) specimen point about which parameters are written.
    length: specimen px in which distances from it are measured.
    centre: (2,), radius: of the radial distortion, image px. distorts: whether k1 is a parameter, the last one.
    """

    kind: Kind
    ratio: float
    middle: Array
    length: float
    centre: Array
    radius: float
    distorts: bool = False

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return {"translation": 2, "similarity": 4, "homography": 8}[self.kind] + self.distorts

    def mapping(self, parameters: Array) -> CameraMapping:
        """The mapping that has these parameters; raises ValueError where there is none."""
        homography = self._local_homography(parameters) @ self._to_local()
        return CameraMapping(homography / homography[2, 2], self.centre, self.radius,
                             np.array([parameters[-1] if self.distorts else 0.0, 0.0]))

    def parameters(self, mapping: CameraMapping) -> Array:
        """Parameters of the mapping of this kind that is like another one at the model's middle."""
        local = mapping.homography @ np.linalg.inv(self._to_local())
        local = local / local[2, 2]
        place = local[:2, 2]
        slope = local[:2, :2] - np.outer(place, local[2, :2])
        half = 0.5 * np.array([slope[0, 0] + slope[1, 1], slope[1, 0] - slope[0, 1]])
        found = {"translation": place, "similarity": np.concatenate([half, place]), "homography": local.ravel()[:8]}
        distortion = mapping.radial[:1] * (self.radius / mapping.radius)**2
        return np.concatenate([found[self.kind], distortion if self.distorts else []])

    def derivatives(self, parameters: Array, points: Array) -> Array:
        """Derivatives of the image positions of specimen points (n, 2) by the parameters; (n, 2, n_parameters)."""
        local = (points - self.middle) / self.length
        x, y = local.T
        one, zero = np.ones_like(x), np.zeros_like(x)
        if self.kind == "homography":
            h = self._local_homography(parameters)
            depth = local @ h[2, :2] + 1.0
            place = (local @ h[:2, :2].T + h[:2, 2]) / depth[:, None]
            rows = [[x, y, one, zero, zero, zero, -place[:, 0] * x, -place[:, 0] * y],
                    [zero, zero, zero, x, y, one, -place[:, 1] * x, -place[:, 1] * y]]
            undistorted = np.array(rows).transpose(2, 0, 1) / depth[:, None, None]
        else:
            turning = [[x, -y], [y, x]] if self.kind == "similarity" else [[], []]
            rows = [[*turning[0], one, zero], [*turning[1], zero, one]]
            undistorted = np.array(rows).transpose(2, 0, 1)
        return self._distorted(parameters, points, undistorted) if self.distorts else undistorted

    def _distorted(self, parameters: Array, points: Array, undistorted: Array) -> Array:
        mapping = self.mapping(parameters)
        plain = CameraMapping(mapping.homography).to_image(points)
        distortion = CameraMapping(np.eye(3), self.centre, self.radius, mapping.radial)
        offset = plain - self.centre
        by_k1 = offset * ((offset**2).sum(axis=1) / self.radius**2)[:, None]
        return np.concatenate([distortion.jacobian(plain) @ undistorted, by_k1[:, :, None]], axis=2)

    def _local_homography(self, parameters: Array) -> Array:
        if self.kind == "homography":
            return np.append(parameters[:8], 1.0).reshape(3, 3)
        if self.kind == "similarity":
            c, s, x, y = parameters[:4]
        else:
            (x, y), c, s = parameters[:2], self.ratio * self.length, 0.0
        return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])

    def _to_local(self) -> Array:
        (x, y), size = self.middle, 1.0 / self.length
        return np.array([[size, 0.0, -x * size], [0.0, size, -y * size], [0.0, 0.0, 1.0]])


def closest_similarity(mapping: CameraMapping, points: Array) -> tuple[CameraMapping, Array]:
    """The similarity that is closest to a mapping at specimen points (n, 2) in the sense of least squares.

    Returns it, and what the mapping adds to it at the points, image px (n, 2).
    """
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    image = mapping.to_image(points)
    place = image.mean(axis=0)
    u, v = (image - place).T
    c, s = np.array([x @ u + y @ v, x @ v - y @ u]) / (x @ x + y @ y)
    turn = np.array([[c, -s], [s, c]])
    homography = np.eye(3)
    homography[:2, :2], homography[:2, 2] = turn, place - turn @ middle
    similar = CameraMapping(homography)
    return similar, image - similar.to_image(points)
