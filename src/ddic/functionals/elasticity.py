"""Linear elastic stiffness K with Young's modulus 1, unit thickness, lengths in pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.monomials import N_MONOMIALS
from ddic.mesh.shapes import compute_shape_gradients


@dataclass(frozen=True)
class Material:
    """Isotropic elasticity with E = 1.

    Attributes
    ----------
    poisson_ratio : float
        -1 < nu < 0.5.
    plane : {"stress", "strain"}
        Whether the stress or the strain across the plane is zero.
    """

    poisson_ratio: float = 0.3
    plane: Literal["stress", "strain"] = "stress"

    @property
    def lame(self) -> tuple[float, float]:
        """Lambda and mu of s = lambda tr(e) I + 2 mu e in the plane; lambda is that of plane stress or strain."""
        nu = self.poisson_ratio
        lame = nu / (1.0 - nu**2) if self.plane == "stress" else nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        return lame, 1.0 / (2.0 * (1.0 + nu))


def integrate_cell_stiffness(mesh: Mesh, material: Material) -> NDArray[np.float64]:
    """Integrate K_e = int lambda div u div v + 2 mu eps(u) : eps(v) over every cell.

    Parameters
    ----------
    mesh : Mesh
        Lengths in pixels.
    material : Material
        The same in all cells.

    Returns
    -------
    (n_cells, 4 dim, 4 dim) array
        K_e between displacement components, node-major; zero for nodes that a cell does not have.
    """
    lame, shear = material.lame
    width = N_MONOMIALS * mesh.dim
    cells = np.zeros((mesh.n_cells, width, width))
    for block in mesh.cell_blocks:
        quadrature = block.type.quadrature
        gradients, det = compute_shape_gradients(mesh, block, quadrature.points)
        products = _integrate_products(gradients, det * quadrature.weights)
        # 2 mu eps(u) : eps(v) = mu (grad u : grad v + grad u : grad v^T)
        stiffness = lame * products + shear * products.swapaxes(2, 4)
        laplacian = shear * np.trace(products, axis1=2, axis2=4)
        for i in range(mesh.dim):
            stiffness[:, :, i, :, i] += laplacian
        n = block.type.n_nodes * mesh.dim
        cells[block.cells, :n, :n] = stiffness.reshape(-1, n, n)
    return cells


def assemble_stiffness(mesh: Mesh, material: Material) -> sparse.csr_matrix:
    """Assemble K of a mesh, which acts on displacements of its nodes: the K of Eq. (11) of [BP17].

    Parameters
    ----------
    mesh : Mesh
        Lengths in pixels.
    material : Material
        The same in all cells.

    Returns
    -------
    (n_dofs, n_dofs) csr_matrix
        K, symmetric; its null space is the rigid motions.
    """
    return interpolate_cells(mesh).assemble_matrix(integrate_cell_stiffness(mesh, material))


def _integrate_products(gradients: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Integrals of dN_a/dx_i dN_b/dx_j, (n_cells, a, i, b, j), from gradients and weights at points of the cells."""
    n_cells, n_points, k, dim = gradients.shape
    rows = gradients.reshape(n_cells, n_points, k * dim)
    products = rows.transpose(0, 2, 1) @ (rows * weights[..., None])
    return np.asarray(products.reshape(n_cells, k, dim, k, dim))
