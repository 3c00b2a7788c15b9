"""Families of camera mappings with few parameters, for their identification."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ddic.arrays import Array
from ddic.images.camera import CameraMapping

Kind = Literal["translation", "similarity", "homography"]

N_PLANE: dict[Kind, int] = {"translation": 2, "similarity": 4, "homography": 8}
"""Parameters of each kind, without the distortion's."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Camera mappings of one kind; parameters are image px, but for the distortion, so that they are of like size.

    Attributes
    ----------
    kind : {"translation", "similarity", "homography"}
        What the homography may be; a translation keeps the ratio and does not turn.
    ratio : float
        Image px per specimen px, of a translation.
    middle : (2,) array
        Specimen point about which parameters are written, specimen px.
    length : float
        Specimen px in which distances from it are measured.
    centre : (2,) array
        Of the radial distortion, image px.
    radius : float
        Of the radial distortion, image px.
    distorts : bool
        Whether k1 is a parameter, the last one.
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
        return N_PLANE[self.kind] + self.distorts

    def build_mapping(self, parameters: Array) -> CameraMapping:
        """Build the mapping from specimen to image px that has given parameters (n_parameters,).

        Raises ValueError where there is none.
        """
        homography = self._local_homography(parameters) @ self._to_local()
        k1 = parameters[-1] if self.distorts else 0.0
        return CameraMapping(homography / homography[2, 2], self.centre, self.radius, np.array([k1, 0.0]))

    def fit(self, mapping: CameraMapping) -> Array:
        """Find the parameters (n_parameters,) of this kind of mapping that is like another one about the middle."""
        local = mapping.homography @ np.linalg.inv(self._to_local())
        local = local / local[2, 2]
        place = local[:2, 2]
        found: Array
        if self.kind == "translation":
            found = place
        elif self.kind == "homography":
            found = local.ravel()[:8]
        else:
            # The rotation and stretch nearest to the mapping's slope.
            slope = local[:2, :2] - np.outer(place, local[2, :2])
            c = 0.5 * (slope[0, 0] + slope[1, 1])
            s = 0.5 * (slope[1, 0] - slope[0, 1])
            found = np.concatenate([[c, s], place])
        if not self.distorts:
            return found
        k1 = mapping.radial[:1] * (self.radius / mapping.radius) ** 2
        return np.concatenate([found, k1])

    def differentiate(self, parameters: Array, points: Array) -> Array:
        """Differentiate the image positions of specimen points (n, 2) by the parameters: (n, 2, n_parameters)."""
        local = (points - self.middle) / self.length
        x, y = local.T
        one, zero = np.ones_like(x), np.zeros_like(x)
        if self.kind == "homography":
            h = self._local_homography(parameters)
            depth = local @ h[2, :2] + 1.0
            place = (local @ h[:2, :2].T + h[:2, 2]) / depth[:, None]
            of_x = [x, y, one, zero, zero, zero, -place[:, 0] * x, -place[:, 0] * y]
            of_y = [zero, zero, zero, x, y, one, -place[:, 1] * x, -place[:, 1] * y]
            undistorted = np.array([of_x, of_y]).transpose(2, 0, 1) / depth[:, None, None]
        elif self.kind == "similarity":
            undistorted = np.array([[x, -y, one, zero], [y, x, zero, one]]).transpose(2, 0, 1)
        else:
            undistorted = np.array([[one, zero], [zero, one]]).transpose(2, 0, 1)
        return self._distort(parameters, points, undistorted) if self.distorts else undistorted

    def _distort(self, parameters: Array, points: Array, undistorted: Array) -> Array:
        """Turn derivatives of undistorted positions into those of distorted ones, and append those by k1."""
        mapping = self.build_mapping(parameters)
        plain = CameraMapping(mapping.homography).to_image(points)
        distortion = CameraMapping(np.eye(3), self.centre, self.radius, mapping.radial)
        offset = plain - self.centre
        by_k1 = offset * ((offset**2).sum(axis=1) / self.radius**2)[:, None]
        return np.concatenate([distortion.jacobian(plain) @ undistorted, by_k1[:, :, None]], axis=2)

    def _local_homography(self, parameters: Array) -> Array:
        """The homography (3, 3) from distances to the middle, over the length, to image px."""
        if self.kind == "homography":
            return np.append(parameters[:8], 1.0).reshape(3, 3)
        if self.kind == "similarity":
            c, s, x, y = parameters[:4]
        else:
            x, y = parameters[:2]
            c, s = self.ratio * self.length, 0.0
        return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])

    def _to_local(self) -> Array:
        """The homography (3, 3) from specimen px to distances to the middle, over the length."""
        x, y = self.middle
        size = 1.0 / self.length
        return np.array([[size, 0.0, -x * size], [0.0, size, -y * size], [0.0, 0.0, 1.0]])


def fit_similarity(mapping: CameraMapping, points: Array) -> tuple[CameraMapping, Array]:
    """Find the similarity that is closest to a mapping at specimen points (n, 2), in the sense of least squares.

    Beside it comes what the mapping adds to it at the points, (n, 2), image px.
    """
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    image = mapping.to_image(points)
    place = image.mean(axis=0)
    u, v = (image - place).T
    c, s = np.array([x @ u + y @ v, x @ v - y @ u]) / (x @ x + y @ y)
    turn = np.array([[c, -s], [s, c]])
    homography = np.eye(3)
    homography[:2, :2] = turn
    homography[:2, 2] = place - turn @ middle
    similarity = CameraMapping(homography)
    return similarity, image - similarity.to_image(points)
