"""A specimen's elastic parameters from its measured frames, with what is to be stated beside them.

FEMU and integrated DIC, standard deviations and correlations, whether the mesh is fine enough, and how well the
identified law agrees with the measured field.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import Case, ForceSection, IdentificationSection, MaterialSection
from ddic.comparison.placement import PlacedField
from ddic.identification.identify import FieldEvidence, correct_once, identify
from ddic.identification.image_evidence import ImageEvidence
from ddic.identification.joint_step import ElasticModel, MaterialModel, MeasuredForce
from ddic.identification.laws import ElasticBody, ElasticLaw, LawOnCells
from ddic.inputs.mesh_source import share_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.refinement import refine
from ddic.mesh.topology import BOUNDARY, find_boundary_nodes, find_named_nodes
from ddic.parallel.team import require_held
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.comparison import compare_with_known
from ddic.results.measurement import Measurement
from ddic.solvers.probing import estimate_response
from ddic.visibility.noise_forces import OF_RESIDUAL, find_image_noise, measure_force_noise

COARSE = 1.0
"""Standard deviations by which a mesh of half the size may move a parameter without a warning."""

MODULI = ("young", "young_1", "young_2", "shear")
"""Parameters with a unit."""


@dataclass(frozen=True, eq=False)
class Identification:
    """Parameters of a material and how well they are known.

    Attributes
    ----------
    names : list of str
        Of the parameters.
    values, deviations : (n_parameters,) array
        Found by integrated DIC, and their standard deviations.
    correlations : (n_parameters, n_parameters) array
        Correlation coefficients of their errors.
    by_fields : (n_parameters,) array
        Found by FEMU from the measured fields.
    by_halving : (n_parameters,) array
        Change that a mesh of half the size makes.
    n_iterations, n_iterations_of_fields : int
        Of integrated DIC, and of FEMU before it.
    units : list of str
        Of the parameters, "1" for none.
    """

    names: list[str]
    values: Array
    deviations: Array
    correlations: Array
    by_fields: Array
    by_halving: Array
    n_iterations: int
    n_iterations_of_fields: int
    units: list[str]

    @property
    def table(self) -> Mapping[str, Any]:
        """Columns by name, a row a parameter."""
        return {"parameter": self.names, "value": self.values, "deviation": self.deviations, "unit": self.units,
                "by_fields": self.by_fields, "by_halving": self.by_halving,
                **{f"correlation_{name}": row for name, row in zip(self.names, self.correlations, strict=True)}}

    def describe(self) -> tuple[str, ...]:
        """Say what was found, a line a parameter, and warn of a mesh that is too coarse."""
        lines = [f"identified: {name} = {value:.5g} +- {deviation:.2g}{'' if unit == '1' else f' {unit}'} "
                 f"(FEMU {by_fields:.5g})" for name, value, deviation, unit, by_fields
                 in zip(self.names, self.values, self.deviations, self.units, self.by_fields, strict=True)]
        lines += [f"identified: {self.names[j]} and {self.names[k]} have the correlation {self.correlations[j, k]:.2f}"
                  for j in range(len(self.names)) for k in range(j)]
        moved = np.abs(self.by_halving) / self.deviations
        lines += [f"warning: a mesh of half the size moves {name} by {change:.2g}, {share:.1f} standard deviations; "
                  "use smaller elements" for name, change, share in zip(self.names, self.by_halving, moved, strict=True)
                  if share > COARSE]
        return tuple(lines)


def identify_material(problem: WeightedProblem, measurements: Sequence[Measurement],
                      build: Callable[[Case, Mesh], MaterialModel] | None = None) -> Measurement:
    """Identify the parameters that a case asks for, from one frame or several; collective.

    ``problem`` has measured the frames, with the operators that found the last one; ``build`` makes the model on a
    mesh, by default that of the case. Returns the measurement of the last frame with the parameters, its comparison
    with the law that was found, and notes. Raises InputError or ConvergenceError on all ranks, where they are not
    found.
    """
    is_own = build is not None
    build = build or build_model
    team, last = problem.team, measurements[-1]
    case = last.inputs.case
    mesh = team.build_on_root(lambda: last.inputs.build_mesh()[0])
    model = team.build_on_root(lambda: build(case, require_held(mesh)))
    frames = [ImageEvidence.of_frame(of_frame.model, of_frame.q, mesh, turned_back=not is_own)
              for of_frame in measurements]
    sigma = float(np.sqrt(np.mean([_find_noise(problem, of_frame) ** 2 for of_frame in measurements])))
    fields = [FieldEvidence(frame.gather_hessian(), frame.gather_measured()) for frame in frames]
    of_fields = identify(team, model, fields, sigma)
    found = identify(team, model, frames, sigma, of_fields)

    refined = team.build_on_root(lambda: refine(require_held(mesh)))
    fine_model = team.build_on_root(lambda: build(case, require_held(refined).mesh))
    on_fine = replace(found, u=None if found.u is None else [require_held(refined).interpolate(u) for u in found.u])
    halved = correct_once(team, fine_model, [frame.refine(refined) for frame in frames], sigma, on_fine)

    section = case.identification
    unit = f"N / {case.imaging.length_unit}2" if section is not None and section.force else "relative"
    # What a model of one's own calls its parameters tells nothing of their unit.
    units = ["1" if is_own else unit if name.rpartition(".")[2] in MODULI else "degrees" if "angle" in name else "1"
             for name in found.names]
    identification = Identification(found.names, found.values, found.deviations, found.correlations, of_fields.values,
                                    halved.values - found.values, found.n_iterations, of_fields.n_iterations, units)
    displacement = None if found.u is None else frames[-1].apply_rotation(found.u[-1])
    law = team.on_root(lambda: PlacedField.as_given(
        require_held(mesh), require_held(displacement).reshape(require_held(mesh).nodes.shape)))
    origin = {"file": "identified law", "step": "1", "placement": "in its place"}
    compared = compare_with_known(problem, last, law.at, origin)
    return replace(compared.with_notes(identification.describe()), identification=identification)


def build_model(case: Case, mesh: Mesh) -> ElasticModel:
    """Build the model of a specimen that a case, which was checked, describes."""
    section = require_held(case.identification)
    has_force = bool(section.force)
    laws = [LawOnCells(ElasticLaw(material.law, material.plane), cells, _list_values(material),
                       _choose_sought(material, is_held=not has_force and k == 0),
                       (material.region or "rest") if len(section.material) > 1 else "")
            for k, (material, cells) in enumerate(zip(section.material, share_cells(case, mesh),
                                                      strict=True))]
    is_loaded = np.zeros(mesh.n_nodes, dtype=bool)
    for name in section.loaded:
        is_loaded[_find_nodes(mesh, name)] = True
    return ElasticModel(ElasticBody(mesh, laws), ~is_loaded,
                        [_measure_force(case, section, force, mesh) for force in section.force])


def _find_nodes(mesh: Mesh, name: str) -> IntArray:
    return find_boundary_nodes(mesh) if name == BOUNDARY else find_named_nodes(mesh, name)


def _list_values(material: MaterialSection) -> Array:
    """Start values of all parameters, in the law's order."""
    if material.law == "isotropic":
        return np.array([material.young or 1.0, material.poisson_ratio])
    young_2 = material.young_2 or 1.0
    return np.array([material.young_1 or 1.0, young_2, material.poisson_ratio, material.shear or 0.4 * young_2,
                     material.angle_degrees])


def _choose_sought(material: MaterialSection, *, is_held: bool) -> BoolArray:
    """Which parameters are sought; ``is_held``: without a force, one modulus of all materials is given."""
    held = {*material.fixed, *({"young", "young_2"} if is_held else ())}
    return np.array([name not in held for name in ElasticLaw(material.law).parameters])


def _measure_force(case: Case, section: IdentificationSection, force: ForceSection, mesh: Mesh) -> MeasuredForce:
    direction = np.array(force.direction)
    values = np.atleast_1d(np.array(force.value, np.float64))
    factor = require_held(section.thickness) * require_held(case.imaging.pixel_size)
    return MeasuredForce(_find_nodes(mesh, force.nodes),
                         direction / np.linalg.norm(direction), values, force.deviation, factor)


def _find_noise(problem: WeightedProblem, measurement: Measurement) -> float:
    """Noise of both images as it acts on displacements, grey levels; collective."""
    model, evaluation, q = measurement.model, measurement.evaluation, measurement.q
    noise = find_image_noise(problem, model, evaluation, q)
    if noise.origin != OF_RESIDUAL:
        return noise.sigma[0]
    solver = problem.solver
    response = estimate_response(problem.team, solver.assembly.systems, solver.step,
                                 [~is_unmeasured for is_unmeasured in measurement.unmeasured])
    return measure_force_noise(model, evaluation, q, response.n_determined,
                               is_regularized=solver.assembly.eta > 0).sigma
