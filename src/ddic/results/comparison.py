"""A simulation beside a measured field: both levelled, their difference in standard deviations, chi^2 by region.

What is left between a field q that was measured and what the measurement makes of the true displacement is the field's
noise, whose samples d_k = A^-1 b_k follow from that of the images. Of a region with the part M_r of M,

    chi^2 = (q - q_s)^T M_r (q - q_s) / mean_k d_k^T M_r d_k

is 1 but for chance where the simulation q_s, levelled, is right, and larger where it is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import Case
from ddic.comparison.levelling import KnownDisplacement, level
from ddic.comparison.placement import PlacedField, fit_placement, fit_rigid_motion_to
from ddic.inputs.mesh_source import find_cells_in, read_case_simulation
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team, require_held
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.field_uncertainty import describe_uncertainty, estimate_field_uncertainty, find_node_displacements
from ddic.results.measurement import Measurement
from ddic.visibility.exclusions import find_excluded

WHOLE, REST = "whole field", "rest"
"""Regions that no case names: all cells that are compared, and those in no region."""

COVERED = 0.9
"""Share of a cell's pixels at which the simulation must be known for the cell to be compared."""

SURELY = 3.0
"""Scatter of chi^2 beyond 1 from which on a simulation differs by more than noise."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A simulation, levelled, beside a measured field.

    Attributes
    ----------
    simulated, difference, normalised : list of (n_nodes, dim) array
        At the nodes of each owned subdomain: the simulation as the measurement would have found it, and the measured
        field less that, pixels; the same in standard deviations. nan where nothing is compared.
    regions : dict of (n,) arrays
        Columns by name: region, cells, RMS difference, chi^2, and what noise makes chi^2 scatter by.
    origin : dict
        Of the simulation: file, step, placement.
    """

    simulated: list[Array]
    difference: list[Array]
    normalised: list[Array]
    regions: Mapping[str, Any]
    origin: Mapping[str, str]

    def describe(self) -> tuple[str, ...]:
        """Say what was compared, and how well it agrees, a line a region."""
        lines = [f"simulation: {self.origin['file']}, step {self.origin['step']}, {self.origin['placement']}"]
        for name, rms, chi, scatter in zip(*(self.regions[key] for key in ("region", "rms_difference_px", "chi_squared",
                                                                          "scatter")), strict=True):
            verdict = "more than noise" if chi > 1.0 + SURELY * scatter else "no more than noise"
            lines.append(f"simulation, {name}: RMS difference {rms:.3g} px, chi^2 = {chi:.3g} (1 +- {scatter:.2g} by "
                         f"noise alone): {verdict}")
        return tuple(lines)


def compare_with_simulation(problem: WeightedProblem, measurement: Measurement) -> Measurement:
    """Compare a measured field with the simulation that its case names; collective.

    ``problem`` has the operators that found the field. Returns the measurement with the comparison, the uncertainty
    that it rests on, and notes on both. Raises InputError on all ranks where the simulation cannot be placed,
    ConvergenceError where a linear step does not converge.
    """
    case, team = measurement.inputs.case, problem.team
    section = require_held(case.simulation)
    u = [of.reshape(-1, case.dim) for of in measurement.displacements]
    at_nodes = team.gather_to([(subdomain.mesh.nodes, of) for subdomain, of in zip(measurement.subdomains, u,
                                                                                   strict=True)])

    def place() -> tuple[PlacedField, str]:
        simulated = read_case_simulation(case)
        placed = PlacedField.as_given(simulated.mesh, simulated.displacement)
        fit = FITS[section.fit]
        points, measured = (np.concatenate(of_all) for of_all in
                            zip(*(of for of_rank in require_held(at_nodes) for of in of_rank), strict=True))
        return placed if fit is None else fit(placed, points, measured), simulated.step.describe()

    placed, step_name = team.on_root(place)
    origin = {"file": str(section.file), "step": step_name, "placement": placed.describe()}
    return compare_with_known(problem, measurement, placed.at, origin)


FITS = {"nothing": None, "motion": fit_rigid_motion_to, "placement": fit_placement}
"""What is fitted to the measured field, by the case's word."""


def compare_with_known(problem: WeightedProblem, measurement: Measurement, known: KnownDisplacement,
                       origin: Mapping[str, str]) -> Measurement:
    """Compare a measured field with a known displacement of the image's points; collective.

    As ``compare_with_simulation``, which reads and places it; ``origin`` says where it comes from.
    """
    model, q, team = measurement.model, measurement.q, problem.team
    levelled = level(model, problem.solver.step, q, known)
    # Of cells where the simulation is known and pixels count.
    are_compared = [(covered >= COVERED) & ~find_excluded(of_views[0])
                    for covered, of_views in zip(levelled.covered, measurement.excluded.cells, strict=True)]
    regions = [_list_regions(measurement.inputs.case, subdomain.mesh, is_compared)
               for subdomain, is_compared in zip(measurement.subdomains, are_compared, strict=True)]
    hessians = team.together(lambda: [
        [view.assemble_hessian(cells) for cells in of_subdomain.values()]
        for (view, *_), of_subdomain in zip(model.views, regions, strict=True)])
    counted = [_find_nodes_of(subdomain.mesh, is_compared)[:, None]
               for subdomain, is_compared in zip(measurement.subdomains, are_compared, strict=True)]
    samples: list[Array] = []

    def watch(displacements: list[Array]) -> None:
        # At the nodes of which the difference counts.
        of_counted = [np.where(is_counted, u, np.nan) for is_counted, u in zip(counted, displacements, strict=True)]
        samples.append(_sum_energies(team, hessians, of_counted))

    uncertainty = estimate_field_uncertainty(problem, model, measurement.evaluation, q, measurement.unmeasured, watch)
    simulated = find_node_displacements(team, measurement.subdomains, levelled.q, measurement.unmeasured)
    difference = [np.where(is_counted, u.reshape(of_nodes.shape) - of_nodes, np.nan)
                  for is_counted, u, of_nodes in zip(counted, measurement.displacements, simulated, strict=True)]
    normalised = [of_nodes / deviations.displacement
                  for of_nodes, deviations in zip(difference, uncertainty.deviations, strict=True)]
    table = _judge_regions(list(regions[0]), _sum_energies(team, hessians, difference), np.array(samples),
                           _count(measurement, regions, difference))
    found = Comparison(simulated, difference, normalised, table, origin)
    notes = (*describe_uncertainty(uncertainty), *found.describe())
    return replace(measurement.with_notes(notes), comparison=found, uncertainty=uncertainty)


def _list_regions(case: Case, mesh: Mesh, is_compared: BoolArray) -> dict[str, IntArray]:
    """Cells of each region among those that are compared, by the regions' names."""
    found = {WHOLE: is_compared}
    is_rest = is_compared.copy()
    for section in case.region:
        is_inside = find_cells_in(section, mesh)
        found[section.name] = is_compared & is_inside
        is_rest &= ~is_inside
    if case.region:
        found[REST] = is_rest
    return {name: np.flatnonzero(is_member) for name, is_member in found.items()}


def _find_nodes_of(mesh: Mesh, is_member: BoolArray) -> BoolArray:
    """Nodes all of whose cells are among some."""
    is_other = np.repeat(~is_member, np.diff(mesh.offsets))
    return np.asarray(np.bincount(mesh.connectivity, is_other, mesh.n_nodes) == 0)


def _sum_energies(team: Team, hessians: Sequence[Sequence[sparse.csr_matrix]], u: Sequence[Array]) -> Array:
    """u^T M_r u of each region, (n_regions,), grey levels squared; unknown displacements count as 0; collective."""
    energies = []
    for of_regions, of_nodes in zip(hessians, u, strict=True):
        v = np.nan_to_num(of_nodes, nan=0.0).ravel()
        energies.append(np.array([v @ (matrix @ v) for matrix in of_regions]))
    return team.ordered_sum(energies)


def _count(measurement: Measurement, regions: Sequence[Mapping[str, IntArray]], difference: Sequence[Array]) -> Array:
    """Cells, nodes and the sum of squared differences of each region, (n_regions, 3); collective."""
    counts = []
    for subdomain, of_subdomain, of_nodes in zip(measurement.subdomains, regions, difference, strict=True):
        rows = []
        for cells in of_subdomain.values():
            is_node = np.zeros(subdomain.mesh.n_nodes, dtype=bool)
            is_node[subdomain.mesh.create_submesh(cells)[1]] = True
            is_node &= np.isfinite(of_nodes).all(axis=1)
            shares = 1.0 / subdomain.node_multiplicity[is_node]
            rows.append([len(cells), shares.sum(), shares @ (of_nodes[is_node] ** 2).sum(axis=1)])
        counts.append(np.array(rows))
    return measurement.team.ordered_sum(counts)


def _judge_regions(names: Sequence[str], energies: Array, samples: Array, counts: Array) -> dict[str, Any]:
    """The table of regions that hold a cell, columns by name; ``samples`` are energies of noise, (n, n_regions)."""
    mean = samples.mean(axis=0)
    kept = (counts[:, 0] > 0) & (mean > 0)
    n_cells, n_nodes, squares = counts[kept].T
    return {"region": [name for name, is_kept in zip(names, kept, strict=True) if is_kept],
            "cells": n_cells.astype(np.int64), "rms_difference_px": np.sqrt(squares / np.maximum(n_nodes, 1.0)),
            "chi_squared": energies[kept] / mean[kept], "scatter": samples[:, kept].std(axis=0, ddof=1) / mean[kept]}
