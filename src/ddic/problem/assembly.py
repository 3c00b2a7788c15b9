"""Local systems of all owned subdomains: M_s, Kbar_s and eta."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.schema import RegularizationSection, SolverSection
from ddic.errors import InputError, on_all_ranks
from ddic.functionals.correlation import read_correlations
from ddic.functionals.equilibrium_gap import controlled_stiffness, cut_off_weight, texture_energies
from ddic.functionals.view import View
from ddic.images.sub_image import DeformedSubImage
from ddic.images.threads import Threads
from ddic.images.window import Window
from ddic.kinematics.finite_element import finite_element_kinematics
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain, interface_weights
from ddic.problem.inputs import ImagePair, Region, material
from ddic.solvers.gauss_newton import OwnedPart
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem

SINGULAR = 1e-9
"""An operator whose lowest eigenvalue is below this share of the mean diagonal of M is singular: a
smooth displacement of the subdomain changes no grey level that a camera could see."""


@dataclass(frozen=True)
class Assembly:
    """Owned local systems and what they have in common.

    eta: weight of the equilibrium gap (0 without); mean_diagonal: mean of diag M over the region, grey^2/px^2.
    """

    systems: list[LocalSystem]
    eta: float
    mean_diagonal: float

    @property
    def reaction_scale(self) -> float:
        """Scale c = 1 / sqrt(eta mean diag M), which gives Lambda and LambdaBar one unit."""
        return 1.0 if self.eta == 0 else float(1.0 / np.sqrt(self.eta * self.mean_diagonal))


def own_parts(subdomains: Sequence[Subdomain], pair: ImagePair, degree: int, n_threads: int = 1) -> list[OwnedPart]:
    """Read the subdomains' windows of the reference image; those of the deformed one are read when needed.

    n_threads: of this rank, for all that is done with the parts' pixels.
    """
    parts: list[OwnedPart] = []
    threads = Threads(n_threads)
    for group in read_correlations([s.mesh for s in subdomains], pair.reference, degree, threads):
        deformed = DeformedSubImage(pair.deformed, degree, threads)
        parts += [OwnedPart(subdomains[len(parts) + k], (View(seen, deformed),)) for k, seen in enumerate(group)]
    return parts


def seen_parts(parts: Sequence[OwnedPart], q: Sequence[NDArray[np.float64]],
               which: slice = slice(None)) -> list[OwnedPart]:
    """The parts without the pixels that unknowns q hide in the deformed image, whose windows are read.

    which: views of each part that this is done for.
    """
    wanted: dict[int, tuple[DeformedSubImage, Window]] = {}
    for view, q_s in ((view, q_s) for part, q_s in zip(parts, q, strict=True) for view in part.views[which]):
        window = view.displaced_window(q_s)
        shared = wanted.get(id(view.deformed))
        # At once for all who share it: one by one, every subdomain would outgrow what the last one read.
        wanted[id(view.deformed)] = (view.deformed, window if shared is None else window.union(shared[1]))
    for deformed, window in wanted.values():
        deformed.covering(window)
    chosen = [set(range(*which.indices(len(part.views)))) for part in parts]
    return [replace(part, views=tuple(view.seen_from(q_s) if k in own else view for k, view in enumerate(part.views)))
            for part, q_s, own in zip(parts, q, chosen, strict=True)]


def correlate(team: Team, parts: Sequence[OwnedPart]) -> list[sparse.csr_matrix]:
    """M_s of all owned subdomains."""
    return team.together(lambda: [reduce(add, (view.hessian() for view in part.views)) for part in parts])


def assemble(team: Team, parts: Sequence[OwnedPart], hessians: Sequence[sparse.csr_matrix], region: Region,
             solver: SolverSection, section: RegularizationSection | None) -> Assembly:
    """Find eta for the whole region, and Kbar_s; hessians: M_s."""
    mean_diagonal = _mean_diagonal(team, parts, hessians, region)
    if section is None:
        nothing = np.zeros(0)
        systems = [LocalSystem(p.subdomain, h, None, nothing, 0.0) for p, h in zip(parts, hessians, strict=True)]
        return Assembly(systems, 0.0, mean_diagonal)
    if section.eta is not None:
        eta = section.eta
    else:
        assert section.cut_off_wavelength is not None
        wavelength = section.cut_off_wavelength
        texture = team.ordered_sum([
            texture_energies(p.subdomain.nodes, h[:p.n_dofs, :p.n_dofs], p.subdomain.interior, wavelength)
            for p, h in zip(parts, hessians, strict=True)
        ])
        eta = _weight(texture, region)
    regularization = material(section)

    def system(part: OwnedPart, hessian: sparse.csr_matrix) -> LocalSystem:
        subdomain = part.subdomain
        weights = interface_weights(subdomain.dof_multiplicity, solver.weighting) * subdomain.controlled
        kbar = controlled_stiffness(subdomain.mesh, finite_element_kinematics(subdomain.mesh), regularization, weights,
                                    subdomain.tie)
        motion = sparse.csr_matrix((kbar.shape[0], hessian.shape[0] - kbar.shape[0]))
        return LocalSystem(subdomain, hessian, sparse.hstack([kbar, motion]).tocsr(), weights, eta)

    systems = team.together(lambda: [system(p, h) for p, h in zip(parts, hessians, strict=True)])
    return Assembly(systems, eta, mean_diagonal)


def _mean_diagonal(team: Team, parts: Sequence[OwnedPart], hessians: Sequence[sparse.csr_matrix],
                   region: Region) -> float:
    """Mean of diag M over the first camera's dofs: near-field ones would hide what the far-field ones are."""
    sums = team.ordered_sum([np.array([h.diagonal()[:p.n_dofs].sum(), p.n_dofs]) * float(p.subdomain.camera == 0)
                             for p, h in zip(parts, hessians, strict=True)])
    several = any(team.gather_lists([part.subdomain.camera for part in parts]))
    return float(sums[0]) / (float(sums[1]) if several else region.n_dofs)


def _weight(texture: NDArray[np.float64], region: Region) -> float:
    if region.gap_energies is None or not region.gap_energies.reshape(-1, 2).any(axis=1).all():
        raise on_all_ranks(InputError(
            "regularization.cut_off_wavelength: the mesh has no interior node, so no wavelength can be given a "
            "weight; use a finer mesh or give regularization.eta"))
    return cut_off_weight(texture, region.gap_energies)


def factorize(team: Team, systems: Sequence[LocalSystem], mean_diagonal: float) -> list[LocalOperator]:
    """Factorise A_s of all owned subdomains; raises SingularSubdomainError on all ranks."""
    return team.together(lambda: [
        LocalOperator(s.displacements.operator, smallest_eigenvalue=SINGULAR * mean_diagonal, where=_where(s.subdomain))
        for s in systems
    ])


def _where(subdomain: Subdomain) -> str:
    low, high = subdomain.mesh.nodes.min(axis=0), subdomain.mesh.nodes.max(axis=0)
    return (f"subdomain {subdomain.index} (columns {low[0]:.0f} to {high[0]:.0f}, "
            f"rows {low[1]:.0f} to {high[1]:.0f})")
