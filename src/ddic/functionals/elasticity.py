"""Linear elastic stiffness K with Young's modulus 1, unit thickness, lengths in pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.shapes import QUADRATURE, shape_gradients


@dataclass(frozen=True)
class Material:
    """Isotropic elasticity with E = 1.

    poisson_ratio: -1 < nu < 0.5; plane: "stress" or "strain".
    """

    poisson_ratio: float = 0.3
    plane: Literal["stress", "strain"] = "stress"

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """Hooke's matrix D of (exx, eyy, 2 exy) to (sxx, syy, sxy), shape (3, 3)."""
        nu = self.poisson_ratio
        shear = 1.0 / (2.0 * (1.0 + nu))
        if self.plane == "stress":
            axial, cross = 1.0 / (1.0 - nu**2), nu / (1.0 - nu**2)
        else:
            factor = (1.0 + nu) * (1.0 - 2.0 * nu)
            axial, cross = (1.0 - nu) / factor, nu / factor
        return np.array([[axial, cross, 0.0], [cross, axial, 0.0], [0.0, 0.0, shear]])


def strain_operator(gradients: NDArray[np.float64]) -> NDArray[np.float64]:
    """B of (exx, eyy, 2 exy) = B q from shape gradients (..., k, 2); returns (..., 3, 2 k)."""
    k = gradients.shape[-2]
    b = np.zeros((*gradients.shape[:-2], 3, 2 * k))
    b[..., 0, 0::2] = gradients[..., 0]
    b[..., 1, 1::2] = gradients[..., 1]
    b[..., 2, 0::2] = gradients[..., 1]
    b[..., 2, 1::2] = gradients[..., 0]
    return b


def stiffness_cells(mesh: Mesh, material: Material) -> NDArray[np.float64]:
    """K_e = int B^T D B of every cell, (n_cells, 8, 8); a T3's last two rows and columns are zero."""
    d = material.stiffness
    cells = np.zeros((mesh.n_cells, 8, 8))
    for cell_type in np.unique(mesh.types):
        members = np.flatnonzero(mesh.types == cell_type)
        points, weights = QUADRATURE[int(cell_type)]
        gradients, det = shape_gradients(mesh, members, points)
        b = strain_operator(gradients)
        n = b.shape[-1]
        cells[members, :n, :n] = np.einsum("epik,ij,epjl,ep->ekl", b, d, b, det * weights, optimize=True)
    return cells
