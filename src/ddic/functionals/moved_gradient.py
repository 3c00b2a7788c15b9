"""The gradient of the deformed image where the displacement puts a pixel: F^-T grad f, F = I + grad u.

Gauss-Newton takes grad f for it, which is enough where little turns or stretches. By 10 % it converges slower, by a
rotation of 60 degrees not at all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.mesh import Mesh

Array = NDArray[np.float64]

LARGE = 0.1
"""Norm of F - I from which on F^-T grad f is taken for the gradient. A larger value costs iterations, a smaller one
operators that only fit one image."""

LARGE_SHARE = 0.02
"""Share of all pixels from which on so large gradients count. A few cells may be a crack that continuous elements
smear, where the images turn and stretch nowhere. A larger share leaves more to slow convergence."""

LEAST_AREA, LARGEST_STRETCH = 0.2, 3.0
"""Least det F, and largest norm of F, of a cell whose displacement is believed. Others keep grad f."""


def compute_inverse_deformations(mesh: Mesh, u: Array) -> Array:
    """Compute F^-1 at the centre of every cell.

    Parameters
    ----------
    mesh : Mesh
        Any, in the image's pixels.
    u : (n_dofs,) array
        Nodal displacement, pixels.

    Returns
    -------
    (n_cells, dim, dim) array
        No unit; the identity where a cell is folded, or stretched more than can be believed.
    """
    identity = np.eye(mesh.dim)
    deformation = identity + compute_displacement_gradients(mesh, u)
    believed = _is_believed(deformation)
    inverse = np.tile(identity, (mesh.n_cells, 1, 1))
    inverse[believed] = np.linalg.inv(deformation[believed])
    return inverse


def find_large_gradients(mesh: Mesh, u: Array) -> NDArray[np.bool_]:
    """Find the cells that have turned or stretched by much.

    Parameters
    ----------
    mesh : Mesh
        Any, in the image's pixels.
    u : (n_dofs,) array
        Nodal displacement, pixels.

    Returns
    -------
    (n_cells,) array of bool
        Whether a cell's norm of F - I is above ``LARGE``, and its displacement is believed.
    """
    gradients = compute_displacement_gradients(mesh, u)
    is_large = np.asarray(np.linalg.norm(gradients, axis=(1, 2)) > LARGE)
    if is_large.any():
        is_large &= _is_believed(np.eye(mesh.dim) + gradients)
    return is_large


def measure_deformation(before: Array | None, now: Array | None) -> float:
    """Measure how much the cells have turned and stretched.

    Parameters
    ----------
    before : (n_cells, dim, dim) array or None
        F^-1 of each cell then; None for the identity.
    now : (n_cells, dim, dim) array or None
        F^-1 of each cell now; None for the identity.

    Returns
    -------
    float
        Largest norm of F_before^-1 F_now - I.
    """
    if now is None:
        return 0.0 if before is None else _find_largest(before)
    deformation = np.linalg.inv(now)
    return _find_largest(deformation if before is None else before @ deformation)


def _find_largest(deformation: Array) -> float:
    """Largest norm of F - I."""
    change = deformation - np.eye(deformation.shape[-1])
    return float(np.linalg.norm(change, axis=(1, 2)).max(initial=0.0))


def map_moments(inverse: Array, moments: Array) -> Array:
    """Turn sums of grad f into those of F^-T grad f.

    Parameters
    ----------
    inverse : (n_cells, dim, dim) array
        F^-1 of each cell.
    moments : (n_cells, n_kinds, dim, n_monomials) array
        Sums of something times grad f.

    Returns
    -------
    (n_cells, n_kinds, dim, n_monomials) array
        Sums of the same times F^-T grad f.
    """
    return np.asarray(np.einsum("eji,ekjm->ekim", inverse, moments, optimize=True))


def map_hessians(inverse: Array, hessians: Array) -> Array:
    """Turn sums of grad f grad f^T into those of F^-T grad f grad f^T F^-1.

    Parameters
    ----------
    inverse : (n_cells, dim, dim) array
        F^-1 of each cell.
    hessians : (n_cells, n, n) array
        M_e, node-major.

    Returns
    -------
    (n_cells, n, n) array
        M_e with the other gradient.
    """
    n_cells, n, _ = hessians.shape
    dim = inverse.shape[-1]
    blocks = hessians.reshape(n_cells, n // dim, dim, n // dim, dim)
    turned = np.einsum("eki,eakbl,elj->eaibj", inverse, blocks, inverse, optimize=True)
    return np.asarray(turned.reshape(n_cells, n, n))


def _is_believed(deformation: Array) -> NDArray[np.bool_]:
    sizes = np.linalg.norm(deformation, axis=(1, 2))
    return np.asarray((np.linalg.det(deformation) >= LEAST_AREA) & (sizes <= LARGEST_STRETCH * np.sqrt(2)))
