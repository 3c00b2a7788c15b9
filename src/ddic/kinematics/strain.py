"""Strains of the measured field at cell centres, in the plane or in space; how far a displacement can be magnified."""

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.interpolation import differentiate_shapes_at
from ddic.mesh.mesh import Mesh, compute_determinants, invert_matrices, pad_cells
from ddic.mesh.quality import list_corner_edges
from ddic.mesh.rotation import fit_rotation


@dataclass(frozen=True)
class Strain:
    """Symmetric tensors of every cell, no unit, by the components of ``_list_components``.

    Attributes
    ----------
    infinitesimal : (n_cells, n_components) array
        (grad u + grad u^T) / 2.
    green_lagrange : (n_cells, n_components) array
        That plus grad u^T grad u / 2.
    """

    infinitesimal: Array
    green_lagrange: Array


def compute_strain(mesh: Mesh, q: Array) -> Strain:
    """Compute the strain at the centre of every cell from a nodal displacement, (n_dofs,), pixels."""
    gradient = compute_displacement_gradients(mesh, q)
    small = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    large = small + 0.5 * np.einsum("eki,ekj->eij", gradient, gradient)
    return Strain(_pick_components(small), _pick_components(large))


def find_inverted_cells(mesh: Mesh, q: Array) -> IntArray:
    """Find the cells that a displacement turns inside out at their centre: det(I + grad u) <= 0.

    Gives their sorted numbers. The nodal displacement is (n_dofs,), pixels; nan where it is not known.
    """
    deformation = np.eye(mesh.dim) + compute_displacement_gradients(mesh, q)
    with np.errstate(invalid="ignore"):
        return np.flatnonzero(np.linalg.det(deformation) <= 0).astype(np.int64)


CELLS_AT_ONCE = 1 << 15
"""Cells whose gradients are computed at once. More take more memory, 300 bytes each, and no less time."""


def compute_displacement_gradients(mesh: Mesh, q: Array) -> Array:
    """Compute du_c/dx_j at each cell's centre, (n_cells, dim, dim), from displacements of nodes, (n_dofs,), pixels."""
    gradient = np.empty((mesh.n_cells, mesh.dim, mesh.dim))
    u = q.reshape(mesh.nodes.shape)
    for block in mesh.cell_blocks:
        by_local = block.type.slopes_at_centre
        for first in range(0, len(block.cells), CELLS_AT_ONCE):
            some = slice(first, first + CELLS_AT_ONCE)
            # du_c / dxi_k (dx_j / dxi_k)^-1: two products of whole arrays are ten times as fast as one of each cell.
            of_u, of_x = (np.tensordot(values[block.nodes[some]], by_local, axes=(1, 0)) for values in (u, mesh.nodes))
            inverse, _ = invert_matrices(of_x)
            gradient[block.cells[some]] = of_u @ inverse
    if mesh.parts is not None and mesh.parts.n_parts:
        # In the middle of the part, which need not hold the cell's.
        cells = mesh.parts.cells
        slopes_at = differentiate_shapes_at(mesh, cells, mesh.centroids[cells])
        gradient[cells] = np.einsum("eac,eaj->ecj", u[pad_cells(mesh)[cells]], slopes_at)
    return gradient


def _list_components(dim: int) -> list[tuple[int, int]]:
    """List the components (i, j) of a symmetric tensor: xx, yy, xy in the plane, xx, yy, zz, xy, yz, xz in space."""
    return [*((i, i) for i in range(dim)), *((0, 1), (1, 2), (0, 2))[:dim * (dim - 1) // 2]]


def _pick_components(tensors: Array) -> Array:
    """The components of symmetric tensors, from (n, dim, dim) to (n, n_components)."""
    return np.stack([tensors[:, i, j] for i, j in _list_components(tensors.shape[-1])], axis=1)


def _build_tensors(components: Array) -> Array:
    """Symmetric tensors with these components, from (n, n_components) to (n, dim, dim)."""
    dim = {n * (n + 1) // 2: n for n in (1, 2, 3)}[components.shape[1]]
    tensors = np.empty((len(components), dim, dim))
    for values, (i, j) in zip(components.T, _list_components(dim), strict=True):
        tensors[:, i, j] = tensors[:, j, i] = values
    return tensors


def compute_infinitesimal(gradients: Array) -> Array:
    """Compute (grad u + grad u^T) / 2 from du_c / dx_j, (n, dim, dim): its components, (n, n_components)."""
    return _pick_components(0.5 * (gradients + gradients.transpose(0, 2, 1)))


def compute_green_lagrange(gradients: Array) -> Array:
    """Compute (grad u + grad u^T + grad u^T grad u) / 2, (n, n_components), of du_c / dx_j, (n, dim, dim)."""
    return _pick_components(0.5 * (gradients + gradients.transpose(0, 2, 1) + gradients.transpose(0, 2, 1) @ gradients))


def compute_hencky(green_lagrange: Array) -> Array:
    """Compute ln U = ln(1 + 2 E) / 2, Hencky's logarithmic strain, in the axes of the reference image.

    Both are components, (n, n_components); nan where a length would vanish.
    """
    values, axes = _find_eigenvalues(green_lagrange)
    # ln(1 + 2 E) by way of log1p: strains of 1e-6 keep their digits.
    with np.errstate(invalid="ignore", divide="ignore"):
        logarithms = 0.5 * np.log1p(2.0 * values)
    logarithms[~np.isfinite(logarithms)] = np.nan
    return _pick_components(np.einsum("nik,nk,njk->nij", axes, logarithms, axes))


def _find_eigenvalues(components: Array) -> tuple[Array, Array]:
    """Eigenvalues of tensors, (n, n_components), ascending, (n, dim), and their axes; nan where a tensor is unknown."""
    tensors = _build_tensors(components)
    unknown = ~np.isfinite(tensors).all(axis=(1, 2))
    # LAPACK gives up all of them where one is not a number.
    tensors[unknown] = 0.0
    values, axes = np.linalg.eigh(tensors)
    values[unknown] = np.nan
    return values, axes


def find_principal_strains(tensors: Array) -> Array:
    """Find the principal values of tensors, (n, n_components): the largest first, (n, dim)."""
    if tensors.shape[1] > 3:
        return _find_eigenvalues(tensors)[0][:, ::-1]
    xx, yy, xy = tensors.T
    middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.column_stack([middle + radius, middle - radius])


def compute_von_mises_strain(tensors: Array) -> Array:
    """Compute the equivalent strain of von Mises, in the plane with the third principal strain of a constant volume.

    sqrt(2/3 (e_1^2 + e_2^2 + e_3^2)) of the deviator, in the plane e_3 = -e_1 - e_2: the strain itself where a bar is
    pulled. Tensors are (n, n_components).
    """
    principal = find_principal_strains(tensors)
    if principal.shape[1] == 2:
        first, second = principal.T
        return np.asarray(np.sqrt(4.0 / 3.0 * (first**2 + first * second + second**2)))
    deviator = principal - principal.mean(axis=1, keepdims=True)
    return np.asarray(np.sqrt(2.0 / 3.0 * (deviator**2).sum(axis=1)))


def project_rigid_motion_out(points: Array, displacement: Array) -> Array:
    """Take the rotation and the translation that fit best out of a displacement of any size.

    It is known at points, both (n, dim) and of one unit. What is left is in the axes at rest: R^T (x + u - c') - (x -
    c) with the rotation R and the centres c and c' of the points before and after.
    """
    before = points - points.mean(axis=0)
    after = points + displacement
    after = after - after.mean(axis=0)
    return np.asarray(after @ fit_rotation(after.T @ before) - before)


def find_largest_gradient(mesh: Mesh, displacement: Array) -> float:
    """Find the largest stretch or shear at the corners of all cells: the largest singular value of grad u.

    Below 1 / that, no factor on the displacement, (n_nodes, dim), of the nodes' unit, turns a corner inside out.
    """
    edges, moves = (list_corner_edges(mesh, values).transpose(0, 2, 1) for values in (mesh.nodes, displacement))
    gradients = moves @ np.linalg.inv(edges)
    return float(np.linalg.norm(gradients, ord=2, axis=(1, 2)).max())


def count_folded_cells(mesh: Mesh, moved: Array) -> int:
    """Count the cells with a corner that is flat or inside out where nodes are ``moved``, (n_nodes, dim)."""
    folded = compute_determinants(list_corner_edges(mesh, moved)) <= 0
    return int(np.logical_or.reduceat(folded, mesh.offsets[:-1]).sum())
