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
    def lame(self) -> tuple[float, float]:
        """Lambda and mu of s = lambda tr(e) I + 2 mu e in the plane; lambda is that of plane stress or strain."""
        nu = self.poisson_ratio
        lame = nu / (1.0 - nu**2) if self.plane == "stress" else nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        return lame, 1.0 / (2.0 * (1.0 + nu))


def stiffness_cells(mesh: Mesh, material: Material) -> NDArray[np.float64]:
    """K_e = int lambda div u div v + 2 mu eps(u) : eps(v) of every cell, (n_cells, 8, 8); a T3's last rows are zero."""
    lame, shear = material.lame
    cells = np.zeros((mesh.n_cells, 8, 8))
    for cell_type in np.unique(mesh.types):
        members = np.flatnonzero(mesh.types == cell_type)
        points, weights = QUADRATURE[int(cell_type)]
        gradients, det = shape_gradients(mesh, members, points)
        n_cells, n_points, k, dim = gradients.shape
        rows = gradients.reshape(n_cells, n_points, k * dim)
        # products[e, a, i, b, j] = int dN_a/dx_i dN_b/dx_j
        products = (rows.transpose(0, 2, 1) @ (rows * (det * weights)[..., None])).reshape(n_cells, k, dim, k, dim)
        stiffness = lame * products + shear * products.swapaxes(2, 4)
        laplacian = shear * np.trace(products, axis1=2, axis2=4)
        for i in range(dim):
            stiffness[:, :, i, :, i] += laplacian
        cells[members, : k * dim, : k * dim] = stiffness.reshape(n_cells, k * dim, k * dim)
    return cells
