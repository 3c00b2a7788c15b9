"""One linear step whose texture is kept while the cut-off wavelength, or the texture's contrast, varies.

Nothing here but eta depends on the cut-off wavelength: images, M_s, b_s and Kbar_s are made once.
The one-domain problem is the sum of the same parts, so that both solve the same equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bench.support.step_problem import ALONE
from ddic.case.schema import Case, RegularizationSection
from ddic.functionals.equilibrium_gap import (
    controlled_stiffness,
    find_cut_off_weight,
    measure_texture_energies,
)
from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain, interface_weights
from ddic.problem.assembly import Assembly, own_parts
from ddic.problem.inputs import material, open_pair, region_gap_energies, share_out
from ddic.problem.mesh_source import build_mesh
from ddic.solvers.local_system import LocalSystem


@dataclass(frozen=True)
class TexturedMesh:
    """A partitioned mesh and its texture, without a cut-off wavelength.

    subdomains, hessians, right: owned subdomains, their M_s (grey^2/px^2) and b_s (grey^2/px).
    stiffnesses: their Kbar_s, consistent weights. whole: the mesh on rank 0; n_dofs: of the whole mesh.
    """

    subdomains: list[Subdomain]
    hessians: list[sparse.csr_matrix]
    right: list[NDArray[np.float64]]
    stiffnesses: list[sparse.csr_matrix]
    whole: Mesh | None
    n_dofs: int

    @property
    def dofs(self) -> list[NDArray[np.int64]]:
        """Numbers of each subdomain's dofs in the whole mesh."""
        return [s.dofs for s in self.subdomains]


def from_images(case: Case) -> TexturedMesh:
    """The texture and the first residual of a case's images on one rank; the case needs a regularization."""
    assert case.regularization is not None
    pair = open_pair(case)
    mesh = build_mesh(case, pair.reference.image.width, pair.reference.image.height)
    subdomains, _ = share_out(ALONE, case, mesh)
    hessians, right = [], []
    for subdomain in subdomains:
<<<<<<< HEAD
        part = own_parts([subdomain], pair, case.correlation.spline_degree)[0]
        residual = part.correlation.compute_residual(part.deformed, np.zeros(subdomain.mesh.n_dofs))
        hessians.append(part.correlation.assemble_hessian())
        right.append(part.correlation.assemble_right_hand_side(residual))
=======
        view = own_parts([subdomain], pair, case.correlation.spline_degree)[0].view
        hessians.append(view.hessian())
        right.append(view.right_hand_side(view.residual(np.zeros(subdomain.mesh.n_dofs))))
>>>>>>> refs/heads/accept
    return TexturedMesh(subdomains, hessians, right, local_stiffnesses(subdomains, case.regularization), mesh,
                        mesh.n_dofs)


def local_stiffnesses(subdomains: Sequence[Subdomain], section: RegularizationSection) -> list[sparse.csr_matrix]:
    """Kbar_s of some subdomains with consistent interface weights."""
    return [controlled_stiffness(s.mesh, interpolate_cells(s.mesh), material(section), _weights(s))
            for s in subdomains]


def dimmed(problem: TexturedMesh, factor: float) -> TexturedMesh:
    """The same with grad f ``factor`` times as large in every second subdomain, hence factor^2 in M_s and b_s.

    b_s carries grad f and the residual; both are grey levels and shrink alike.
    """
    scales = [factor**2 if s.index % 2 else 1.0 for s in problem.subdomains]
    return replace(problem, hessians=[c * m for c, m in zip(scales, problem.hessians, strict=True)],
                   right=[c * b for c, b in zip(scales, problem.right, strict=True)])


def assembly_at(team: Team, problem: TexturedMesh, section: RegularizationSection) -> Assembly:
    """The local systems with eta of the section's cut-off wavelength; collective."""
    assert section.cut_off_wavelength is not None
    wavelength = section.cut_off_wavelength
    texture = team.ordered_sum([measure_texture_energies(s.mesh.nodes, m, s.interior, wavelength)
                                for s, m in zip(problem.subdomains, problem.hessians, strict=True)])

    def weight() -> float:
        assert problem.whole is not None
        energies = region_gap_energies(section, problem.whole)
        assert energies is not None
        return find_cut_off_weight(texture, energies)

    eta = team.on_root(weight)
    systems = [LocalSystem(s, m, k, _weights(s), eta) for s, m, k
               in zip(problem.subdomains, problem.hessians, problem.stiffnesses, strict=True)]
    trace = float(team.ordered_sum([np.array(m.diagonal().sum()) for m in problem.hessians]))
    return Assembly(systems, eta, trace / problem.n_dofs)


def one_domain(problem: TexturedMesh, section: RegularizationSection,
               eta: float) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
    """A = M + eta Kbar^T Kbar and b of the whole mesh, M and b the sums of the parts; on one rank."""
    assert problem.whole is not None
    controlled = np.zeros(problem.n_dofs)
    right = np.zeros(problem.n_dofs)
    rows, columns, values = [], [], []
    for subdomain, dofs, hessian, b in zip(problem.subdomains, problem.dofs, problem.hessians, problem.right,
                                           strict=True):
        entries = hessian.tocoo()
        rows.append(dofs[entries.row])
        columns.append(dofs[entries.col])
        values.append(entries.data)
        controlled[dofs] = subdomain.controlled
        right[dofs] += b
    places = (np.concatenate(rows), np.concatenate(columns))
    hessian = sparse.coo_matrix((np.concatenate(values), places), shape=(problem.n_dofs, problem.n_dofs)).tocsr()
    kbar = controlled_stiffness(problem.whole, interpolate_cells(problem.whole), material(section), controlled)
    return (hessian + eta * (kbar.T @ kbar)).tocsr(), right


def difference(problem: TexturedMesh, dq: Sequence[NDArray[np.float64]], reference: NDArray[np.float64]) -> float:
    """Distance of the subdomains' dq from the one-domain dq, relative to the latter; each node counts once."""
    squares = sum(float(((d - reference[dofs]) ** 2 / s.dof_multiplicity).sum())
                  for s, d, dofs in zip(problem.subdomains, dq, problem.dofs, strict=True))
    return float(np.sqrt(squares) / np.linalg.norm(reference))


def _weights(subdomain: Subdomain) -> NDArray[np.float64]:
    weights: NDArray[np.float64] = interface_weights(subdomain.dof_multiplicity, "consistent") * subdomain.controlled
    return weights
