"""Local systems of all owned subdomains: M_s, Kbar_s and eta, from the reference images alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.schema import Case, RegularizationSection
from ddic.errors import InputError, as_collective
from ddic.functionals.regularization import (
    controlled_stiffness,
    find_cut_off_weight,
    find_edge_weight,
    measure_texture_energies,
)
from ddic.inputs.mesh_source import NO_INNER_NODE
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain, interface_weights
from ddic.problem.region_mesh import Region, build_material
from ddic.problem.views import ReferenceViews
from ddic.solvers.local_system import LocalSystem

SINGULAR = 1e-9
"""An operator whose lowest eigenvalue is below this share of the mean diagonal of M is singular: a
smooth displacement of the subdomain changes no grey level that a camera could see. A larger share refuses more."""

Hessians = list[sparse.csr_matrix]
"""M of each view of a subdomain, on displacements of nodes in its image."""


@dataclass(frozen=True)
class Assembly:
    """Owned local systems and what they have in common.

    Attributes
    ----------
    systems : list of LocalSystem
        Of this rank's subdomains.
    eta, mean_diagonal : float
        Weight of the equilibrium gap, 0 without, and mean of diag M over the first camera's unknowns; both in grey
        levels squared per pixel squared.
    edge_weight : float
        P of rows that are not controlled.
    """

    systems: list[LocalSystem]
    eta: float
    mean_diagonal: float
    edge_weight: float = 0.0

    @property
    def smallest_eigenvalue(self) -> float:
        """Eigenvalue below which an operator counts as singular, grey levels squared per pixel squared."""
        return SINGULAR * self.mean_diagonal

    @property
    def reaction_scale(self) -> float:
        """Scale c = 1 / sqrt(eta mean diag M), which gives Lambda and LambdaBar one unit."""
        return 1.0 if self.eta == 0 else float(1.0 / np.sqrt(self.eta * self.mean_diagonal))


def assemble_hessians(team: Team, references: Iterable[ReferenceViews]) -> list[Hessians]:
    """Assemble M of all views of owned subdomains, gone through once; an error is raised on all ranks."""
    return team.together(lambda: [[view.assemble_hessian() for view in reference.views] for reference in references])


def assemble(team: Team, case: Case, region: Region, references: Sequence[ReferenceViews],
             hessians: Sequence[Hessians], rotation: NDArray[np.float64] | None = None) -> Assembly:
    """Find eta for the whole region and set up the local systems; collective.

    The cameras of ``references`` are weighted; ``rotation``, (2, 2), is that by which the specimen has turned, if any.
    Raises InputError on all ranks, where a cut-off wavelength has no inner node.
    """
    section = case.regularization
    projected = team.together(lambda: [r.project(m) for r, m in zip(references, hessians, strict=True)])
    mean_diagonal = _mean_diagonal(team, references, projected, region)
    if section is None:
        nothing = np.zeros(0)
        systems = [LocalSystem(r.subdomain, m, None, nothing, 0.0) for r, m in zip(references, projected, strict=True)]
        return Assembly(systems, 0.0, mean_diagonal)
    gap = _weigh_gap(team, section, region, references, hessians)
    systems = team.together(lambda: [
        _system(case, r.subdomain, m, gap, rotation) for r, m in zip(references, projected, strict=True)])
    return Assembly(systems, gap.eta, mean_diagonal, gap.of_edges)


@dataclass(frozen=True)
class _GapWeight:
    """What equilibrium weighs, one for the whole region.

    eta : grey levels squared per pixel squared; of_edges : of rows that are not controlled, relative to the others.
    """

    eta: float
    of_edges: float


def _weigh_gap(team: Team, section: RegularizationSection, region: Region, references: Sequence[ReferenceViews],
               hessians: Sequence[Hessians]) -> _GapWeight:
    """The weight that is given, or that of the cut-off wavelength [LPHR11], and with it that of the edges."""
    if section.eta is not None and section.edge_wavelength == 0:
        return _GapWeight(section.eta, 0.0)
    probe = require_held(region.probe)
    is_weighable = probe.gap_energies.reshape(-1, 2).any(axis=1).all()
    if not is_weighable and section.eta is None:
        raise as_collective(InputError(
            f"regularization.cut_off_wavelength: {NO_INNER_NODE}"))
    if not is_weighable:
        return _GapWeight(require_held(section.eta), 0.0)
    texture = team.ordered_sum([
        r.own.weight * measure_texture_energies(r.subdomain.mesh.nodes, m[0], r.subdomain.interior, probe.wavelength)
        for r, m in zip(references, hessians, strict=True)])
    eta_of_probe = find_cut_off_weight(texture, probe.gap_energies)
    eta = eta_of_probe if section.eta is None else section.eta
    return _GapWeight(eta, find_edge_weight(eta, (probe.wavelength, eta_of_probe), section.edge_wavelength))


def _system(case: Case, subdomain: Subdomain, hessian: sparse.csr_matrix, gap: _GapWeight,
            rotation: NDArray[np.float64] | None) -> LocalSystem:
    """M_s, diag(w) T^T K T and P of one subdomain, Eq. 9 of [BP17]; P is small at edges, not 0."""
    weights = interface_weights(subdomain.multiplicity, case.solver.weighting)
    material = build_material(require_held(case.regularization))
    of_field = controlled_stiffness(subdomain.kinematics, material, weights, rotation)
    stiffness = of_field
    if subdomain.n_motion:
        # A camera's motion is no displacement of matter, hence in no equilibrium.
        of_motion = sparse.csr_matrix((of_field.shape[0], subdomain.n_motion))
        stiffness = sparse.hstack([of_field, of_motion]).tocsr()
    projection = np.where(subdomain.controlled, 1.0, gap.of_edges)
    return LocalSystem(subdomain, hessian, stiffness, weights, gap.eta, projection)


def _mean_diagonal(team: Team, references: Sequence[ReferenceViews], hessians: Sequence[sparse.csr_matrix],
                   region: Region) -> float:
    """Mean of diag M over the first camera's unknowns: near-field ones would hide what the far-field ones are."""
    shares: list[NDArray[np.float64]] = []
    for reference, hessian in zip(references, hessians, strict=True):
        n_field = reference.subdomain.n_field
        of_first = np.array([hessian.diagonal()[:n_field].sum(), n_field])
        shares.append(of_first * float(reference.subdomain.camera == 0))
    total, n_unknowns = team.ordered_sum(shares)
    several_cameras = any(team.gather_lists([reference.subdomain.camera for reference in references]))
    return float(total) / (float(n_unknowns) if several_cameras else region.n_field)
