"""Linear elastic stiffness K with Young's modulus 1, unit thickness, lengths in pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.cell_parts import CellParts, place_quadrature_points
from ddic.mesh.cell_type import N_MONOMIALS
from ddic.mesh.interpolation import differentiate_shapes_at
from ddic.mesh.mesh import Mesh, compute_shape_gradients

_CHUNK_CELLS = 2_000
"""Cells whose products of gradients are held at once: few enough for a processor's cache, in which they take half the
time. A larger value takes more memory, too."""


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
    """Integrate K_e = int lambda div u div v + 2 mu eps(u) : eps(v) over every cell, or its part.

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
    width = N_MONOMIALS * mesh.dim
    cells = np.zeros((mesh.n_cells, width, width))
    for block in mesh.cell_blocks:
        quadrature = block.type.quadrature
        n = block.type.n_nodes * mesh.dim
        weighing = _weigh_all_products(block.type.n_nodes, mesh.dim, material)
        for begin in range(0, len(block.cells), _CHUNK_CELLS):
            chunk = replace(block, cells=block.cells[begin:begin + _CHUNK_CELLS],
                            nodes=block.nodes[begin:begin + _CHUNK_CELLS])
            gradients, det = compute_shape_gradients(mesh, chunk, quadrature.points)
            products = _integrate_products(gradients, det * quadrature.weights)
            cells[chunk.cells, :n, :n] = (products.reshape(-1, n * n) @ weighing).reshape(-1, n, n)
    if mesh.parts is not None and mesh.parts.n_parts:
        cells[mesh.parts.cells] = _integrate_parts(mesh, mesh.parts, material)
    return cells


def _integrate_parts(mesh: Mesh, parts: CellParts, material: Material) -> NDArray[np.float64]:
    """K_e of the cells that are parts, over their outlines: (n_parts, 4 dim, 4 dim)."""
    points, weights, numbers = place_quadrature_points(parts)
    gradients = differentiate_shapes_at(mesh, parts.cells[numbers], points)
    rows = gradients.reshape(len(points), -1)
    at_points = rows[:, :, None] * (weights[:, None] * rows)[:, None, :]
    ends = np.searchsorted(numbers, np.arange(len(parts.cells)))
    products = np.add.reduceat(at_points, ends, axis=0)
    k, dim = gradients.shape[1:]
    of_parts = _weigh_products(products.reshape(-1, k, dim, k, dim), material)
    return of_parts.reshape(len(parts.cells), k * dim, k * dim)


def _weigh_products(products: NDArray[np.float64], material: Material) -> NDArray[np.float64]:
    """K_e from the integrals of dN_a/dx_i dN_b/dx_j, both (n_cells, a, i, b, j)."""
    lame, shear = material.lame
    # 2 mu eps(u) : eps(v) = mu (grad u : grad v + grad u : grad v^T)
    stiffness = lame * products + shear * products.swapaxes(2, 4)
    laplacian = shear * np.trace(products, axis1=2, axis2=4)
    for i in range(products.shape[2]):
        stiffness[:, :, i, :, i] += laplacian
    return stiffness


def _weigh_all_products(n_nodes: int, dim: int, material: Material) -> NDArray[np.float64]:
    """What each integral of dN_a/dx_i dN_b/dx_j adds to K_e: a matrix, which many cells are multiplied by at once."""
    n_products = (n_nodes * dim) ** 2
    one_by_one = np.eye(n_products).reshape(n_products, n_nodes, dim, n_nodes, dim)
    return _weigh_products(one_by_one, material).reshape(n_products, n_products)


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
