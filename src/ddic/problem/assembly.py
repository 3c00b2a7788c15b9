"""Local systems of all owned subdomains: M_s, Kbar_s, P and eta, from the reference images alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray
from ddic.case.schema import RegularizationSection
from ddic.errors import InputError, as_collective
from ddic.functionals.regularization import (
    controlled_stiffness,
    find_cut_off_weight,
    find_edge_weight,
    measure_texture_energies,
)
from ddic.functionals.view import View
from ddic.inputs.mesh_source import NO_INNER_NODE
from ddic.parallel.field import ByView
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain, interface_weights
from ddic.problem.reference_problem import ReferenceProblem
from ddic.problem.region_mesh import ProbeWaves, Region, build_material
from ddic.problem.views import Hessians, project_hessians, weigh_cameras
from ddic.solvers.local_system import LocalSystem

SINGULAR = 1e-9
"""An operator whose lowest eigenvalue is below this share of the mean diagonal of M is singular: a
smooth displacement of the subdomain changes no grey level that a camera could see. A larger share refuses more."""


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


def assemble(team: Team, reference: ReferenceProblem, weights: Sequence[float], rotation: Array | None = None,
             ) -> Assembly:
    """Find eta for the whole region and set up the local systems; collective.

    ``weights`` are those of the cameras' squared grey levels, no unit; ``rotation``, (2, 2), is that by which the
    specimen has turned, if any. Raises InputError on all ranks, where a cut-off wavelength has no inner node.
    """
    case, subdomains = reference.inputs.case, reference.subdomains
    section, views = case.regularization, weigh_cameras(reference.views, weights)
    projected = team.together(lambda: project_hessians(views, reference.hessians))
    mean_diagonal = _mean_diagonal(team, subdomains, projected, reference.region)
    if section is None:
        systems = [LocalSystem(s, m, None, np.zeros(0), 0.0) for s, m in zip(subdomains, projected, strict=True)]
        return Assembly(systems, 0.0, mean_diagonal)
    eta, edge_weight = _weigh_gap(team, section, reference, views)
    material = build_material(section)

    def set_up(subdomain: Subdomain, hessian: sparse.csr_matrix) -> LocalSystem:
        of_rows = interface_weights(subdomain.multiplicity, case.solver.weighting)
        stiffness = controlled_stiffness(subdomain.kinematics, material, of_rows, rotation)
        if subdomain.n_motion:
            # A camera's motion is no displacement of matter, hence in no equilibrium.
            of_motion = sparse.csr_matrix((stiffness.shape[0], subdomain.n_motion))
            stiffness = sparse.hstack([stiffness, of_motion]).tocsr()
        return LocalSystem(subdomain, hessian, stiffness, of_rows, eta, weigh_rows(subdomain.controlled, edge_weight))

    systems = team.together(lambda: [set_up(s, m) for s, m in zip(subdomains, projected, strict=True)])
    return Assembly(systems, eta, mean_diagonal, edge_weight)


def weigh_rows(controlled: BoolArray, edge_weight: float) -> Array:
    """Give the diagonal of P, Eq. 9 of [BP17]: how much the equilibrium of each unknown counts, small at edges."""
    return np.where(controlled, 1.0, edge_weight)


def find_eta(team: Team, subdomains: Sequence[Subdomain], views: ByView[View], hessians: Hessians,
             probe: ProbeWaves) -> float:
    """Find the weight at which texture and mechanics count alike at the probe's wavelength [LPHR11]; collective.

    Of each subdomain its own camera's texture, weighted, counts. The weight is in grey levels squared per pixel
    squared.
    """
    texture = team.ordered_sum([
        own.weight * measure_texture_energies(s.mesh.nodes, hessian, s.interior, probe.wavelength)
        for s, (own, *_), (hessian, *_) in zip(subdomains, views, hessians, strict=True)])
    return find_cut_off_weight(texture, probe.gap_energies)


def _weigh_gap(team: Team, section: RegularizationSection, reference: ReferenceProblem,
               views: ByView[View]) -> tuple[float, float]:
    """What equilibrium weighs: eta, given or that of the cut-off wavelength, and relative to it that of the edges."""
    if section.eta is not None and section.edge_wavelength == 0:
        return section.eta, 0.0
    probe = require_held(reference.region.probe)
    if not probe.is_weighable:
        if section.eta is None:
            raise as_collective(InputError(f"regularization.cut_off_wavelength: {NO_INNER_NODE}"))
        return section.eta, 0.0
    eta_of_probe = find_eta(team, reference.subdomains, views, reference.hessians, probe)
    eta = eta_of_probe if section.eta is None else section.eta
    return eta, find_edge_weight(eta, (probe.wavelength, eta_of_probe), section.edge_wavelength)


def _mean_diagonal(team: Team, subdomains: Sequence[Subdomain], hessians: Sequence[sparse.csr_matrix],
                   region: Region) -> float:
    """Mean of diag M over the first camera's unknowns: near-field ones would hide what the far-field ones are."""
    shares: list[Array] = []
    for subdomain, hessian in zip(subdomains, hessians, strict=True):
        n_field = subdomain.n_field
        of_first = np.array([hessian.diagonal()[:n_field].sum(), n_field])
        shares.append(of_first * float(subdomain.camera == 0))
    total, n_unknowns = team.ordered_sum(shares)
    several_cameras = any(team.gather_lists([subdomain.camera for subdomain in subdomains]))
    return float(total) / (float(n_unknowns) if several_cameras else region.n_field)
