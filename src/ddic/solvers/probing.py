"""What images determine of a field: displacement noise of camera noise, and degrees of freedom, by random signs.

The noise that camera noise leaves has the covariance 2 sigma^2 A^-1 M A^-1; the degrees of freedom that a regularized
field takes from the images are tr(A^-1 M). Random bits go by number: no rank needs those of the others. Right-hand
sides are made as noise makes them: their mean products are their covariance, without chance between neighbours.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import hadamard

from ddic.arrays import Array, BoolArray, IntArray
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.linear_step import AllowedError, LinearStep
from ddic.solvers.local_system import LocalOperator, LocalSystem

N_PROBES = 4
"""Random vectors. Their mean is off by sqrt(2 / (N_PROBES trace)) of the trace: 3 % of 500; four times as many halve
it, for four times the solves."""

_ENOUGH_FOR_TRACE = AllowedError(0.0, 0.01)
"""Share of a vector's solution that its linear step may leave: below what the random signs leave."""


def estimate_degrees_of_freedom(team: Team, systems: Sequence[LocalSystem], step: LinearStep) -> float:
    """Estimate tr(A^-1 M), no unit, by Hutchinson's random signs; collective.

    By so much do small changes of the images' grey levels appear in the field: the number of unknowns without
    regularization, fewer where mechanics rule some of them. Raises ConvergenceError on all ranks, where a linear step
    with A does not converge.
    """
    at_rest = Field.zero(team, [system.subdomain for system in systems])
    scale = _find_scale(team, systems)
    n_unknowns = team.maximum(max(int(system.subdomain.numbers.max(initial=-1)) for system in systems)) + 1
    traces = []
    for probe in range(N_PROBES):
        # The same on every rank and for every partition.
        signs = np.random.default_rng(probe).choice([-1.0, 1.0], size=n_unknowns)
        z = at_rest.with_parts(signs[subdomain.numbers] for subdomain in at_rest.subdomains)
        b = z.map(lambda subdomain, z_s: scale * z_s / subdomain.all_multiplicity)
        y = step.solve(at_rest, b, _ENOUGH_FOR_TRACE).dq / scale
        traces.append(z.multiply(multiply_by_hessians(systems, y)))
    return float(np.mean(traces))


def _find_scale(team: Team, systems: Sequence[LocalSystem]) -> float:
    """What makes solutions about a pixel: steps judge by that how exact they are, and start from their last one."""
    (scale,) = team.ordered_sum([np.array([system.hessian.diagonal().max(initial=0.0)]) for system in systems])
    return float(scale)


def multiply_by_hessians(systems: Sequence[LocalSystem], y: Field) -> Field:
    """Multiply each subdomain's part of a field by its own M: M_s y_s."""
    return y.with_parts(system.hessian @ y_s for system, y_s in zip(systems, y, strict=True))


def generate_bits(numbers: IntArray, stream: int) -> Array:
    """Generate a random bit, 0 or 1, for each number, by the mixing of splitmix64.

    ``numbers``, of any shape, say what has a bit, the same on all ranks; each ``stream`` has independent bits.
    """
    x = numbers.astype(np.uint64) + np.uint64((stream + 1) * 0x9E3779B97F4A7C15 % 2**64)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
    return ((x ^ (x >> np.uint64(31))) & np.uint64(1)).astype(np.float64)


_PROBES = 64
"""Random vectors: about 1 % of error for a thousand displacements; twice as many halve its square, for
twice the time."""

_SIGNS_BY_STEPS = 20_000
"""Random signs where each vector of them takes a linear step of the whole problem: a few per cent of error, which the
order of the noise needs not. A larger value takes more vectors, of which large problems need one."""

_MOST_BY_STEPS = 4
"""Vectors that small problems take at most."""

_ENOUGH = AllowedError(0.0, 0.1)
"""Share of a vector's solution that its linear step may leave: 0.02 changed the noise by 0.2 % on 3000 x 3000 pixels,
with twice the iterations."""


def estimate_noise_rms(system: LocalSystem, operator: LocalOperator, sigma: float, components: BoolArray) -> float:
    """Estimate the displacement noise of white camera noise, by the trace of T A^-1 M A^-1 T^T with random signs.

    The RMS, pixels, is over the ``components`` of the nodes' displacements, (mesh.n_dofs,), node by node, that count;
    ``sigma`` is the standard deviation of the camera noise of both images, grey levels. ``system`` is that of the whole
    region as one domain.
    """
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(components), _PROBES)) * components[:, None]
    tangent = system.subdomain.kinematics.tangent
    y = operator.solve_many(tangent.T @ signs)
    trace = (y * (system.hessian @ y)).sum() / _PROBES
    return float(sigma * np.sqrt(2.0 * trace / components.sum()))


@dataclass(frozen=True)
class NoiseResponse:
    """How a field answers white noise of the images.

    Attributes
    ----------
    rms_per_grey : float
        RMS of a component at a node, pixels, for noise of both images of one grey level.
    n_determined : float
        tr(A^-1 M): how many unknowns the images determine.
    """

    rms_per_grey: float
    n_determined: float


def estimate_response(team: Team, systems: Sequence[LocalSystem], step: LinearStep,
                      counted: Sequence[BoolArray] | None = None) -> NoiseResponse:
    """Estimate the same over all nodes of a problem in subdomains, by linear steps of any kind; collective.

    ``counted`` says which nodes of each owned subdomain, (n_nodes,), count; all of them by default. Every node is
    counted once; with several cameras the noise is that of the first one. Raises ConvergenceError on all ranks, where a
    linear step with A does not converge.
    """
    subdomains = [system.subdomain for system in systems]
    at_rest = Field.zero(team, subdomains)
    if counted is None:
        counted = [np.ones(subdomain.mesh.n_nodes, dtype=bool) for subdomain in subdomains]
    chosen = [of_nodes.astype(np.float64) for of_nodes in counted]
    # Of nodes, a share in each subdomain that has them.
    shares = [of_nodes / s.node_multiplicity for s, of_nodes in zip(subdomains, chosen, strict=True)]
    scale = _find_scale(team, systems)
    (n_components,) = team.ordered_sum([np.array([s.mesh.dim * share.sum()])
                                        for s, share in zip(subdomains, shares, strict=True)])
    n_components = max(n_components, 1.0)
    traces = []
    for probe in range(int(np.clip(_SIGNS_BY_STEPS // n_components, 1, _MOST_BY_STEPS))):
        b = at_rest.with_parts(scale * _project_signs(s, share, probe)
                               for s, share in zip(subdomains, shares, strict=True))
        y = step.solve(at_rest, b, _ENOUGH).dq / scale
        forces = multiply_by_hessians(systems, y)
        z = [_project_signs(s, of_nodes, probe) for s, of_nodes in zip(subdomains, chosen, strict=True)]
        products = [np.array([y_s @ of_y, z_s @ of_y]) for y_s, z_s, of_y in zip(y, z, forces, strict=True)]
        traces.append(team.ordered_sum(products))
    of_covariance, of_determined = np.mean(traces, axis=0)
    return NoiseResponse(float(np.sqrt(2.0 * of_covariance / n_components)), float(of_determined))


def estimate_deviation(team: Team, systems: Sequence[LocalSystem], step: LinearStep, loads: Sequence[Array]) -> float:
    """Estimate the standard deviation of a linear combination of all nodes' displacements; collective.

    By white noise of both images of one grey level. ``loads`` are the factors of the displacements of each owned
    subdomain, (n_nodes, dim); copies of a node add up. Raises ConvergenceError on all ranks, where a linear step with A
    does not converge.
    """
    at_rest = Field.zero(team, [system.subdomain for system in systems])
    scale = _find_scale(team, systems)
    b = at_rest.with_parts(scale * _take_to_unknowns(system.subdomain, of_nodes.ravel())
                           for system, of_nodes in zip(systems, loads, strict=True))
    y = step.solve(at_rest, b, _ENOUGH).dq / scale
    return float(np.sqrt(2.0 * y.multiply(multiply_by_hessians(systems, y))))


def _project_signs(subdomain: Subdomain, shares: Array, probe: int) -> Array:
    """A subdomain's part of T^T z, z of random signs that are the same whatever the partition, (n_unknowns,)."""
    dim = subdomain.mesh.dim
    components = (subdomain.node_ids[:, None] * dim + np.arange(dim)).ravel()
    signs = 1.0 - 2.0 * generate_bits(components, probe)
    return _take_to_unknowns(subdomain, signs * np.repeat(shares, dim))


def _take_to_unknowns(subdomain: Subdomain, loads: Array) -> Array:
    """Factors of the nodes' displacements, (mesh.n_dofs,), as those of the unknowns, (n_unknowns,)."""
    b = np.zeros(subdomain.n_unknowns)
    b[:subdomain.n_field] = subdomain.kinematics.tangent.T @ loads
    return b


MOST_SAMPLES, FEWEST_SAMPLES = 256, 128
"""Right-hand sides, powers of 2, with regularization and without, where a node depends on few cells. On elements of
16 px the first leave errors of 0.3, 2 and 5 % of a standard deviation with cut-off wavelengths of 4, 7 and 16 elements,
the second 0.4 % without (1.3 % of a strain's). Twice as many take twice the time."""

_SEQUENCES = hadamard(MOST_SAMPLES).astype(np.float64)
"""Signs by sample and sequence, of which any two are orthogonal; the first half of both by themselves, too."""

_SHIFTS = {32: (1, 7), 16: (1, 6), 21: (1, 3, 8), 10: (1, 2, 4)}
"""Places by which tiles are shifted from cell to cell along each axis, by their number: those alike of 32 are at least
5.7 cells apart, of 16 at least 3.6; in space, of 21 at least 3, of 10 (Hex8) at least 2.2, which parts the cells around
a node."""


_QUARTERS = np.array([0, 2, 1, 3])
"""Quarters of the tiles by which cells in one place are told apart: parts of cut cells have the whole one's place."""


def count_samples(dim: int, *, is_regularized: bool) -> int:
    """Count the right-hand sides: many in a volume, where fewer would have cells around one node share signs."""
    return MOST_SAMPLES if is_regularized or dim == 3 else FEWEST_SAMPLES


@dataclass(frozen=True, eq=False)
class SampledCells:
    """What makes forces with a given covariance on the cells of a view.

    Attributes
    ----------
    factors : (n_cells, n, n) array
        L of each cell with L L^T = cov(b of the cell), grey levels squared per pixel.
    rows : (n_cells, n) array of int64
        Which sequence of signs each column takes.
    signs : (n_cells, n) array
        1 or -1 by chance, by which it is multiplied.
    """

    factors: Array
    rows: IntArray
    signs: Array

    def generate_forces(self, sample: int) -> Array:
        """Generate the forces on the nodes of each cell, (n_cells, n), node-major, grey levels squared per pixel.

        Samples count from 0; over all of them the mean of products is the covariance.
        """
        signs = self.signs * _SEQUENCES[sample][self.rows]
        return np.asarray(np.einsum("eij,ej->ei", self.factors, signs))


def prepare_samples(covariances: Array, cell_ids: IntArray, places: IntArray,
                    camera: int, n_samples: int, n_forces: int) -> SampledCells:
    """Prepare forces with a covariance that is independent from cell to cell, the same whatever the partition.

    Each column of a cell's factor takes a sequence of +1 and -1 over the samples. Sequences of Walsh are orthogonal, so
    that the mean of products over all samples is exact for cells that have different ones: near cells have. Those that
    have the same, far apart, are multiplied by signs by chance, which leaves an error of the kind that independent
    samples have.

    ``covariances`` are (n_cells, n, n), ``cell_ids`` the cells' numbers in the whole mesh, ``places`` their columns and
    rows, counted in cells, (n_cells, dim), ``camera`` its number, for the noise of each is its own, ``n_samples`` as
    ``count_samples`` counts them, ``n_forces`` the largest n of all cells of the mesh.
    """
    values, vectors = np.linalg.eigh(covariances)
    # Rounding may leave eigenvalues of nothing below zero.
    factors = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    # Cells of other tiles have signs that have nothing to do with each other.
    n_tiles = n_samples // n_forces
    tiles = places @ _SHIFTS[n_tiles] + camera
    # Those next to each other in an irregular mesh go where no near one is.
    tiles = (tiles + n_tiles // 4 * _QUARTERS[_number_within_places(places) % len(_QUARTERS)]) % n_tiles
    columns = np.arange(covariances.shape[1])
    rows = tiles[:, None] * n_forces + columns
    numbers = cell_ids[:, None] * n_forces + columns
    return SampledCells(factors, rows, 1.0 - 2.0 * generate_bits(numbers, camera))


def _number_within_places(places: IntArray) -> IntArray:
    """Number of each cell among those with the same place, 0 for the first, (n_cells,)."""
    order = np.lexsort((np.arange(len(places)), *places.T))
    begins = np.append(True, (np.diff(places[order], axis=0) != 0).any(axis=1))
    first = np.maximum.accumulate(np.where(begins, np.arange(len(places)), 0))
    numbers = np.empty(len(places), dtype=np.int64)
    numbers[order] = np.arange(len(places)) - first
    return numbers
