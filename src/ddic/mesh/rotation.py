"""Rotations of the plane and of space, by their rotation vector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array


def build_rotation(angle: float) -> Array:
    """Build the matrix R that turns a vector v of the plane to R v, from x towards y by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def fit_rotation(products: Array) -> Array:
    """Fit R to vectors x that have turned to X, by the sum of X x^T, (dim, dim): the R with the least |X - R x|^2."""
    if len(products) == 2:
        return build_rotation(np.arctan2(products[1, 0] - products[0, 1], products[0, 0] + products[1, 1]))
    left, values, right = np.linalg.svd(products)
    # The nearest orthogonal matrix may be a mirror.
    signs = np.ones(len(values))
    signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    return np.asarray((left * signs) @ right)


@dataclass(frozen=True, eq=False)
class Rotation:
    """A rotation; who only turns vectors need not know of how many dimensions.

    Attributes
    ----------
    vector : (1,) or (3,) array
        Radians: in the plane the angle from x towards y, in space the axis times the angle about it.
    """

    vector: Array

    @classmethod
    def none(cls, dim: int) -> Rotation:
        """Turn nothing."""
        return cls(np.zeros(1 if dim == 2 else 3))

    @classmethod
    def from_matrix(cls, matrix: Array) -> Rotation:
        """Find the vector of R, (dim, dim)."""
        if len(matrix) == 2:
            return cls(np.array([np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])]))
        from scipy.spatial import transform

        return cls(transform.Rotation.from_matrix(matrix).as_rotvec())

    @property
    def angle(self) -> float:
        """Radians, in the plane from x towards y, in space not negative."""
        return float(self.vector[0] if len(self.vector) == 1 else np.linalg.norm(self.vector))

    @property
    def matrix(self) -> Array:
        """R, (dim, dim)."""
        if len(self.vector) == 1:
            return build_rotation(self.angle)
        from scipy.spatial import transform

        return np.asarray(transform.Rotation.from_rotvec(self.vector).as_matrix())

    def apply(self, vectors: Array) -> Array:
        """Turn vectors, (n, dim)."""
        return np.asarray(vectors @ self.matrix.T)

    def apply_inverse(self, vectors: Array) -> Array:
        """Turn vectors, (n, dim), back: the inverse of R is its transpose."""
        return np.asarray(vectors @ self.matrix)

    def measure_turn(self, other: Rotation) -> float:
        """Measure the angle from this rotation to another, radians, up to half a turn."""
        return abs(Rotation.from_matrix(other.matrix @ self.matrix.T).angle)

    def round_to(self, step: float) -> Rotation:
        """Give the rotation of which the vector is the nearest in whole multiples of a step, radians."""
        return Rotation(np.round(self.vector / step) * step)
