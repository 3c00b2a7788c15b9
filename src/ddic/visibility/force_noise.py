"""How strongly a residual acts on displacements: measured on the forces of cells, white or not.

The residual r = f - a g(x + u) - b leaves in each cell e the forces b_e = sum N^T grad f r. Were its pixels
independent, with variance v, these had the covariance v M_e. A residual whose neighbours go together (interpolation,
JPEG, blur, a displacement that elements cannot follow), or whose pixels of steep gradients have other noise than the
rest (clipping), acts more or less strongly than its variance s^2 says. How much is measured, for b_e^T M_e^-1 b_e has
the expectation v times the number of components of b_e that the field has not made 0:

    v = sum_e b_e^T M_e^-1 b_e / (sum_e rank M_e - tr(A^-1 M)).

A white residual has v = s^2. Noise of f is in grad f, too. It makes M larger by NOISE_OF_SLOPE sigma_f^2 sum N^T N,
which is no texture: forces change with the displacement by theta M only, so that the field errs 1 / theta times as
much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import Residual
from ddic.functionals.noise_transfer import build_white_transfer, find_cell_transfer
from ddic.functionals.view import FrameView
from ddic.images.noise import NOISE_OF_SLOPE
from ddic.problem.residual_model import Evaluation, ResidualModel

Array = NDArray[np.float64]

MOST_CELLS = 1000
"""Cells that are measured, spread over the mesh: v is then known to 2 %, for a pass over their pixels."""

LEAST_TEXTURE = 0.2
"""Share of M that is taken for texture at least: where nearly all of it is noise, nothing is measured."""

REGULARIZED = 0.75
"""Power of 1 / theta by which a regularized field errs more: modes longer than l_c err by 1 / theta, shorter ones not
at all, and over the plane the integral of k dk / (theta + k^4)^2 goes with theta^-3/2."""

OF_SHAPES = 0.56
"""Share of the unknowns that quadrangles are determined by which is not their cells' translation."""

FEW_FREE = 20.0
"""Components of forces that tell as much as the expectation that a residual is white: by so many v is known to 30 %."""

SINGULAR = 1e-6
"""Eigenvalue of M_e, relative to its largest one, up to which it is 0."""


TINY = 1e-300
"""A variance, grey levels squared, below any that is not 0."""


@dataclass(frozen=True)
class ForceNoise:
    """Noise of the residual as it acts on displacements.

    Attributes
    ----------
    excess : float
        v / s^2: the variance of its forces over that which pixels independent of each other would leave, no unit.
    variance : float
        s^2, of its pixels, what the field has taken from them put back, grey levels squared.
    texture : float
        theta, share of M that is texture, no unit.
    amplification : float
        By which the field errs more than A^-1 says, since a part of M is noise, no unit.
    """

    excess: float
    variance: float
    texture: float
    amplification: float

    @property
    def sigma(self) -> float:
        """Standard deviation of white noise of both images that would leave the same field, grey levels."""
        return float(self.amplification * np.sqrt(0.5 * self.excess * self.variance))


def measure_force_noise(model: ResidualModel, evaluation: Evaluation, q: Sequence[Array], n_determined: float, *,
                        is_regularized: bool, bias: Sequence[Array] | None = None) -> ForceNoise:
    """Measure how strongly the residual of the first camera acts on displacements; collective.

    The result is the same on all ranks and for any partition. ``n_determined`` is tr(A^-1 M): how many unknowns the
    images determine, all of them without a regularization; ``is_regularized`` says whether mechanics determine the
    others. ``bias`` is the field less the true one, as far as regularization makes the difference, pixels: forces that
    hold it are no noise. Where it is not given, forces that move a cell as a whole are left out, in which most of it
    is.
    """
    team, state = model.team, evaluation.grey[0]
    n_cells = team.sum(sum(of_subdomain.subdomain.mesh.n_cells for of_subdomain in model.views))
    stride = n_cells // MOST_CELLS + 1
    is_biased = is_regularized and bias is None
    typical = max(state.residual_std**2, TINY)

    def measure() -> list[Array]:
        found = []
        for number, (of_subdomain, residuals, q_s) in enumerate(zip(model.views, evaluation.residuals, q, strict=True)):
            own, residual = of_subdomain.views[0], residuals[0]
            correction = model.find_correction(evaluation, own.camera, residual)
            is_sampled = of_subdomain.subdomain.cell_ids % stride == 0
            is_sampled &= residual.cell_sums.n_pixels > 0
            cells = _SampledCells.compute(own, residual, correction, is_sampled, q_s, follows=model.follows)
            if bias is not None:
                cells = cells.without_bias(own, bias[number])
            found.append(cells.add_up(own, residual, correction, q_s, typical, without_translations=is_biased))
        return found

    sums = _Sums(*team.ordered_sum(team.together(measure)))
    taken = n_determined / n_cells * (OF_SHAPES if is_biased else 1.0)
    n_free = max(sums.ranks - taken * sums.variances, 0.0)
    # Where so few are free that chance rules them the residual counts as white.
    white = FEW_FREE * sums.variances / max(sums.n_cells, 1.0)
    excess = (sums.energies + white) / (n_free + white) if white > 0 else 1.0
    variance = state.residual_std**2 / max(1.0 - n_determined / max(state.n_pixels, 1), TINY)
    of_reference = variance / (1.0 + sums.transfer / max(sums.n_pixels, 1.0))
    of_noise = of_reference * sums.noise_of_slopes / max(sums.slopes, TINY)
    texture = float(np.clip(1.0 - of_noise, LEAST_TEXTURE, 1.0))
    power = REGULARIZED if is_regularized else 1.0
    return ForceNoise(float(excess), float(variance), texture, texture**-power)


class _Sums(NamedTuple):
    """Sums over sampled cells, weighted by 1 / (s_e^2 + s^2), so that a few of large residuals do not rule them."""

    energies: float
    """Of b_e^T M_e^-1 b_e."""
    ranks: float
    """Of s_e^2 rank M_e."""
    variances: float
    """Of s_e^2."""
    n_cells: float
    n_pixels: float
    slopes: float
    """Of |grad f|^2, not weighted."""
    noise_of_slopes: float
    """What noise of one grey level adds to it."""
    transfer: float
    """Variance of g's noise after interpolation and gain over that before, of each pixel, not weighted."""


@dataclass(frozen=True, eq=False)
class _SampledCells:
    """Forces of some cells of a subdomain, and how they depend on its nodes.

    Attributes
    ----------
    numbers : (n,) array
        Of the cells.
    hessians, forces : (n, 8, 8) and (n, 8) array
        M_e and b_e.
    """

    numbers: NDArray[np.int64]
    hessians: Array
    forces: Array

    @classmethod
    def compute(cls, own: FrameView, residual: Residual, correction: tuple[Array, Array], is_sampled: NDArray[np.bool_],
                q: Array, *, follows: bool) -> _SampledCells:
        """At a field, with the gradient that it is sought with."""
        confined = replace(own, view=replace(own.view, correlation=own.view.correlation.confine(is_sampled)))
        view = confined.without_hidden(q)
        correlation = (view.with_moved_gradient(q) if follows else view).correlation
        numbers = np.flatnonzero(is_sampled)
        return cls(numbers, correlation.compute_cell_hessians()[numbers],
                   correlation.compute_cell_forces(numbers, residual, *correction))

    def without_bias(self, own: FrameView, bias: Array) -> _SampledCells:
        """The same at the field without its bias."""
        at_corners = own.view.kinematics.displacement(bias)[own.view.correlation.interpolation.cell_dofs[self.numbers]]
        return replace(self, forces=self.forces + np.einsum("eij,ej->ei", self.hessians, at_corners))

    def add_up(self, own: FrameView, residual: Residual, correction: tuple[Array, Array], q: Array, typical: float, *,
               without_translations: bool) -> Array:
        """What they tell, in the order of _Sums; ``typical`` is the variance of the residual."""
        values, vectors = np.linalg.eigh(self.hessians)
        is_held = values > SINGULAR * values[:, -1:]
        along = np.einsum("eji,ej->ei", vectors, self.forces)
        energies = np.divide(along**2, values, out=np.zeros_like(values), where=is_held).sum(axis=1)
        ranks = is_held.sum(axis=1)
        translations = self.hessians.reshape(-1, 4, 2, 4, 2).sum(axis=(1, 3))
        if without_translations:
            whole = self.forces.reshape(-1, 4, 2).sum(axis=1)
            energies -= np.einsum("ei,ei->e", whole, (np.linalg.pinv(translations) @ whole[..., None])[..., 0])
            ranks = np.maximum(ranks - 2, 0)
        degree = own.deformed.degree
        transfers = find_cell_transfer(build_white_transfer(degree), own.view, q, self.numbers)[:, 0]
        gain = np.broadcast_to(correction[0], len(residual.cell_sums.n_pixels))[self.numbers]
        _, squares = residual.cell_sums.sum_residual(*correction)
        n = residual.cell_sums.n_pixels[self.numbers]
        variances = squares[self.numbers] / n
        weights = 1.0 / (variances + typical)
        slopes = translations.trace(axis1=1, axis2=2)
        return np.array([weights @ energies, weights @ (variances * ranks), weights @ variances, len(n), n.sum(),
                         slopes.sum(), 2.0 * NOISE_OF_SLOPE[degree] * n.sum(), n @ (gain**2 * transfers)])
