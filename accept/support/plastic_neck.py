"""A strip with two notches that necks between them: finite elements of the plastic law, drawn apart in steps.

The notches are cells of next to no stiffness, so that the field is one on a grid of equal squares; splines of it are
what images are rendered with.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.interpolate import RectBivariateSpline
from scipy.sparse.linalg import splu

from ddic.arrays import Array
from ddic.functionals.plasticity import OF_PLASTIC, TO_MODES, PlasticCells, PlasticLaw, PlasticState
from ddic.mesh.structured import build_structured_mesh
from ddic.synth.fields import DisplacementField

ELEMENT = 4.0
"""Side of the truth's elements, pixels."""

VOID = 1e-6
"""Stiffness of the notches, relative."""

SETTLED = 1e-10
"""Correction at which a step of the truth is found, pixels."""


@dataclass(frozen=True, eq=False)
class GridField(DisplacementField):
    """A displacement by cubic splines through the nodes of a grid.

    Attributes
    ----------
    x, y : (n_columns,) and (n_rows,) array
        Of the nodes, pixels.
    values : (n_rows, n_columns, 2) array
        Displacements there, pixels.
    """

    x: Array
    y: Array
    values: Array

    @cached_property
    def _splines(self) -> list[RectBivariateSpline]:
        return [RectBivariateSpline(self.y, self.x, self.values[..., axis]) for axis in range(2)]

    def displacement(self, points: Array) -> Array:
        """Displacement at points, (n, 2), pixels."""
        return np.stack([spline.ev(points[:, 1], points[:, 0]) for spline in self._splines], axis=-1)

    def gradient(self, points: Array) -> Array:
        """Its gradient du_i / dx_j, (n, 2, 2)."""
        return np.stack([np.stack([spline.ev(points[:, 1], points[:, 0], dy=1),
                                   spline.ev(points[:, 1], points[:, 0], dx=1)], axis=-1)
                         for spline in self._splines], axis=-2)


def draw_strip(law: PlasticLaw, box: tuple[float, float, float, float], radius: float,
               elongations: Array) -> list[GridField]:
    """Draw a strip apart along x, in steps of some elongations, pixels, with notches of a radius in its long edges."""
    mesh = build_structured_mesh(box, ELEMENT)
    x0, y0, x1, y1 = box
    middle = 0.5 * (x0 + x1)
    of_notch = [np.hypot(*(mesh.centroids - [middle, y]).T) < radius for y in (y0, y1)]
    cells = PlasticCells(mesh, law, np.where(np.any(of_notch, axis=0), VOID, 1.0))
    ends = [np.flatnonzero(mesh.nodes[:, 0] == x) for x in (x0, x1)]
    held = np.concatenate([2 * ends[0], 2 * ends[1], 2 * ends[0][:1] + 1])
    is_free = np.ones(mesh.n_dofs, dtype=bool)
    is_free[held] = False
    q, state, fields = np.zeros(mesh.n_dofs), PlasticState.none(cells.n_points), []
    for elongation in elongations:
        pulled = np.zeros(mesh.n_dofs)
        pulled[2 * ends[1]] = elongation - q[2 * ends[1]]
        q = _solve(cells, q, pulled, state, is_free)
        state = cells.compute_forces(q, state)[1]
        x, y = np.unique(mesh.nodes[:, 0]), np.unique(mesh.nodes[:, 1])
        order = np.lexsort((mesh.nodes[:, 0], mesh.nodes[:, 1]))
        fields.append(GridField(x, y, q.reshape(-1, 2)[order].reshape(len(y), len(x), 2).copy()))
    return fields


def assemble_tangent(cells: PlasticCells, q: Array, before: PlasticState) -> sparse.csr_matrix:
    """K_tan, the derivative of f_int by q; [SH98], Box 3.3."""
    law, width = cells.law, cells.mesh.n_monomials * 2
    trial = (cells.compute_strains(q) - before.strain) @ TO_MODES.T * law.moduli
    gamma = law.find_multiplier(trial, before.amount)
    # Xi = (C^-1 + gamma P)^-1, on the modes.
    xi = 1.0 / (1.0 / law.moduli + gamma[:, None] * OF_PLASTIC)
    direction = OF_PLASTIC * xi / law.moduli * trial
    squared = (xi / law.moduli * trial * direction).sum(axis=1)
    hardening = 2 / 3 * law.hardening_ratio * squared / (1.0 - 2 / 3 * law.hardening_ratio * gamma)
    along = xi * direction
    scale = np.where(gamma > 0, 1.0 / np.where(gamma > 0, (along * direction).sum(axis=1) + hardening, 1.0), 0.0)
    on_modes = xi[:, :, None] * np.eye(3) - scale[:, None, None] * along[:, :, None] * along[:, None, :]
    tangents = TO_MODES.T @ on_modes @ TO_MODES
    of_cells = np.zeros((cells.mesh.n_cells, width, width))
    for block, b, weights, points in cells.blocks:
        weighted = weights[..., None, None] * tangents[points].reshape(*weights.shape, 3, 3)
        n = b.shape[-1]
        of_cells[block.cells, :n, :n] = np.einsum("epsn,epst,eptm->enm", b, weighted, b, optimize=True)
    return cells.interpolation.assemble_matrix(of_cells)


def _solve(cells: PlasticCells, q: Array, pulled: Array, before: PlasticState, is_free: Array) -> Array:
    """Newton's method for the free nodes to be in equilibrium, where others are pulled on from q."""
    for _ in range(50):
        stiffness = assemble_tangent(cells, q, before)[is_free]
        forces = cells.compute_forces(q, before)[0][is_free] + stiffness @ pulled
        correction = splu(stiffness[:, is_free].tocsc()).solve(-forces)
        q, pulled = q + pulled, np.zeros_like(q)
        step = np.zeros_like(q)
        step[is_free] = correction
        # The incremental energy is convex: along the step its slope grows, and may not end as far up as it began down.
        slope = np.abs(forces @ correction)
        while cells.compute_forces(q + step, before)[0] @ step > 0.5 * slope:
            step *= 0.5
        q = q + step
        if np.abs(correction).max() < SETTLED:
            return q
    raise RuntimeError("the strip was not found in 50 iterations")
