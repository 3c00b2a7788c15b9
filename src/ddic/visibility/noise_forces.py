"""The noise of the images, and what it does to b: right-hand sides that have its covariance.

The noise is given, or that of images at rest, which count as white, or the residual as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.errors import InputError, as_collective
from ddic.functionals.correlation import Residual, map_hessians
from ddic.functionals.noise_transfer import (
    TransferTable,
    build_transfer,
    build_white_transfer,
    correlate_slopes,
    find_cell_transfer,
)
from ddic.functionals.view import FrameView, View
from ddic.images.noise import BLOCK, REACH, estimate_rest_noise
from ddic.images.window import Window
from ddic.io.image_file import hold_image
from ddic.mesh.quality import measure_covered_areas
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.probing import FEWEST_SAMPLES, MOST_SAMPLES, SampledCells, prepare_samples
from ddic.visibility.force_noise import ForceNoise

Array = NDArray[np.float64]

GIVEN, OF_REST, OF_RESIDUAL = "given", "of the images at rest", "estimated from the residual"


FEW_PIXELS = 64.0
"""Pixels of a cell whose residual tells half of its own noise, the mean over all cells the other half: the mean square
of so many is known to 18 %."""


@dataclass(frozen=True, eq=False)
class NoiseForces:
    """Forces that noise of the images leaves at a field, one right-hand side after the other.

    Attributes
    ----------
    views : list of list of (View, SampledCells)
        Of each owned subdomain.
    n_samples : int
        How many may be generated: all of them have the covariance of b.
    transfer : float
        How much of the deformed images' noise reaches b, mean over all cells and both directions; of the residual,
        its excess. No unit.
    """

    views: list[list[tuple[View, SampledCells]]]
    n_samples: int
    transfer: float

    def generate(self, sample: int) -> list[Array]:
        """Generate b_s of all owned subdomains, grey levels squared per pixel, from sample 0 to n_samples - 1."""
        return [np.sum([_assemble(view, cells.generate_forces(sample)) for view, cells in of_subdomain], axis=0)
                for of_subdomain in self.views]


def prepare_noise_forces(model: ResidualModel, evaluation: Evaluation, q: Sequence[Array], noise: Sequence[float],
                         case: Case) -> NoiseForces:
    """Find the covariance of b, sigma_f^2 M + sigma_g^2 C M C cell by cell; collective.

    Noise of the reference image enters b through f as it is, that of the deformed one through the spline, whose noise
    transfer at the cell's shifts is on C's diagonal. Noise of grad f multiplies that of f - g and is left out, and gain
    and offset of the grey levels count as known. ``model`` holds the pixels that count, cameras weighted; ``noise`` is
    of each camera's images, grey levels.
    """
    team, tables = model.team, _tabulate_by_camera(model, case.correlation.spline_degree)
    transfers = team.together(lambda: [[find_cell_transfer(tables[view.camera], view.view, q_s)
                                        for view in of_subdomain.views]
                                       for of_subdomain, q_s in zip(model.views, q, strict=True)])
    covariances = team.together(lambda: [
        [_weigh_noise(_compute_hessians(model, view, q_s), noise[view.camera],
                      _find_gain(model, evaluation, view, residual) * c)
         for view, residual, c in zip(of_subdomain.views, residuals, of_views, strict=True)]
        for of_subdomain, residuals, of_views, q_s
        in zip(model.views, evaluation.residuals, transfers, q, strict=True)])
    total, n_values = team.ordered_sum([np.array([sum(c.sum() for c in of_views), sum(c.size for c in of_views)])
                                        for of_views in transfers])
    return _sample(model, covariances, case, float(total / n_values))


def prepare_residual_forces(model: ResidualModel, evaluation: Evaluation, q: Sequence[Array], noise: ForceNoise,
                            case: Case) -> NoiseForces:
    """Find the covariance of b that the residual of one camera makes, white or not, v_e M_e cell by cell; collective.

    v_e is the variance of the cell's own residual times what its forces have more than those of independent pixels.
    Cells of few pixels, which tell little of their own noise, have that of all of them.
    """
    factor = noise.excess * noise.amplification**2

    def multiply() -> list[list[Array]]:
        covariances = []
        for of_subdomain, residuals, q_s in zip(model.views, evaluation.residuals, q, strict=True):
            own, residual = of_subdomain.views[0], residuals[0]
            _, squares = residual.cell_sums.sum_residual(*model.find_correction(evaluation, own.camera, residual))
            n = residual.cell_sums.n_pixels
            variances = (squares + FEW_PIXELS * noise.variance) / (n + FEW_PIXELS)
            covariances.append([factor * variances[:, None, None] * _compute_hessians(model, own, q_s)])
        return covariances

    return _sample(model, model.team.together(multiply), case, noise.excess)


def _sample(model: ResidualModel, covariances: Sequence[Sequence[Array]], case: Case, transfer: float) -> NoiseForces:
    """Right-hand sides whose covariance is given cell by cell, for each owned subdomain and view; collective."""
    n_samples = FEWEST_SAMPLES if case.regularization is None else MOST_SAMPLES
    places = place_cells(model.team, [of_subdomain.subdomain for of_subdomain in model.views])
    views = [[(view.view, prepare_samples(of_view, of_subdomain.subdomain.cell_ids, of_cells, view.camera, n_samples))
              for view, of_view in zip(of_subdomain.views, of_views, strict=True)]
             for of_subdomain, of_views, of_cells in zip(model.views, covariances, places, strict=True)]
    return NoiseForces(views, n_samples, transfer)


def find_white_transfer(model: ResidualModel, q: Sequence[Array], degree: int) -> list[list[Array]]:
    """Find the variance of the deformed image's interpolated noise over that of its pixels by cell; degree 3 or 5."""
    table = build_white_transfer(degree)
    return [[find_cell_transfer(table, view.view, q_s)[:, 0] for view in of_subdomain.views]
            for of_subdomain, q_s in zip(model.views, q, strict=True)]


def place_cells(team: Team, subdomains: Sequence[Subdomain]) -> list[NDArray[np.int64]]:
    """Tell each cell's column and row of cells, (n_cells, 2), as in a regular mesh of as many cells; collective."""
    area, n_cells = team.ordered_sum([np.array([measure_covered_areas(s.mesh)[0].sum(), s.mesh.n_cells])
                                      for s in subdomains])
    firsts = team.gather_lists([s.mesh.centroids.min(axis=0) for s in subdomains])
    first, size = np.min(firsts, axis=0), np.sqrt(area / n_cells)
    # The cells of a regular mesh lie in the middle of their places: rounding decides nothing.
    return [np.floor((s.mesh.centroids - first) / size + 0.5).astype(np.int64) for s in subdomains]


def _tabulate_by_camera(model: ResidualModel, degree: int) -> list[TransferTable]:
    """Noise transfer of the texture that each camera sees; collective."""
    def correlate() -> list[Array]:
        by_subdomain = []
        for of_subdomain in model.views:
            sums = np.zeros((model.n_cameras, 2, 2 * REACH + 1, 2 * REACH + 1))
            for view in of_subdomain.views:
                sums[view.camera] += correlate_slopes(view.view.correlation)
            by_subdomain.append(sums)
        return by_subdomain

    total = model.team.ordered_sum(model.team.together(correlate))
    return [build_transfer(of_camera, degree) for of_camera in total]


def _find_gain(model: ResidualModel, evaluation: Evaluation, view: FrameView, residual: Residual) -> Array:
    """Square of the gain by which each cell's g is multiplied, (1, 1) or (n_cells, 1)."""
    gain, _ = model.find_correction(evaluation, view.camera, residual)
    return np.asarray(np.atleast_1d(gain)[:, None] ** 2)


def _compute_hessians(model: ResidualModel, frame_view: FrameView, q: Array) -> Array:
    """M of each cell, (n_cells, n, n), of the pixels that are shown."""
    correlation = frame_view.without_hidden(q).correlation
    hessians = correlation.compute_cell_hessians()
    if model.follows:
        inverse = frame_view.view.with_moved_gradient(q).correlation.inverse_deformations
        hessians = map_hessians(require_held(inverse), hessians)
    return hessians


def _weigh_noise(hessians: Array, sigma: float, transfer: Array) -> Array:
    """Covariance of the forces of each cell, (n_cells, n, n); transfer: of g's noise to both components."""
    n = hessians.shape[1]
    scale = np.tile(np.sqrt(transfer), n // transfer.shape[1])
    return np.asarray(sigma**2 * hessians * (1.0 + scale[:, :, None] * scale[:, None, :]))


def _assemble(view: View, forces: Array) -> Array:
    """Assemble b of a view in the subdomain's unknowns from the forces on the nodes of each cell, (n_cells, n)."""
    interpolation = view.correlation.interpolation
    on_nodes = np.bincount(interpolation.cell_dofs.ravel(), forces.ravel(), interpolation.n_dofs)
    return np.asarray(view.weight * view.kinematics.project_vector(on_nodes.astype(np.float64, copy=False)))


@dataclass(frozen=True)
class ImageNoise:
    """The noise of each camera's images.

    Attributes
    ----------
    sigma : tuple of float
        Its standard deviation, by camera, grey levels.
    origin : str
        Where the first camera's comes from.
    """

    sigma: tuple[float, ...]
    origin: str


def find_image_noise(problem: WeightedProblem, model: ResidualModel, evaluation: Evaluation,
                     q: Sequence[Array]) -> ImageNoise:
    """Find the noise of the images; collective.

    It is what is given, else that of the images at rest, else of the residual; of several cameras that by which they
    are weighted.
    """
    inputs = problem.reference.inputs
    given = inputs.cameras[0].noise
    if problem.noise:
        return ImageNoise(problem.noise, OF_RESIDUAL if given is None else GIVEN)
    if given is not None:
        return ImageNoise((given,), GIVEN)
    if inputs.case.images.at_rest is not None:
        return ImageNoise((_measure_at_rest(problem, inputs.case.images.at_rest),), OF_REST)
    return ImageNoise((estimate_from_residual(model, evaluation, q, inputs.case.correlation.spline_degree),),
                      OF_RESIDUAL)


def estimate_from_residual(model: ResidualModel, evaluation: Evaluation, q: Sequence[Array], degree: int) -> float:
    """Estimate the noise of one camera's images from what the field leaves of grey-level conservation; collective.

    Of every cell the mean square of f - a g - b is sigma^2 (1 + a^2 c), c the noise transfer of the spline, whose
    degree is 3 or 5; the median over cells passes over those where the field does not follow the specimen. It is a
    standard deviation, grey levels; 0 where no pixel counts.
    """
    found = []
    for residuals, transfers in zip(evaluation.residuals, find_white_transfer(model, q, degree), strict=True):
        own, transfer = residuals[0], transfers[0]
        gain, offset = model.find_correction(evaluation, 0, own)
        _, squares = own.cell_sums.sum_residual(gain, offset)
        n = own.cell_sums.n_pixels
        with np.errstate(invalid="ignore", divide="ignore"):
            # The median of a mean of n squares is below their expectation (Wilson and Hilferty, PNAS 17, 1931).
            variances = squares / n / (1.0 + gain**2 * transfer) / (1.0 - 2.0 / (9.0 * n)) ** 3
        found.append(variances[n > 1])
    everywhere = np.concatenate(model.team.gather_lists(found))
    return float(np.sqrt(np.median(everywhere))) if len(everywhere) else 0.0


def _measure_at_rest(problem: WeightedProblem, path: Path) -> float:
    """Noise of the reference image and another one of the specimen as it is there; collective."""
    team, reference = problem.team, problem.reference.inputs.cameras[0].reference.image
    boxes = team.gather_lists([(s.mesh.nodes.min(axis=0), s.mesh.nodes.max(axis=0))
                               for s in problem.reference.subdomains])
    low = np.min([box[0] for box in boxes], axis=0).astype(int)
    high = np.max([box[1] for box in boxes], axis=0).astype(int)
    window = Window.between(low, high).intersection(reference.extent)
    noise = team.on_root(lambda: estimate_rest_noise(reference, hold_image(path), window))
    if not np.isfinite(noise):
        raise as_collective(InputError(f"images.at_rest: {path}: the mesh covers fewer than {BLOCK} x {BLOCK} px, from "
                                       "which no noise can be told; give images.noise"))
    return noise
