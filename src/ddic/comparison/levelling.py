"""Algebraic levelling: what the measurement makes of a displacement that is known.

A measured field is no displacement but what Gauss-Newton makes of one: its mesh, its texture and its regularization
filter it. A known displacement u is passed through the same filter. Where the specimen moves by u, grey-level
conservation leaves f - g(x + u_q) = grad f . (u - u_q) to first order, so that the field q that would be measured is
where the forces

    b = sum_px N^T grad f (grad f . (u - u_q))

balance those of the equilibrium gap, eta Kbar^T Kbar q: one linear step of the measurement's own operators, more where
these are not quite those of the frame's pixels. The pixels are those that count in the measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.correlation import Correlation, Residual, RowBand
from ddic.functionals.grey_statistics import GreySums
from ddic.functionals.pixel_kernels import N_SUMS
from ddic.functionals.view import FrameView
from ddic.images.volume import find_slopes
from ddic.mesh.cell_type import evaluate_monomials
from ddic.mesh.interpolation import place_in_cells
from ddic.mesh.raster import list_pixels
from ddic.parallel.field import Field
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.linear_step import LinearStep

SETTLED = 1e-6
"""RMS correction, pixels, at which a levelled field is found: far below what images tell."""

MOST_STEPS = 20
"""Linear steps at most; one, where the operators are those of the pixels that count."""

BAND_HEIGHT = 64
"""Rows of pixels that are gone through at a time; more take more memory."""

KnownDisplacement = Callable[[Array], Array]
"""Displacement at points of the image, from (n, dim) to (n, dim), pixels; nan where it is not known."""


@dataclass(frozen=True, eq=False)
class LevelledField:
    """A known displacement as the measurement would have found it.

    Attributes
    ----------
    q : Field
        Its unknowns, pixels.
    covered : list of (n_cells,) array
        Share of each cell's pixels at which the displacement is known, of each owned subdomain; elsewhere it counts as
        measured.
    """

    q: Field
    covered: list[Array]


def level(model: ResidualModel, step: LinearStep, measured: Field, known: KnownDisplacement) -> LevelledField:
    """Pass a known displacement through what the measurement does; collective.

    Parameters
    ----------
    model : ResidualModel
        Of the frame that was measured, of one camera, with the pixels that counted.
    step : LinearStep
        With the operators of the measurement.
    measured : Field
        What was measured.
    known : callable
        The displacement, at pixels of the reference image.

    Returns
    -------
    LevelledField
        Free of noise.

    Raises
    ------
    ConvergenceError
        On all ranks, where a linear step does not converge, or the steps do not settle.
    """
    shown = model.team.together(lambda: model.views.map(model.show, model.views.fill(measured)))

    def assemble(q: Field) -> list[tuple[Array, Array]]:
        return [assemble_known_forces(view.correlation, view.kinematics.displacement(q_s),
                                      view.kinematics.displacement(measured_s), known,
                                      corrects_light=model.correction == "element")
                for (view,), q_s, measured_s in zip(shown, q, measured, strict=True)]

    q = measured
    for _ in range(MOST_STEPS):
        found = model.team.together(partial(assemble, q))
        b = q.with_parts(_project(view, forces) for (view,), (forces, _) in zip(shown, found, strict=True))
        for part in (model.rotation, model.filled):
            if part is not None:
                b = b + part.compute_forces(q)
        dq = step.solve(q, b).dq
        q = q + dq
        if dq.measure_rms() <= SETTLED:
            return LevelledField(q, [covered for _, covered in found])
    raise as_collective(ConvergenceError(f"levelling the simulation does not settle in {MOST_STEPS} linear steps"))


def _project(view: FrameView, forces: Array) -> Array:
    """Forces on the unknowns of a view's subdomain from those on its nodes."""
    return np.asarray(view.weight * view.kinematics.project_vector(forces))


def assemble_known_forces(correlation: Correlation, u: Array, otherwise: Array, known: KnownDisplacement, *,
                          corrects_light: bool) -> tuple[Array, Array]:
    """Assemble sum N^T grad f (grad f . (u_known - u)), (n_dofs,), grey levels squared per pixel.

    ``u`` is the displacement of the nodes, (n_dofs,), pixels, ``otherwise`` the one that counts where none is known;
    ``corrects_light`` takes from each cell's grey levels what a gain and an offset of its own would. Beside it comes
    the share of each cell's pixels, (n_cells,), at which the displacement is known. The gradient is moved where the
    correlation asks for it.
    """
    mesh = correlation.mesh
    moments = np.zeros((mesh.n_cells, 1, mesh.dim, mesh.n_monomials))
    n_known, n_all = np.zeros(mesh.n_cells), np.zeros(mesh.n_cells)
    coefficients, others = (correlation.interpolation.monomial_coefficients(of_nodes) for of_nodes in (u, otherwise))
    for band in correlation.split_bands(BAND_HEIGHT):
        pixels, cells, slopes, grey = _list_usable_pixels(correlation, band)
        monomials = evaluate_monomials(place_in_cells(mesh, cells, pixels).local, mesh.n_monomials)
        wanted = known(pixels)
        is_known = np.isfinite(wanted).all(axis=1)
        is_other = np.flatnonzero(~is_known)
        wanted[is_other] = np.einsum("nm,nim->ni", monomials[is_other], others[cells[is_other]])
        difference = wanted - np.einsum("nm,nim->ni", monomials, coefficients[cells])
        n_known += np.bincount(cells, is_known, mesh.n_cells)
        n_all += np.bincount(cells, minlength=mesh.n_cells)
        moved = slopes
        if correlation.inverse_deformations is not None:
            moved = np.einsum("nji,nj->ni", correlation.inverse_deformations[cells], slopes)
        residual = (moved * difference).sum(axis=1)
        if corrects_light:
            residual -= _fit_light(residual, grey, cells, mesh.n_cells)
        for axis in range(mesh.dim):
            of_axis = residual * slopes[:, axis]
            for place, monomial in enumerate(monomials.T):
                moments[:, 0, axis, place] += np.bincount(cells, of_axis * monomial, mesh.n_cells)
    forces = correlation.assemble_right_hand_side(Residual(moments, GreySums(np.zeros((mesh.n_cells, N_SUMS)))))
    return forces, np.divide(n_known, n_all, out=np.zeros(mesh.n_cells), where=n_all > 0)


def _list_usable_pixels(correlation: Correlation, band: RowBand) -> tuple[Array, IntArray, Array, Array]:
    """Pixels of a band's cells that count, (n, dim), the cell of each, grad f, (n, dim), and f there."""
    image = correlation.reference.restrict(band.window)
    pixels: NDArray[Any]
    pixels, cells = list_pixels(correlation.raster, band.order)
    places = tuple((pixels - band.window.lower).T[::-1])
    slopes, grey = find_slopes(image)[(slice(None), *places)].T, np.asarray(image.grey_levels[places], np.float64)
    if image.usable is None:
        return pixels.astype(np.float64), cells, slopes, grey
    kept = np.flatnonzero(image.usable[places])
    return pixels[kept].astype(np.float64), cells[kept], slopes[kept], grey[kept]


def _fit_light(residual: Array, grey: Array, cells: IntArray, n_cells: int) -> Array:
    """What a gain and an offset of each cell take from the residual, at each pixel."""
    def sum_up(values: Array | Sequence[float]) -> Array:
        return np.asarray(np.bincount(cells, values, n_cells), np.float64)

    n = np.maximum(sum_up(np.ones(len(cells))), 1.0)
    centred = grey - (sum_up(grey) / n)[cells]
    mean = sum_up(residual) / n
    variance = sum_up(centred**2)
    gain = np.divide(sum_up(centred * residual), variance, out=np.zeros(n_cells), where=variance > 0)
    return np.asarray(mean[cells] + gain[cells] * centred)
