"""The noise of the images, and what it does to b: how strongly it acts, and right-hand sides that have its covariance.

The noise is given, or that of images at rest, which count as white, or the residual as it is, white or not.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.case.schema import Case
from ddic.errors import InputError, as_collective
from ddic.functionals.correlation import Residual
from ddic.functionals.noise_transfer import build_transfer, build_white_transfer, correlate_slopes, find_cell_transfer
from ddic.functionals.view import FrameView, View
from ddic.images.noise import BLOCKS, NOISE_OF_SLOPE, estimate_rest_noise
from ddic.images.window import Window
from ddic.io.volume_file import hold_source
from ddic.mesh.quality import measure_covered_areas
from ddic.parallel.distribution import find_quantile_of_all
from ddic.parallel.field import ByView, Field, add_views
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.probing import SampledCells, count_samples, prepare_samples

GIVEN, OF_REST, OF_RESIDUAL = "given", "of the images at rest", "estimated from the residual"

FEW_PIXELS = 64.0
"""Pixels of a cell whose residual tells half of its own noise, the mean over all cells the other half: the mean square
of so many is known to 18 %."""

MOST_CELLS = 1000
"""Cells that are measured, spread over the mesh: v is then known to 2 %, for a pass over their pixels."""

LEAST_TEXTURE = 0.2
"""Share of M that is taken for texture at least: where nearly all of it is noise, nothing is measured."""

REGULARIZED = {2: 0.75, 3: 0.625}
"""Power of 1 / theta by which a regularized field errs more: modes longer than l_c err by 1 / theta, shorter ones not
at all, and the integral of k^(dim - 1) dk / (theta + k^4)^2 goes with theta^(dim/4 - 2)."""

OF_SHAPES = {2: 0.56, 3: 0.71}
"""Share of the unknowns that quadrangles and hexahedra are determined by which is not their cells' translation: 0.44
and its power of 3/2 are."""

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


def measure_force_noise(model: ResidualModel, evaluation: Evaluation, q: Field, n_determined: float, *,
                        is_regularized: bool, bias: Sequence[Array] | None = None) -> ForceNoise:
    """Measure how strongly the residual of the first camera acts on displacements; collective.

    The result is the same on all ranks and for any partition. ``n_determined`` is tr(A^-1 M): how many unknowns the
    images determine, all of them without a regularization; ``is_regularized`` says whether mechanics determine the
    others. ``bias`` is the field less the true one, as far as regularization makes the difference, pixels: forces that
    hold it are no noise. Where it is not given, forces that move a cell as a whole are left out, in which most of it
    is.
    """
    team, state, dim = model.team, evaluation.grey[0], model.subdomains[0].mesh.dim
    n_cells = team.sum(sum(subdomain.mesh.n_cells for subdomain in model.subdomains))
    stride = n_cells // MOST_CELLS + 1
    is_biased = is_regularized and bias is None
    typical = max(state.residual_std**2, TINY)

    def add_up(place: int) -> Array:
        """What the sampled cells of a subdomain tell, in the order of _Sums."""
        own, residual, q_s = model.views[place][0], evaluation.residuals[place][0], q[place]
        gain, offset = model.find_correction(evaluation, own.camera, residual)
        of_cells = residual.cell_sums
        is_sampled = (model.subdomains[place].cell_ids % stride == 0) & (of_cells.n_pixels > 0)
        cells = np.flatnonzero(is_sampled)
        correlation = model.show(own.confine(is_sampled), q_s).correlation
        hessians = correlation.compute_cell_hessians()[cells]
        forces = correlation.compute_cell_forces(cells, residual, gain, offset)
        if bias is not None:
            at_corners = own.kinematics.displacement(bias[place])[correlation.interpolation.cell_dofs[cells]]
            forces = forces + np.einsum("eij,ej->ei", hessians, at_corners)
        n_corners = hessians.shape[1] // dim
        translations = hessians.reshape(-1, n_corners, dim, n_corners, dim).sum(axis=(1, 3))
        energies, ranks = _measure_energies(hessians, forces, translations if is_biased else None)
        degree, n = own.deformed.degree, of_cells.n_pixels[cells]
        transfers = find_cell_transfer(build_white_transfer(degree, dim), own, q_s, cells)[:, 0]
        gains = np.broadcast_to(gain, len(of_cells.n_pixels))[cells]
        _, squares = of_cells.sum_residual(gain, offset)
        variances = squares[cells] / n
        weights = 1.0 / (variances + typical)
        return np.array([weights @ energies, weights @ (variances * ranks), weights @ variances, len(n), n.sum(),
                         translations.trace(axis1=1, axis2=2).sum(), dim * NOISE_OF_SLOPE[degree] * n.sum(),
                         n @ (gains**2 * transfers)])

    sums = _Sums(*team.ordered_sum(team.together(lambda: [add_up(place) for place in range(len(q))])))
    taken = n_determined / n_cells * (OF_SHAPES[dim] if is_biased else 1.0)
    n_free = max(sums.ranks - taken * sums.variances, 0.0)
    # Where so few are free that chance rules them the residual counts as white.
    white = FEW_FREE * sums.variances / max(sums.n_cells, 1.0)
    excess = (sums.energies + white) / (n_free + white) if white > 0 else 1.0
    variance = state.residual_std**2 / max(1.0 - n_determined / max(state.n_pixels, 1), TINY)
    of_reference = variance / (1.0 + sums.transfer / max(sums.n_pixels, 1.0))
    of_noise = of_reference * sums.noise_of_slopes / max(sums.slopes, TINY)
    texture = float(np.clip(1.0 - of_noise, LEAST_TEXTURE, 1.0))
    power = REGULARIZED[dim] if is_regularized else 1.0
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


def _measure_energies(hessians: Array, forces: Array, translations: Array | None) -> tuple[Array, Array]:
    """b_e^T M_e^-1 b_e and rank M_e, (n,), of translations, (n, dim, dim), without what moves cells as a whole."""
    values, vectors = np.linalg.eigh(hessians)
    is_held = values > SINGULAR * values[:, -1:]
    along = np.einsum("eji,ej->ei", vectors, forces)
    energies = np.divide(along**2, values, out=np.zeros_like(values), where=is_held).sum(axis=1)
    ranks = is_held.sum(axis=1)
    if translations is not None:
        dim = translations.shape[1]
        whole = forces.reshape(len(forces), -1, dim).sum(axis=1)
        energies -= np.einsum("ei,ei->e", whole, (np.linalg.pinv(translations) @ whole[..., None])[..., 0])
        ranks = np.maximum(ranks - dim, 0)
    return energies, ranks


@dataclass(frozen=True, eq=False)
class NoiseForces:
    """Forces that noise of the images leaves at a field, one right-hand side after the other.

    Attributes
    ----------
    views, cells : ByView of View and of SampledCells
        Of owned subdomains.
    n_samples : int
        How many may be generated: all of them have the covariance of b.
    transfer : float
        How much of the deformed images' noise reaches b, mean over all cells and both directions; of the residual,
        its excess. No unit.
    """

    views: ByView[FrameView]
    cells: ByView[SampledCells]
    n_samples: int
    transfer: float

    def generate(self, sample: int) -> list[Array]:
        """Generate b_s of all owned subdomains, grey levels squared per pixel, from sample 0 to n_samples - 1."""
        return add_views(self.views.map(lambda view, cells: _assemble(view, cells.generate_forces(sample)), self.cells))


def prepare_noise_forces(model: ResidualModel, evaluation: Evaluation, q: Field, noise: Sequence[float],
                         case: Case) -> NoiseForces:
    """Find the covariance of b, sigma_f^2 M + sigma_g^2 C M C cell by cell; collective.

    Noise of the reference image enters b through f as it is, that of the deformed one through the spline, whose noise
    transfer at the cell's shifts is on C's diagonal. Noise of grad f multiplies that of f - g and is left out, and gain
    and offset of the grey levels count as known. ``model`` holds the pixels that count, cameras weighted; ``noise`` is
    of each camera's images, grey levels.
    """
    team, at = model.team, model.views.fill(q)
    slopes = team.together(lambda: model.views.map(lambda view: correlate_slopes(view.correlation)))
    # Of the texture that each camera sees.
    tables = [build_transfer(of_camera, case.correlation.spline_degree) for of_camera in model.sum_by_camera(slopes)]
    transfers = team.together(lambda: model.views.map(
        lambda view, q_s: find_cell_transfer(tables[view.camera], view, q_s), at))

    def weigh(view: FrameView, residual: Residual, transfer: Array, q_s: Array) -> Array:
        gain, _ = model.find_correction(evaluation, view.camera, residual)
        # Of one camera, or of each cell.
        of_g = np.atleast_1d(gain)[:, None] ** 2 * transfer
        hessians = model.show(view, q_s).correlation.compute_cell_hessians()
        # Node by node, both components.
        scale = np.tile(np.sqrt(of_g), hessians.shape[1] // of_g.shape[1])
        return np.asarray(noise[view.camera]**2 * hessians * (1.0 + scale[:, :, None] * scale[:, None, :]))

    covariances = team.together(lambda: model.views.map(weigh, evaluation.residuals, transfers, at))
    total, n_values = team.ordered_sum([np.array([sum(c.sum() for c in of_views), sum(c.size for c in of_views)])
                                        for of_views in transfers])
    return _sample(model, covariances, case, float(total / n_values))


def prepare_residual_forces(model: ResidualModel, evaluation: Evaluation, q: Field, noise: ForceNoise,
                            case: Case) -> NoiseForces:
    """Find the covariance of b that the residual of one camera makes, white or not, v_e M_e cell by cell; collective.

    v_e is the variance of the cell's own residual times what its forces have more than those of independent pixels.
    Cells of few pixels, which tell little of their own noise, have that of all of them.
    """
    factor = noise.excess * noise.amplification**2

    def multiply(view: FrameView, residual: Residual, q_s: Array) -> Array:
        _, squares = residual.cell_sums.sum_residual(*model.find_correction(evaluation, view.camera, residual))
        n = residual.cell_sums.n_pixels
        variances = (squares + FEW_PIXELS * noise.variance) / (n + FEW_PIXELS)
        hessians = model.show(view, q_s).correlation.compute_cell_hessians()
        return np.asarray(factor * variances[:, None, None] * hessians)

    covariances = model.team.together(lambda: model.views.map(multiply, evaluation.residuals, model.views.fill(q)))
    return _sample(model, covariances, case, noise.excess)


def _sample(model: ResidualModel, covariances: ByView[Array], case: Case, transfer: float) -> NoiseForces:
    """Right-hand sides whose covariance is given cell by cell, for each view; collective."""
    n_samples = count_samples(model.subdomains[0].mesh.dim, is_regularized=case.regularization is not None)
    places = place_cells(model.team, model.subdomains)
    n_forces = model.team.maximum(max(of_view.shape[1] for of_views in covariances for of_view in of_views))

    def prepare(view: FrameView, of_view: Array, subdomain: Subdomain, of_cells: IntArray) -> SampledCells:
        return prepare_samples(of_view, subdomain.cell_ids, of_cells, view.camera, n_samples, n_forces)

    cells = model.views.map(prepare, covariances, model.views.fill(model.subdomains), model.views.fill(places))
    return NoiseForces(model.views, cells, n_samples, transfer)


def place_cells(team: Team, subdomains: Sequence[Subdomain]) -> list[IntArray]:
    """Tell each cell's column and row of cells, (n_cells, dim), as in a regular mesh of as many cells; collective.

    The parts of a cut cell have that of the whole one: elsewhere they would meet another cell's.
    """
    # A part counts as its share of the whole cell.
    area, n_cells = team.ordered_sum([np.array([of_cells.sum() for of_cells in measure_covered_areas(s.mesh)])
                                      for s in subdomains])
    middles = [s.mesh.centroids if s.mesh.parts is None else replace(s.mesh, parts=None).centroids for s in subdomains]
    lowest = np.min([of_cells.min(axis=0) for of_cells in middles], axis=0)
    first, size = -team.maximum(-lowest), (area / n_cells) ** (1 / len(lowest))
    # The cells of a regular mesh lie in the middle of their places: rounding decides nothing.
    return [np.floor((of_cells - first) / size + 0.5).astype(np.int64) for of_cells in middles]


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


def find_image_noise(problem: WeightedProblem, model: ResidualModel, evaluation: Evaluation, q: Field) -> ImageNoise:
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
    if inputs.case.imaging.at_rest is not None:
        return ImageNoise((_measure_at_rest(problem, inputs.case.imaging.at_rest),), OF_REST)
    return ImageNoise((estimate_from_residual(model, evaluation, q, inputs.case.correlation.spline_degree),),
                      OF_RESIDUAL)


def estimate_from_residual(model: ResidualModel, evaluation: Evaluation, q: Field, degree: int) -> float:
    """Estimate the noise of one camera's images from what the field leaves of grey-level conservation; collective.

    Of every cell the mean square of f - a g - b is sigma^2 (1 + a^2 c), c the noise transfer of the spline, whose
    degree is 3 or 5; the median over cells passes over those where the field does not follow the specimen. It is a
    standard deviation, grey levels; 0 where no pixel counts.
    """
    found, table = [], build_white_transfer(degree, model.subdomains[0].mesh.dim)
    for (view, *_), (own, *_), q_s in zip(model.views, evaluation.residuals, q, strict=True):
        transfer = find_cell_transfer(table, view, q_s)[:, 0]
        gain, offset = model.find_correction(evaluation, 0, own)
        _, squares = own.cell_sums.sum_residual(gain, offset)
        n = own.cell_sums.n_pixels
        with np.errstate(invalid="ignore", divide="ignore"):
            # The median of a mean of n squares is below their expectation (Wilson and Hilferty, PNAS 17, 1931).
            variances = squares / n / (1.0 + gain**2 * transfer) / (1.0 - 2.0 / (9.0 * n)) ** 3
        found.append(variances[n > 1])
    variances = np.concatenate(found)
    ones = np.ones(len(variances))
    lower, negative_upper = (find_quantile_of_all(model.team, sign * variances, ones) for sign in (1.0, -1.0))
    # The two middle ones of an even number.
    return 0.0 if lower is None or negative_upper is None else float(np.sqrt(0.5 * (lower - negative_upper)))


def _measure_at_rest(problem: WeightedProblem, path: Path) -> float:
    """Noise of the reference image and another one of the specimen as it is there; collective."""
    team, inputs = problem.team, problem.reference.inputs
    reference = inputs.cameras[0].reference.image
    nodes = np.concatenate([s.mesh.nodes for s in problem.reference.subdomains])
    low, high = -team.maximum(-nodes.min(axis=0)), team.maximum(nodes.max(axis=0))
    window = Window.between(low.astype(int), high.astype(int)).intersection(reference.extent)
    noise = team.on_root(lambda: estimate_rest_noise(reference, hold_source(path, len(low)), window))
    if not np.isfinite(noise):
        least = " x ".join([str(BLOCKS[len(low)])] * len(low))
        raise as_collective(InputError(f"{inputs.case.imaging_name}.at_rest: {path}: the mesh covers fewer than "
                                       f"{least} px, from which no noise can be told; give noise in its place"))
    return noise
