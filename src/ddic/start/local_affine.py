"""Affine maps through the displacements of a few neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

N_NEIGHBOURS = 12
"""Neighbours that an affine map is fitted to: twice its unknowns a component, and as many again for wrong ones."""

N_ROUNDS = 15
"""Rounds of reweighting, which leave the least sum of distances instead of squares: wrong neighbours hardly count."""

RIDGE = 1e-3
"""Share of the neighbours' spread that holds a gradient which they do not tell."""

SMALLEST = 1e-3
"""Misfit, pixels, below which a neighbour's weight grows no more."""


def fit_without_itself(points: Array, displacement: Array, neighbours: NDArray[np.int64]) -> Array:
    """Predict the displacement of each point from its neighbours'.

    Parameters
    ----------
    points : (n, 2) array
        Pixels.
    displacement : (n, 2) array
        Pixels.
    neighbours : (n, k + 1) array of int64
        Points nearest to each, itself first.

    Returns
    -------
    (n, 2) array
        Pixels.
    """
    others = neighbours[:, 1:]
    return fit_robustly(points[others] - points[:, None], displacement[others])


def fit_robustly(offsets: Array, displacement: Array) -> Array:
    """Fit an affine map to the displacements of some neighbours, of which some may be wrong.

    Parameters
    ----------
    offsets : (n, k, 2) array
        Where the neighbours are, from the place that is asked for, pixels.
    displacement : (n, k, 2) array
        Pixels.

    Returns
    -------
    (n, 2) array
        The map's value at each place, pixels.
    """
    spread = np.sqrt((offsets**2).mean(axis=(1, 2), keepdims=True))
    terms = np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets / np.maximum(spread, 1e-12)], axis=2)
    ridge = offsets.shape[1] * RIDGE**2 * np.diag([0.0, 1.0, 1.0])
    weights = np.ones(offsets.shape[:2])
    for _ in range(N_ROUNDS):
        weighted = terms * weights[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, terms) + weights.mean(axis=1)[:, None, None] * ridge
        coefficients = np.linalg.solve(normal, np.einsum("nki,nkc->nic", weighted, displacement))
        misfit = np.linalg.norm(terms @ coefficients - displacement, axis=2)
        weights = 1.0 / np.maximum(misfit, SMALLEST)
    return np.asarray(coefficients[:, 0])
