"""Standard deviations that noise of the images leaves in a field, and what regularization takes from it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.fracture.opening import Places, find_places
from ddic.kinematics.strain import compute_displacement_gradients, compute_infinitesimal
from ddic.mesh.interpolation import weigh_nodes_at
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.region_mesh import list_discontinuities
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.fields import draw_mesh, recover_nodal_gradients
from ddic.solvers.linear_step import AllowedError, LinearStep
from ddic.solvers.probing import estimate_response
from ddic.visibility.noise_forces import (
    OF_RESIDUAL,
    ForceNoise,
    ImageNoise,
    NoiseForces,
    find_image_noise,
    measure_force_noise,
    prepare_noise_forces,
    prepare_residual_forces,
)

ENOUGH = AllowedError(0.0, 0.1)
"""Share of each displacement that an iterative linear step may leave. With a cut-off wavelength of 7 elements it leaves
up to 6 % of a standard deviation at a few nodes, half of it up to 2 %; a larger share iterates less."""

N_TERMS = 8
"""Solutions for the bias of regularization: what is smoothed to a share h comes out as h - h^(N_TERMS + 1). More of
them amplify the noise of waves shorter than l_c."""

TINY = 1e-6
"""A noise, grey levels, below any that images have: those without noise are divided by it."""


@dataclass(frozen=True, eq=False)
class FieldDeviations:
    """Standard deviations on the nodes and cells of a subdomain.

    Attributes
    ----------
    displacement : (n_nodes, dim) array
        Of u, v and perhaps w, pixels.
    nodal_strain : (n_nodes, n_components) array
        Of the infinitesimal strain at nodes, components as ``Strain`` has them, no unit.
    cell_strain : (n_cells, n_components) array
        Of that in the middle of cells.
    opening : (n_places, 2) array
        Of the tangential and the normal opening at places along discontinuities, pixels.
    """

    displacement: Array
    nodal_strain: Array
    cell_strain: Array
    opening: Array


@dataclass(frozen=True, eq=False)
class FieldUncertainty:
    """What noise and regularization do to a field.

    Attributes
    ----------
    noise : ImageNoise
        Of the images.
    rms : float
        Of the displacements' standard deviations, over components and nodes, pixels.
    n_samples : int
        Right-hand sides from which they were found.
    transfer : float
        Mean share of the deformed image's noise that reaches b through the spline, no unit.
    deviations : list of FieldDeviations
        Of each owned subdomain.
    bias : list of (n_nodes, dim) array or None
        Estimated displacement less the true one, as far as regularization makes the difference, pixels; None without.
    force_noise : ForceNoise or None
        How strongly the residual acts on displacements, where it tells the noise; None where the noise is given.
    opening_deviations : dict of (n,) arrays
        Standard deviations of openings along all discontinuities, columns by name; empty without any.
    """

    noise: ImageNoise
    rms: float
    n_samples: int
    transfer: float
    deviations: list[FieldDeviations]
    bias: list[Array] | None
    force_noise: ForceNoise | None = None
    opening_deviations: Mapping[str, Array] = field(default_factory=dict)


Watch = Callable[[list[Array]], None]
"""Is told, collectively, what a sample of the noise does to the nodes of owned subdomains, (n_nodes, dim), pixels."""


def estimate_field_uncertainty(problem: WeightedProblem, model: ResidualModel, evaluation: Evaluation,
                               q: Field, unmeasured: Sequence[BoolArray],
                               watch: Watch = lambda displacements: None) -> FieldUncertainty:
    """Estimate what noise and regularization do to a measured field; collective.

    ``problem`` has the operators that found the field, ``model`` the pixels that count. ``unmeasured`` are the nodes of
    each owned subdomain that nothing holds: they have nan. ``watch`` is told of every sample. Raises ConvergenceError
    on all ranks where a linear step does not converge.
    """
    team, subdomains, step = problem.team, problem.reference.subdomains, problem.solver.step
    case, is_regularized = problem.reference.inputs.case, problem.solver.assembly.eta > 0
    noise = find_image_noise(problem, model, evaluation, q)
    bias = _solve_for_bias(model, subdomains, step, q) if is_regularized else None
    of_forces: ForceNoise | None = None
    if problem.noise or noise.origin != OF_RESIDUAL:
        forces = prepare_noise_forces(model, evaluation, q, noise.sigma, case)
    else:
        response = estimate_response(team, problem.solver.assembly.systems, step, [~nodes for nodes in unmeasured])
        of_forces = measure_force_noise(model, evaluation, q, response.n_determined,
                                        is_regularized=is_regularized, bias=bias)
        forces = prepare_residual_forces(model, evaluation, q, of_forces, case)
    # Solutions of about a pixel, as steps expect.
    scale = float(np.sqrt(problem.solver.assembly.mean_diagonal)) / max(noise.sigma[0], TINY)
    lines = list_discontinuities(case).lines
    openings = team.together(lambda: [find_openings(subdomain, lines) for subdomain in subdomains])
    deviations = estimate_deviations(team, subdomains, step, forces, scale, unmeasured, openings, watch)
    along = gather_deviations(team, openings, [of.opening for of in deviations]) if lines else {}
    rms = _measure_rms(team, subdomains, deviations)
    at_nodes = None if bias is None else find_node_displacements(team, subdomains, bias, unmeasured)
    return FieldUncertainty(noise, rms, forces.n_samples, forces.transfer, deviations, at_nodes, of_forces, along)


def describe_uncertainty(uncertainty: FieldUncertainty) -> tuple[str, ...]:
    """Say in a line how large the noise of the images and of the field is."""
    noise, of_forces = uncertainty.noise, uncertainty.force_noise
    strength = "" if of_forces is None else f", acting {of_forces.excess:.2f} times as strongly as if it were white"
    return (f"uncertainty: noise of {noise.sigma[0]:.2f} grey levels ({noise.origin}{strength}) leaves a standard "
            f"deviation of {uncertainty.rms:.2g} px in each component (RMS over nodes)",)


def list_uncertainty(uncertainty: FieldUncertainty) -> dict[str, Any]:
    """List what the standard deviations were found from, and how large they are: attributes of the result file."""
    noise, of_forces = uncertainty.noise, uncertainty.force_noise
    told = {"noise_grey": noise.sigma[0], "noise_origin": noise.origin, "noise_transfer": uncertainty.transfer,
            "displacement_rms_px": uncertainty.rms, "n_samples": uncertainty.n_samples}
    if of_forces is None:
        return told
    return {**told, "force_excess": of_forces.excess, "texture_share": of_forces.texture}


@dataclass(frozen=True, eq=False)
class SubdomainOpenings:
    """Openings in a subdomain, as linear maps of its nodes' displacements, of whose samples the squares are averaged.

    Displacements of the two sides go together, and so do those of a cell's nodes: what is known of each node by itself
    does not tell how far sides part.

    Attributes
    ----------
    places : list of Places
        Of each line.
    matrices : list of (n_places, n_nodes) csr_matrix
        From displacements to those of the left side less those of the right one.
    """

    places: list[Places]
    matrices: list[sparse.csr_matrix]

    @property
    def lines(self) -> IntArray:
        """Line of each place, numbered from 1, (n,)."""
        return np.repeat(np.arange(len(self.places)) + 1, [len(of_line.distance) for of_line in self.places])

    @property
    def distances(self) -> Array:
        """Distance of each place along its line, (n,), pixels."""
        return np.concatenate([np.zeros(0), *(of_line.distance for of_line in self.places)])

    def measure(self, u: Array) -> Array:
        """Tangential and normal openings, (n, 2), of displacements of nodes, (n_nodes, 2)."""
        found = [np.column_stack(of_line.find_components(matrix @ u))
                 for of_line, matrix in zip(self.places, self.matrices, strict=True)]
        return np.concatenate([np.zeros((0, 2)), *found])


def find_openings(subdomain: Subdomain, lines: Sequence[Array]) -> SubdomainOpenings:
    """Find the openings of lines in a subdomain, as they are read from the mesh of the result."""
    if not lines:
        return SubdomainOpenings([], [])
    drawn, places, matrices = draw_mesh(subdomain, subdomain.mesh.n_nodes), [], []
    for line in lines:
        of_line = find_places(drawn.mesh, line)
        left, right = (weigh_nodes_at(drawn.mesh, cells, side)
                       for cells, side in zip(of_line.cells, of_line.sides, strict=True))
        places.append(of_line)
        matrices.append(drawn.project_factors(left - right))
    return SubdomainOpenings(places, matrices)


def estimate_deviations(team: Team, subdomains: Sequence[Subdomain], step: LinearStep, forces: NoiseForces,
                        scale: float, unmeasured: Sequence[BoolArray],
                        openings: Sequence[SubdomainOpenings],
                        watch: Watch = lambda displacements: None) -> list[FieldDeviations]:
    """Estimate the square roots of the diagonal of A^-1 cov(b) A^-1, and of strains and openings; collective.

    Each right-hand side takes a linear step, of whatever kind; ``scale`` is what b is multiplied by before.
    ``unmeasured`` are the nodes of each subdomain that nothing holds: they have nan, and cells about them are as good
    as not there.
    """
    dim = subdomains[0].mesh.dim
    n_components = dim * (dim + 1) // 2
    squares = [(np.zeros((s.mesh.n_nodes, dim)), np.zeros((s.mesh.n_nodes, n_components)),
                np.zeros((s.mesh.n_cells, n_components)), np.zeros((len(of.lines), 2)))
               for s, of in zip(subdomains, openings, strict=True)]
    at_rest = Field.zero(team, subdomains)
    for sample in range(forces.n_samples):
        b = at_rest.with_parts(scale * b_s for b_s in forces.generate(sample))
        displacements = find_node_displacements(team, subdomains, step.solve(at_rest, b, ENOUGH).dq, unmeasured)
        watch([u / scale for u in displacements])
        at_nodes = recover_nodal_gradients(team, subdomains, [u.ravel() for u in displacements])
        for subdomain, opening, of_subdomain, u, gradient in zip(subdomains, openings, squares, displacements, at_nodes,
                                                                 strict=True):
            in_cells = compute_displacement_gradients(subdomain.mesh, u.ravel())
            found = (u, compute_infinitesimal(gradient), compute_infinitesimal(in_cells), opening.measure(u))
            for total, values in zip(of_subdomain, found, strict=True):
                np.add(total, values**2, out=total)
    return [FieldDeviations(*(np.sqrt(total / forces.n_samples) / scale for total in of_subdomain))
            for of_subdomain in squares]


def _solve_for_bias(model: ResidualModel, subdomains: Sequence[Subdomain], step: LinearStep, q: Field) -> Field:
    """Estimate what regularization has added to a field; collective.

    Of a true field q the images of no noise tell A^-1 M q, which is off by -H q, H = A^-1 eta Kbar^T Kbar. The measured
    field, less the bias as far as it is known, stands in for the true one: N_TERMS terms of -(H + H^2 + ...) times the
    measured field. ``model`` says how far the region has turned. Returns the estimated field less the true one, pixels.
    """
    nothing = Field.zero(model.team, subdomains)
    bias = nothing
    for _ in range(N_TERMS):
        less_bias = q - bias
        b = nothing if model.rotation is None else q.with_parts(model.rotation.compute_forces(less_bias))
        bias = step.solve(less_bias, b).dq
    return bias


def _measure_rms(team: Team, subdomains: Sequence[Subdomain], deviations: Sequence[FieldDeviations]) -> float:
    """RMS over components and nodes, each node counted once; collective."""
    sums = []
    for subdomain, of_subdomain in zip(subdomains, deviations, strict=True):
        is_measured = np.isfinite(of_subdomain.displacement).all(axis=1)
        shares = 1.0 / subdomain.node_multiplicity[is_measured]
        squares = (of_subdomain.displacement[is_measured] ** 2).mean(axis=1)
        sums.append(np.array([shares @ squares, shares.sum()]))
    total, n_nodes = team.ordered_sum(sums)
    return float(np.sqrt(total / max(n_nodes, 1.0)))


def find_node_displacements(team: Team, subdomains: Sequence[Subdomain], q: Sequence[Array],
                            unmeasured: Sequence[BoolArray]) -> list[Array]:
    """Displace each subdomain's nodes by the mean of copies, nan where unmeasured, (n_nodes, dim); collective."""
    shares = [(s.kinematics.tangent @ q_s[:s.n_field]).reshape(-1, s.mesh.dim) / s.node_multiplicity[:, None]
              for s, q_s in zip(subdomains, q, strict=True)]
    displacements = sum_shared_nodes(team, subdomains, shares)
    for u, is_unmeasured in zip(displacements, unmeasured, strict=True):
        u[is_unmeasured] = np.nan
    return displacements


def gather_deviations(team: Team, openings: Sequence[SubdomainOpenings],
                      deviations: Sequence[Array]) -> dict[str, Array]:
    """Gather the standard deviations, (n, 2) of each subdomain, to a table: columns by name; collective."""
    mine = [(of.lines, of.distances, sigma) for of, sigma in zip(openings, deviations, strict=True)]
    lines, distances, sigmas = (np.concatenate(of_all) for of_all in zip(*team.gather_lists(mine), strict=True))
    order = np.lexsort((distances, lines))
    return {"line": lines[order], "distance_px": distances[order], "sigma_tangential_px": sigmas[order, 0],
            "sigma_normal_px": sigmas[order, 1]}
