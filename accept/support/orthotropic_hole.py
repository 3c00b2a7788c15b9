"""Lekhnitskii's field about a round hole in an orthotropic plate under tension, whose fibres have any direction.

S. G. Lekhnitskii, Anisotropic Plates (1968), chapter VI, by two functions Phi_k of z_k = x + mu_k y, where mu_k are the
roots of a11 mu^4 - 2 a16 mu^3 + (2 a12 + a66) mu^2 - 2 a26 mu + a22 = 0, a the compliance along x and y:

    dU/dx = 2 Re sum Phi_k, dU/dy = 2 Re sum mu_k Phi_k,   u = 2 Re sum p_k Phi_k, v = 2 Re sum q_k Phi_k,
    p_k = a11 mu_k^2 + a12 - a16 mu_k,   q_k = a12 mu_k + a22 / mu_k - a26.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ddic.arrays import Array
from ddic.identification.laws import ElasticLaw
from ddic.synth.fields import DisplacementField

STEP = 1e-3
"""Pixels by which the field is differentiated: off by 1e-9 of its slopes."""


@dataclass(frozen=True)
class OrthotropicHole(DisplacementField):
    """The displacement about a hole without tractions.

    Attributes
    ----------
    parameters : tuple of float
        E1, E2, nu12, G12 and the angle of axis 1, degrees; plane stress.
    centre, radius : (x, y) and float
        Of the hole, pixels.
    stress : (3,) tuple of float
        Far away: xx, yy, xy, in the unit of the moduli.
    motion : (x, y)
        A translation, pixels.
    """

    parameters: tuple[float, float, float, float, float]
    centre: tuple[float, float]
    radius: float
    stress: tuple[float, float, float]
    motion: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def _compliance(self) -> Array:
        return np.linalg.inv(ElasticLaw("orthotropic").compute_stiffness(np.array(self.parameters)))

    @cached_property
    def _roots(self) -> tuple[Any, Any, Any]:
        """mu_k, p_k and q_k."""
        (a11, a12, a16), (_, a22, a26), (_, _, a66) = self._compliance
        roots = np.roots([a11, -2.0 * a16, 2.0 * a12 + a66, -2.0 * a26, a22])
        mu = roots[roots.imag > 0]
        return mu, a11 * mu**2 + a12 - a16 * mu, a12 * mu + a22 / mu - a26

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement; in the hole it falls from that of the edge to that of the plate's middle."""
        mu, p, q = self._roots
        sx, sy, txy = self.stress
        arms = points - np.array(self.centre)
        length = np.linalg.norm(arms, axis=1, keepdims=True)
        arms = arms * np.maximum(1.0, self.radius / np.maximum(length, 1e-9))
        uniform = self._compliance @ np.array(self.stress)
        u = arms @ np.array([[uniform[0], 0.5 * uniform[2]], [0.5 * uniform[2], uniform[1]]]) + np.array(self.motion)
        a = self.radius
        amplitudes = np.linalg.solve(np.array([[1.0, 1.0], mu]), 0.5 * a * np.array([-sy + 1j * txy, txy - 1j * sx]))
        for k in range(2):
            z = arms[:, 0] + mu[k] * arms[:, 1]
            root = np.sqrt(z**2 - a**2 * (1.0 + mu[k] ** 2))
            candidates = np.stack([z + root, z - root]) / (a * (1.0 - 1j * mu[k]))
            # Outside the unit circle, of which the hole's edge is the image.
            zeta = np.where(np.abs(candidates[0]) >= np.abs(candidates[1]), *candidates)
            phi = amplitudes[k] / zeta
            u += 2.0 * np.stack([(p[k] * phi).real, (q[k] * phi).real], axis=1)
        inside = np.minimum(1.0, length / self.radius)
        return np.asarray(inside * u + (1.0 - inside) * np.array(self.motion))

    def gradient(self, points: Array) -> Array:
        """Differentiate it by central differences."""
        changes = [self.displacement(points + shift) - self.displacement(points - shift) for shift in STEP * np.eye(2)]
        return np.asarray(np.stack(changes, axis=2) / (2.0 * STEP))
