"""A series as few fields of space times functions of time, the prospect of [PP12]: u(x, t) = sum_i lambda_i(t) u_i(x).

All frames are measured together. Given the lambda_i, the u_i are one linear step each; given the u_i, the lambda_i(t)
are one small system a frame:

    sum_j (sum_st W_st lambda_is lambda_jt) A du_j = sum_st W_st lambda_is r_t,
    sum_j (u_i . A u_j) dlambda_jt = u_i . r_t,

with A = M + eta Kbar^T Kbar and r_t = b_t - eta Kbar^T Kbar u_t. W is the inverse of I + 1 1^T: the noise of the
reference image is in the difference of every frame, and must not pass for a field that all of them share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.errors import ConvergenceError, as_collective
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.field import Field
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.measurement import Measurement
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.probing import estimate_response, multiply_by_hessians
from ddic.solvers.whole_system import EquilibriumRows
from ddic.visibility.noise_forces import measure_force_noise

MARGIN = 1.1
"""Singular value, over the largest that noise is expected to have, from which on a mode is one. A larger value finds
fewer modes, a smaller one takes noise for some."""

SETTLED = 1e-3
"""Change of the fields, RMS over nodes and frames, at which the iteration ends, pixels: that of a pair's."""

MOST_SWEEPS = 20
"""Passes over all frames."""


@dataclass(frozen=True, eq=False)
class TimeModes:
    """Fields of a series and how each frame is made of them.

    Attributes
    ----------
    fields : list of Field
        u_i, pixels; the largest of a component at a node is 1.
    amplitudes : (n_frames, n_modes) array
        lambda_i(t), no unit.
    times : (n_frames,) array
        Of the frames, in the case's unit.
    strengths : (n_frames,) array
        Singular values of what the frames say one by one, over the largest that noise is expected to have.
    n_sweeps : int
        Passes over all frames that were needed.
    """

    fields: list[Field]
    amplitudes: Array
    times: Array
    strengths: Array
    n_sweeps: int

    @property
    def table(self) -> Mapping[str, Any]:
        """Columns by name, a row a frame."""
        numbers = range(1, len(self.fields) + 1)
        return {"frame": np.arange(1, len(self.times) + 1), "time": self.times,
                **{f"amplitude_{number}": self.amplitudes[:, number - 1] for number in numbers}}

    def describe(self) -> tuple[str, ...]:
        """Say how many there are, how clearly they stand out, and what storing them saves."""
        n_modes, n_frames = len(self.fields), len(self.times)
        strengths = ", ".join(f"{strength:.3g}" for strength in self.strengths[:n_modes + 1])
        return (f"modes: {n_modes} of {n_frames} frames, {self.n_sweeps} passes; strengths {strengths} times that of "
                f"noise, {n_frames / max(n_modes, 1):.3g} times less to store",)


def find_modes(problem: WeightedProblem, measurements: Sequence[Measurement], times: Sequence[float],
               n_modes: int | None = None) -> Measurement:
    """Separate the frames of a series that were measured one by one, and measure them together; collective.

    Returns the measurement of the last frame with the modes. ``n_modes`` is found from the noise by default. Raises
    ConvergenceError on all ranks, where no mode stands out from noise, or the fields do not settle.
    """
    team, systems, n_frames = problem.team, problem.solver.assembly.systems, len(measurements)
    fields = [measured.q for measured in measurements]
    root = _weigh_frames(n_frames, 0.5)
    products = _multiply(fields, [multiply_by_hessians(systems, q) for q in fields])
    values, vectors = np.linalg.eigh(root @ (products + _multiply_gaps(team, systems, fields)) @ root)
    strengths = np.sqrt(np.maximum(values[::-1], 0.0)) / _expect_noise(problem, measurements)
    rank = int((strengths > MARGIN).sum()) if n_modes is None else n_modes
    if rank == 0:
        raise as_collective(ConvergenceError(
            f"modes: no mode stands out from noise (the strongest is {strengths[0]:.2g} times as strong, at least "
            f"{MARGIN:g} times are needed); nothing moves, or say how many modes there are"))
    chosen = vectors[:, ::-1][:, :rank]
    begin = _combine(fields, root @ chosen)
    modes = TimeModes(begin, _weigh_frames(n_frames, -0.5) @ chosen, np.array(times), strengths, 0)
    last = measurements[-1]
    modes = _scale(_measure_together(problem, measurements, modes), last.unmeasured)
    return replace(last, modes=modes, notes=(*last.notes, *modes.describe()))


def _measure_together(problem: WeightedProblem, measurements: Sequence[Measurement], modes: TimeModes) -> TimeModes:
    """Iterate on the images of all frames until the fields settle; collective."""
    weights, systems = _weigh_frames(len(measurements), 1.0), problem.solver.assembly.systems
    fields, amplitudes = modes.fields, modes.amplitudes
    for sweep in range(1, MOST_SWEEPS + 1):
        frames = _combine(fields, amplitudes.T)
        forces = [measured.model.linearize(q)[0] for measured, q in zip(measurements, frames, strict=True)]
        of_frames = weights @ amplitudes @ np.linalg.inv(amplitudes.T @ weights @ amplitudes)
        fields = [u + problem.solver.step.solve(u, b).dq
                  for u, b in zip(fields, _combine(forces, of_frames), strict=True)]
        # Of the new fields: b is that of the old ones less what M says of the change.
        forces = [b - multiply_by_hessians(systems, new - old)
                  for b, new, old in zip(forces, _combine(fields, amplitudes.T), frames, strict=True)]
        of_gaps = _multiply_gaps(problem.team, systems, fields)
        products = _multiply(fields, [multiply_by_hessians(systems, u) for u in fields]) + of_gaps
        correction = np.linalg.solve(products, _multiply(fields, forces) - of_gaps @ amplitudes.T).T
        amplitudes = amplitudes + correction
        moved = [new - old for new, old in zip(_combine(fields, amplitudes.T), frames, strict=True)]
        if np.sqrt(np.mean([change.measure_rms()**2 for change in moved])) < SETTLED:
            return replace(modes, fields=fields, amplitudes=amplitudes, n_sweeps=sweep)
        stop_if_asked(problem.team, f"after pass {sweep} over all frames, before the modes settled")
    raise as_collective(ConvergenceError(f"modes: fields still change after {MOST_SWEEPS} passes over all frames; ask "
                                         "for fewer modes"))


def _scale(modes: TimeModes, unmeasured: Sequence[BoolArray]) -> TimeModes:
    """Scale each field to 1 where it is largest, among the nodes that are measured."""
    team = modes.fields[0].team
    largest = np.array([team.maximum(max(float(np.abs(u.reshape(len(is_out), -1)[~is_out]).max(initial=0.0))
                                         for u, is_out in zip(of_mode.displacements, unmeasured, strict=True)))
                        for of_mode in modes.fields])
    return replace(modes, fields=[of_mode / size for of_mode, size in zip(modes.fields, largest, strict=True)],
                   amplitudes=modes.amplitudes * largest)


def _weigh_frames(n_frames: int, power: float) -> Array:
    """W to a power: the inverse of I + 1 1^T, (n_frames, n_frames)."""
    along = np.full((n_frames, n_frames), 1.0 / n_frames)
    return np.asarray(np.eye(n_frames) + ((1.0 + n_frames) ** -power - 1.0) * along)


def _combine(fields: Sequence[Field], weights: Array) -> list[Field]:
    """Sums of fields with weights, (n_fields, n_sums)."""
    parts = [np.stack(of_subdomain) for of_subdomain in zip(*fields, strict=True)]
    return [fields[0].with_parts(column @ of_fields for of_fields in parts) for column in weights.T]


def _multiply(fields: Sequence[Field], forces: Sequence[Field]) -> Array:
    """Works of forces, shares of which subdomains have, on fields, (n_fields, n_forces); collective."""
    works = [np.stack(u) @ np.stack(b).T for u, b in zip(zip(*fields, strict=True), zip(*forces, strict=True),
                                                         strict=True)]
    return fields[0].team.ordered_sum(works)


def _multiply_gaps(team: Team, systems: Sequence[LocalSystem], fields: Sequence[Field]) -> Array:
    """Multiply displacements of nodes by eta Kbar^T Kbar with each other, (n_fields, n_fields); collective."""
    subdomains, at_nodes = [system.subdomain for system in systems], []
    for system, of_subdomain in zip(systems, zip(*fields, strict=True), strict=True):
        rows = EquilibriumRows(system)
        parts = np.stack([rows.multiply(u) for u in of_subdomain])
        at_nodes.append(parts.T.reshape(system.subdomain.mesh.n_nodes, -1))
    # Rows of interfaces complete.
    gaps = [values.reshape(-1, len(fields)) for values in sum_shared_nodes(team, subdomains, at_nodes)]
    return team.ordered_sum([system.eta * gap.T @ (gap / system.subdomain.all_multiplicity[:, None])
                             for system, gap in zip(systems, gaps, strict=True)])


def _expect_noise(problem: WeightedProblem, measurements: Sequence[Measurement]) -> float:
    """Largest singular value that the noise of one image is expected to have in all frames, by A; collective.

    Of random numbers, as many as unknowns that the images determine times frames.
    """
    solver, last = problem.solver, measurements[-1]
    counted = [~is_unmeasured for is_unmeasured in last.unmeasured]
    response = estimate_response(problem.team, solver.assembly.systems, solver.step, counted)
    noises = [measure_force_noise(measured.model, measured.evaluation, measured.q, response.n_determined,
                                  is_regularized=solver.assembly.eta > 0).sigma for measured in measurements]
    return float(np.sqrt(np.mean(np.square(noises))) * (np.sqrt(response.n_determined) + np.sqrt(len(measurements))))
