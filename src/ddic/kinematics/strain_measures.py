"""What strains are made of: tensors from displacement gradients, and numbers from tensors, all in the plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def compute_infinitesimal(gradients: Array) -> Array:
    """Compute (grad u + grad u^T) / 2.

    Parameters
    ----------
    gradients : (n, 2, 2) array
        du_c / dx_j, no unit.

    Returns
    -------
    (n, 3) array
        xx, yy, xy.
    """
    return _pick_components(0.5 * (gradients + gradients.transpose(0, 2, 1)))


def compute_green_lagrange(gradients: Array) -> Array:
    """Compute (grad u + grad u^T + grad u^T grad u) / 2, which no rotation changes.

    Parameters
    ----------
    gradients : (n, 2, 2) array
        du_c / dx_j, no unit.

    Returns
    -------
    (n, 3) array
        xx, yy, xy.
    """
    return _pick_components(0.5 * (gradients + gradients.transpose(0, 2, 1)
                                   + gradients.transpose(0, 2, 1) @ gradients))


def compute_hencky(green_lagrange: Array) -> Array:
    """Compute ln U = ln(1 + 2 E) / 2, Hencky's logarithmic strain, in the axes of the reference image.

    Parameters
    ----------
    green_lagrange : (n, 3) array
        E: xx, yy, xy.

    Returns
    -------
    (n, 3) array
        xx, yy, xy; nan where a length would vanish.
    """
    tensors = green_lagrange[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    values, axes = np.linalg.eigh(tensors)
    # ln(1 + 2 E) by way of log1p: strains of 1e-6 keep their digits.
    with np.errstate(invalid="ignore", divide="ignore"):
        logarithms = 0.5 * np.log1p(2.0 * values)
    logarithms[~np.isfinite(logarithms)] = np.nan
    return _pick_components(np.einsum("nik,nk,njk->nij", axes, logarithms, axes))


def find_principal_strains(tensors: Array) -> Array:
    """Find the principal values of tensors.

    Parameters
    ----------
    tensors : (n, 3) array
        xx, yy, xy.

    Returns
    -------
    (n, 2) array
        The larger one, then the smaller.
    """
    xx, yy, xy = tensors.T
    middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.column_stack([middle + radius, middle - radius])


def compute_von_mises_strain(tensors: Array) -> Array:
    """Compute the equivalent strain of von Mises, with the third principal strain of a constant volume.

    sqrt(2/3 (e_1^2 + e_2^2 + e_3^2)), e_3 = -e_1 - e_2: the strain itself where a bar is pulled.

    Parameters
    ----------
    tensors : (n, 3) array
        xx, yy, xy.

    Returns
    -------
    (n,) array
        Not negative.
    """
    first, second = find_principal_strains(tensors).T
    return np.asarray(np.sqrt(4.0 / 3.0 * (first**2 + first * second + second**2)))


def _pick_components(tensors: Array) -> Array:
    return np.stack([tensors[:, 0, 0], tensors[:, 1, 1], tensors[:, 0, 1]], axis=1)
