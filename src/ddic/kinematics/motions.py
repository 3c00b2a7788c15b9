"""Rotations with a scale, and affine maps, fitted to points and their displacements, of which some may be wrong."""

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array
from ddic.mesh.plane import build_tree
from ddic.mesh.rotation import fit_rotation

THIN = 0.02
"""Width of a set of points, times its length, below which they are on a line and tell no affine map. A larger value
takes a similarity for more of them."""

LEAST_TURN = 1e-6
"""Weight, relative to what points tell, of the wish for no rotation where they tell none."""

N_NEIGHBOURS = 12
"""Neighbours that an affine map is fitted to: twice its unknowns a component, and as many again for wrong ones."""

PLACES_AT_ONCE = 50_000
"""Places whose neighbours are held at the same time: 100 MB."""

N_ROUNDS = 15
"""Rounds of reweighting, which leave the least sum of distances instead of squares: wrong neighbours hardly count."""

RIDGE = 1e-3
"""Share of the neighbours' spread that holds a gradient which they do not tell."""

SMALLEST = 1e-3
"""Misfit, pixels, below which a neighbour's weight grows no more."""


@dataclass(frozen=True, eq=False)
class AffineMap:
    """A displacement that is linear in the position.

    Attributes
    ----------
    centre, translation : (dim,) array
        A position, and its displacement, pixels.
    gradient : (dim, dim) array
        du_i/dx_j.
    """

    centre: Array
    translation: Array
    gradient: Array

    def at(self, points: Array) -> Array:
        """Evaluate the displacement at points, (n, dim), pixels."""
        return np.asarray(self.translation + (points - self.centre) @ self.gradient.T)


def fit_affine_map(points: Array, displacement: Array) -> AffineMap:
    """Fit the map of least squares that the points tell, at least one, (n, dim), pixels.

    It is a translation of one point, a rotation with a scale of two or of several on a line, in space in a plane too,
    affine of others.
    """
    centre, translation = points.mean(axis=0), displacement.mean(axis=0)
    offsets, rest = points - centre, displacement - translation
    axes = np.linalg.svd(offsets, compute_uv=False)
    if axes[0] == 0.0:
        return AffineMap(centre, translation, np.zeros((len(centre), len(centre))))
    dim = len(centre)
    if len(axes) == dim and axes[-1] > THIN * axes[0]:
        return AffineMap(centre, translation, np.linalg.lstsq(offsets, rest, rcond=None)[0].T)
    if dim == 3:
        return AffineMap(centre, translation, fit_similarity(offsets, offsets + rest) - np.eye(3))
    return AffineMap(centre, translation, fit_complex_factor(offsets, rest))


def fit_complex_factor(points: Array, images: Array) -> Array:
    """Fit the matrix [[c, -s], [s, c]] of least squares that takes points to their images, both (n, 2).

    It multiplies x + iy by c + is: of places about their means it is a rotation with a scale, of displacements that
    less 1.
    """
    (x, y), (u, v) = points.T, images.T
    c, s = np.array([x @ u + y @ v, x @ v - y @ u]) / (x @ x + y @ y)
    return np.array([[c, -s], [s, c]])


def fit_similarity(points: Array, images: Array) -> Array:
    """Fit the rotation with a scale, (3, 3), of least squares that takes points to their images, both (n, 3).

    Of points on a line, which leave the rotation about it open, it is the least rotation.
    """
    products = images.T @ points
    rotation = fit_rotation(products + LEAST_TURN * np.linalg.norm(products) * np.eye(3))
    return np.asarray(rotation * ((rotation * products).sum() / (points**2).sum()))


def interpolate_robustly(points: Array, displacement: Array, places: Array, *, skip: int = 0) -> Array:
    """Interpolate displacements at points to places, all (n, 2), by affine maps of the nearest points.

    Some points may be wrong. Of those nearest to a place ``skip`` are not looked at: 1 of a place that is a point.
    """
    values = np.empty(places.shape)
    tree, n_neighbours = build_tree(points), min(N_NEIGHBOURS, len(points) - skip)
    for first in range(0, len(places), PLACES_AT_ONCE):
        some = slice(first, first + PLACES_AT_ONCE)
        near = tree.query(places[some], list(range(skip + 1, skip + n_neighbours + 1)))[1]
        values[some] = fit_robustly(points[near] - places[some, None], displacement[near])
    return values


def fit_robustly(offsets: Array, displacement: Array) -> Array:
    """Fit an affine map to the displacements of some neighbours, of which some may be wrong.

    The least sum of distances alone follows a wrong one far from all others, hence each weighs by 1 less its leverage.
    Returns the map's value at each place, (n, 2), pixels, from which the neighbours are at ``offsets``, (n, k, 2).
    """
    spread = np.sqrt((offsets**2).mean(axis=(1, 2), keepdims=True))
    terms = np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets / np.maximum(spread, 1e-12)], axis=2)
    ridge = offsets.shape[1] * RIDGE**2 * np.diag([0.0, *np.ones(offsets.shape[2])])
    inverse = np.linalg.inv(np.einsum("nki,nkj->nij", terms, terms) + ridge)
    trust = np.maximum(1.0 - np.einsum("nki,nij,nkj->nk", terms, inverse, terms), SMALLEST)
    weights = trust
    for _ in range(N_ROUNDS):
        weighted = terms * weights[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, terms) + weights.mean(axis=1)[:, None, None] * ridge
        coefficients = np.linalg.solve(normal, np.einsum("nki,nkc->nic", weighted, displacement))
        misfit = np.linalg.norm(terms @ coefficients - displacement, axis=2)
        weights = trust / np.maximum(misfit, SMALLEST)
    return np.asarray(coefficients[:, 0])
