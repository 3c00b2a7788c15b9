"""Plasticity in plane stress, for small strains: von Mises' yield stress with linear isotropic hardening.

[SH98] Simo & Hughes, Computational Inelasticity, Springer 1998, section 3.4. Stresses are relative to Young's modulus.
Components are xx, yy and xy, of strains 2 xy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ddic.arrays import Array
from ddic.kinematics.cell_interpolation import CellInterpolation, interpolate_cells
from ddic.mesh.mesh import CellsOfType, Mesh, compute_shape_gradients

TO_MODES = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]]) / np.sqrt(2.0)
"""Orthonormal modes of stresses, its rows, on which an isotropic C is diagonal."""

OF_PLASTIC = np.array([1 / 3, 1.0, 2.0])
"""P on these modes: sigma^T P sigma is 2/3 of the squared equivalent stress of von Mises, P sigma the direction of
plastic strains."""

MOST_CORRECTIONS = 50
"""Of Newton's iteration for the plastic multiplier, which a convex decreasing function makes converge from below."""

EXACT = 1e-14
"""Share of the yield stress by which a stress may lie beyond it."""


@dataclass(frozen=True, eq=False)
class PlasticState:
    """What points of a material have been through.

    Attributes
    ----------
    strain : (n_points, 3) array
        Plastic strain.
    amount : (n_points,) array
        Equivalent plastic strain, which never decreases.
    """

    strain: Array
    amount: Array

    @classmethod
    def none(cls, n_points: int) -> PlasticState:
        """Points that have never yielded."""
        return cls(np.zeros((n_points, 3)), np.zeros(n_points))


@dataclass(frozen=True)
class PlasticLaw:
    """Elasticity up to a yield stress, which hardens as the material flows; Young's modulus is 1.

    Attributes
    ----------
    poisson_ratio : float
        nu.
    yield_strain : float
        Yield stress in tension over Young's modulus.
    hardening_ratio : float
        Of the yield stress by the equivalent plastic strain, over Young's modulus.
    """

    poisson_ratio: float
    yield_strain: float
    hardening_ratio: float = 0.0

    @property
    def moduli(self) -> Array:
        """C on its modes, (3,)."""
        nu = self.poisson_ratio
        return np.array([1.0 / (1.0 - nu), 1.0 / (1.0 + nu), 0.5 / (1.0 + nu)])

    def compute_stress(self, strain: Array, before: PlasticState) -> tuple[Array, PlasticState]:
        """Respond to strains, (n_points, 3), by stresses and what the points have been through then.

        The stress beyond the yield stress returns to it along P sigma at the end of the step.
        """
        trial = (strain - before.strain) @ TO_MODES.T * self.moduli
        gamma = self.find_multiplier(trial, before.amount)
        # (I + gamma C P) sigma = trial, on the modes.
        stress = trial / (1.0 + gamma[:, None] * self.moduli * OF_PLASTIC)
        direction = OF_PLASTIC * stress
        equivalent = np.sqrt((stress * direction).sum(axis=1))
        flow = gamma[:, None] * direction @ TO_MODES
        now = PlasticState(before.strain + flow, before.amount + np.sqrt(2 / 3) * gamma * equivalent)
        return stress @ TO_MODES, now

    def find_multiplier(self, trial: Array, amount: Array) -> Array:
        """Plastic multipliers of trial stresses on the modes, (n_points,): zero where these do not reach the yield.

        X(gamma) (1 - 2/3 H gamma) = sqrt(2/3) (sigma_y + H alpha), X^2 = sigma^T P sigma.
        """
        first, second = trial[:, 0]**2 / 3.0, trial[:, 1]**2 + 2.0 * trial[:, 2]**2
        of_first, of_second = (OF_PLASTIC * self.moduli)[:2]
        hardening = 2 / 3 * self.hardening_ratio
        radius = np.sqrt(2 / 3) * (self.yield_strain + self.hardening_ratio * amount)
        gamma = np.zeros(len(trial))
        flows = np.flatnonzero(np.sqrt(first + second) > radius * (1.0 + EXACT))
        for _ in range(MOST_CORRECTIONS):
            by_first, by_second = 1.0 + of_first * gamma[flows], 1.0 + of_second * gamma[flows]
            x = np.sqrt(first[flows] / by_first**2 + second[flows] / by_second**2)
            slope = -(of_first * first[flows] / by_first**3 + of_second * second[flows] / by_second**3) / x
            left = 1.0 - hardening * gamma[flows]
            excess = x * left - radius[flows]
            gamma[flows] -= excess / (slope * left - hardening * x)
            flows = flows[excess > EXACT * radius[flows]]
            if not len(flows):
                break
        return gamma


@dataclass(frozen=True, eq=False)
class PlasticCells:
    """Cells of a plastic material and their forces f_int, of Remark 1 of [BP17].

    Attributes
    ----------
    mesh : Mesh
        Plane; lengths in pixels.
    law : PlasticLaw
        Of all cells.
    relative : (n_cells,) array
        Factor of the stresses of each cell.
    """

    mesh: Mesh
    law: PlasticLaw
    relative: Array

    @property
    def n_points(self) -> int:
        """Number of quadrature points."""
        return sum(len(block.cells) * len(block.type.quadrature.weights) for block in self.mesh.cell_blocks)

    def compute_forces(self, q: Array, before: PlasticState) -> tuple[Array, PlasticState]:
        """Compute the forces of a displacement of nodes, (n_dofs,), and what the points have been through then."""
        stress, now = self.law.compute_stress(self.compute_strains(q), before)
        of_cells = np.zeros((self.mesh.n_cells, self.mesh.n_monomials * 2))
        for block, b, weights, points in self.blocks:
            weighted = weights[..., None] * stress[points].reshape(*weights.shape, 3)
            of_cells[block.cells, :b.shape[-1]] = np.einsum("epsn,eps->en", b, weighted)
        forces = np.zeros(self.mesh.n_dofs)
        np.add.at(forces, self.interpolation.cell_dofs, of_cells)
        return forces, now

    def average(self, at_points: Array) -> Array:
        """Average values at the points, (n_points,), over each cell, (n_cells,)."""
        found = np.empty(self.mesh.n_cells)
        for block, _, weights, points in self.blocks:
            found[block.cells] = at_points[points].reshape(weights.shape).mean(axis=1)
        return found

    def compute_strains(self, q: Array) -> Array:
        """Strains at the points, (n_points, 3)."""
        return np.concatenate([np.einsum("epsn,en->eps", b, q.reshape(-1, 2)[block.nodes].reshape(len(b), -1))
                               .reshape(-1, 3) for block, b, _, _ in self.blocks])

    @cached_property
    def interpolation(self) -> CellInterpolation:
        """From the cells to the nodes."""
        return interpolate_cells(self.mesh)

    @cached_property
    def blocks(self) -> list[tuple[CellsOfType, Array, Array, slice]]:
        """Of the cells of each type: B, (n, n_points, 3, n_nodes 2), weights of the points, and their places."""
        found, begin = [], 0
        for block in self.mesh.cell_blocks:
            quadrature = block.type.quadrature
            gradients, det = compute_shape_gradients(self.mesh, block, quadrature.points)
            n, n_points, k, _ = gradients.shape
            b = np.zeros((n, n_points, 3, k, 2))
            b[:, :, 0, :, 0] = b[:, :, 2, :, 1] = gradients[..., 0]
            b[:, :, 1, :, 1] = b[:, :, 2, :, 0] = gradients[..., 1]
            weights = det * quadrature.weights * self.relative[block.cells, None]
            found.append((block, b.reshape(n, n_points, 3, 2 * k), weights, slice(begin, begin + n * n_points)))
            begin += n * n_points
        return found
