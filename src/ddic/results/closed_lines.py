"""Lines that do not open: where the sides of a discontinuity stay together as far as noise tells, the user is told."""

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.errors import ConvergenceError, is_collective
from ddic.mesh.mesh import pad_cells
from ddic.mesh.plane import measure_distance
from ddic.partition.subdomain import Subdomain
from ddic.problem.region_mesh import list_discontinuities
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.measurement import Measurement
from ddic.solvers.probing import estimate_deviation, generate_bits
from ddic.visibility.noise_forces import estimate_from_residual

SURELY_OPEN = 0.5
"""Pixels by which a line opens whatever the noise: how large that is takes linear steps, which are saved."""

CLOSED = 4.0
"""Standard deviations up to which an opening is no more than noise: chance exceeds 3 somewhere along many lines."""

MOST_PLACES = 5
"""Places whose own standard deviation is looked at, the farthest open first: thin parts have ten times the others'."""


def describe_closed_lines(problem: WeightedProblem, measurement: Measurement) -> tuple[str, ...]:
    """Say which discontinuities open nowhere by more than noise makes; collective."""
    lines = list_discontinuities(measurement.inputs.case).lines
    notes = []
    for number in range(len(lines)):
        found = [_find_jumps(subdomain, lines, number) for subdomain in measurement.subdomains]
        try:
            told = _describe_closed(problem, measurement, found)
        except ConvergenceError as error:
            # What was measured stands without it; what this rank alone raises must end the job.
            if not is_collective(error):
                raise
            told = ""
        if told:
            notes.append(f"discontinuity, entry {number + 1}: {told}")
    return tuple(notes)


_Jumps = tuple[sparse.csr_matrix, IntArray]
"""From a subdomain's displacements to how far the sides are from each other in the middle of cells, (n, n_nodes); and
the numbers of the cells, (n,), in the whole mesh."""


def _find_jumps(subdomain: Subdomain, lines: Sequence[Array], number: int) -> _Jumps:
    """Of the cells that are cut in two and lie nearest to one of the lines."""
    mesh = subdomain.mesh
    parts = np.zeros(0, np.int64) if mesh.parts is None else mesh.parts.cells
    nodes = pad_cells(mesh)[parts]
    # Both parts of a cell have nodes at the same places, in the same order.
    middles, whole, n_parts = np.unique(mesh.nodes[nodes].mean(axis=1), axis=0, return_inverse=True, return_counts=True)
    nearest = np.argmin([measure_distance(middles, line) for line in lines], axis=0)
    order = np.argsort(whole, kind="stable")
    pairs = order[((n_parts == 2) & (nearest == number))[whole[order]]].reshape(-1, 2)
    values = np.tile(np.repeat([0.25, -0.25], 4), len(pairs))
    rows = np.repeat(np.arange(len(pairs)), 8)
    matrix = sparse.csr_matrix((values, (rows, nodes[pairs].ravel())), shape=(len(pairs), mesh.n_nodes))
    return matrix, subdomain.cell_ids[parts][pairs].min(axis=1)


def _describe_closed(problem: WeightedProblem, measurement: Measurement, found: Sequence[_Jumps]) -> str:
    """Say that a line does not open beyond noise, with its largest opening; empty where it does; collective."""
    mine = [(cells, matrix @ u.reshape(-1, 2))
            for (matrix, cells), u in zip(found, measurement.displacements, strict=True)]
    numbers, jumps = (np.concatenate(of_all) for of_all in zip(*measurement.team.gather_lists(mine), strict=True))
    jumps, numbers = np.nan_to_num(jumps[np.argsort(numbers)]), np.sort(numbers)
    lengths = np.linalg.norm(jumps, axis=1)
    farthest = np.argsort(-lengths, kind="stable")[:MOST_PLACES]
    if not len(lengths) or lengths[farthest[0]] > SURELY_OPEN:
        return ""
    response = _estimate_response(problem, found, numbers, 1.0 - 2.0 * generate_bits(2 * numbers[:, None] + [0, 1], 0))
    if response == 0:
        return ("its line cannot open: the elements that it cuts have too few pixels beside it; use larger elements, "
                "or move the mesh by half of one")
    sigma = problem.noise[0] if problem.noise else estimate_from_residual(
        measurement.model, measurement.evaluation, measurement.q, measurement.inputs.case.correlation.spline_degree)
    deviations: list[float] = []
    for place in farthest:
        if deviations and lengths[place] <= CLOSED * sigma * response / np.sqrt(len(numbers)):
            break
        along = np.zeros(jumps.shape)
        along[place] = jumps[place] / (lengths[place] or 1.0)
        deviations.append(sigma * _estimate_response(problem, found, numbers, along))
        if lengths[place] > CLOSED * deviations[-1]:
            return ""
    return (f"its line does not open beyond noise: the sides part by {lengths[farthest[0]]:.2g} px at most, where "
            f"noise makes a standard deviation of {deviations[0]:.1g} px; leave the section out, which costs noise "
            "only, or look at the line's place")


def _estimate_response(problem: WeightedProblem, found: Sequence[_Jumps], numbers: IntArray, factors: Array) -> float:
    """Standard deviation of a sum of jumps by noise of a grey level; factors, (n, 2), are those of all cells."""
    loads = [matrix.T @ factors[np.searchsorted(numbers, cells)] for matrix, cells in found]
    return estimate_deviation(problem.team, problem.solver.assembly.systems, problem.solver.step, loads)
