"""Lines that do not open: where the sides of a discontinuity stay together as far as noise tells, the user is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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

TINY = 1e-300
"""A length below any that is not 0."""

MOST_PLACES = 5
"""Places whose own standard deviation is looked at, the farthest open first: thin parts have ten times the others'."""


def describe_closed_lines(problem: WeightedProblem, measurement: Measurement) -> tuple[str, ...]:
    """Say which discontinuities open nowhere by more than noise makes; collective."""
    lines = list_discontinuities(measurement.inputs.case).lines
    notes = []
    for number in range(len(lines)):
        cuts = [_find_cuts(subdomain, lines, number) for subdomain in measurement.subdomains]
        try:
            told = _describe_closed(problem, measurement, cuts)
        except ConvergenceError as error:
            # What was measured stands without it; what this rank alone raises must end the job.
            if not is_collective(error):
                raise
            told = ""
        if told:
            notes.append(f"discontinuity, entry {number + 1}: {told}")
    return tuple(notes)


@dataclass(frozen=True, eq=False)
class _Cuts:
    """Nodes of the two parts of the cells that a line cuts, (n, 4) each, and numbers of the cells, (n,)."""

    left: IntArray
    right: IntArray
    numbers: IntArray

    def measure_jumps(self, displacement: Array) -> Array:
        """How far the parts are from each other in the middle of each cell, (n, 2), pixels."""
        u = displacement.reshape(-1, 2)
        return np.asarray((u[self.left] - u[self.right]).mean(axis=1))

    def load(self, n_nodes: int, factors: Array) -> Array:
        """Factors of the nodes' displacements, (n_nodes, 2), in a sum of jumps with factors, (n, 2)."""
        loads = np.zeros((n_nodes, 2))
        np.add.at(loads, self.left, factors[:, None] / 4)
        np.subtract.at(loads, self.right, factors[:, None] / 4)
        return loads


def _find_cuts(subdomain: Subdomain, lines: Sequence[Array], number: int) -> _Cuts:
    """The cells that are cut in two and lie nearest to one of the lines."""
    mesh = subdomain.mesh
    parts = np.zeros(0, np.int64) if mesh.parts is None else mesh.parts.cells
    nodes = pad_cells(mesh)[parts]
    # Both parts of a cell have nodes at the same places, in the same order.
    middles, whole, n_parts = np.unique(mesh.nodes[nodes].mean(axis=1), axis=0, return_inverse=True,
                                        return_counts=True)
    nearest = np.argmin([measure_distance(middles, line) for line in lines], axis=0)
    chosen = (n_parts == 2) & (nearest == number)
    order = np.argsort(whole, kind="stable")
    left, right = order[chosen[whole[order]]].reshape(-1, 2).T
    ids = subdomain.cell_ids[parts]
    return _Cuts(nodes[left], nodes[right], np.minimum(ids[left], ids[right]))


def _describe_closed(problem: WeightedProblem, measurement: Measurement, cuts: Sequence[_Cuts]) -> str:
    """Say that a line does not open beyond noise, with its largest opening; empty where it does; collective."""
    mine = [(cut.numbers, cut.measure_jumps(u)) for cut, u in zip(cuts, measurement.displacements, strict=True)]
    numbers, jumps = (np.concatenate(of_all) for of_all in zip(*measurement.team.gather_lists(mine), strict=True))
    jumps, numbers = np.nan_to_num(jumps[np.argsort(numbers)]), np.sort(numbers)
    lengths = np.linalg.norm(jumps, axis=1)
    farthest = np.argsort(-lengths, kind="stable")[:MOST_PLACES]
    if not len(lengths) or lengths[farthest[0]] > SURELY_OPEN:
        return ""
    response = _estimate_response(problem, cuts, numbers, 1.0 - 2.0 * generate_bits(2 * numbers[:, None] + [0, 1], 0))
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
        along[place] = jumps[place] / max(lengths[place], TINY)
        deviations.append(sigma * _estimate_response(problem, cuts, numbers, along))
        if lengths[place] > CLOSED * deviations[-1]:
            return ""
    return (f"its line does not open beyond noise: the sides part by {lengths[farthest[0]]:.2g} px at most, where "
            f"noise makes a standard deviation of {deviations[0]:.1g} px; leave the section out, which costs noise "
            "only, or look at the line's place")


def _estimate_response(problem: WeightedProblem, cuts: Sequence[_Cuts], numbers: IntArray, factors: Array) -> float:
    """Standard deviation of a sum of jumps by noise of a grey level; factors, (n, 2), are those of all cells."""
    loads = [cut.load(subdomain.mesh.n_nodes, factors[np.searchsorted(numbers, cut.numbers)])
             for cut, subdomain in zip(cuts, problem.reference.subdomains, strict=True)]
    return estimate_deviation(problem.team, problem.solver.assembly.systems, problem.solver.step, loads)
