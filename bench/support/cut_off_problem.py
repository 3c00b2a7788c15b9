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

from bench.support.step_problem import ALONE, Vector, prepare_step, weighted_stiffness
from ddic.case.schema import Case, RegularizationSection
from ddic.functionals.regularization import (
    controlled_stiffness,
    find_cut_off_weight,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.parallel.team import require_held
from ddic.partition.subdomain import Subdomain, interface_weights
from ddic.problem.assembly import Assembly
from ddic.problem.reference_problem import project_hessians
from ddic.problem.region_mesh import RegionMesh, build_material
from ddic.solvers.local_system import LocalSystem


@dataclass(frozen=True)
class TexturedMesh:
    """A partitioned mesh and its texture on one rank, without a cut-off wavelength.

    Attributes
    ----------
    whole : RegionMesh
        The whole mesh.
    subdomains : list of Subdomain
        All of them.
    hessians : list of (n_unknowns, n_unknowns) csr_matrix
        Their M_s, grey levels squared per pixel squared.
    right : list of (n_unknowns,) arrays
        Their b_s, grey levels squared per pixel.
    stiffnesses : list of csr_matrix
        Their Kbar_s, consistent weights.
    """

    whole: RegionMesh
    subdomains: list[Subdomain]
    hessians: list[sparse.csr_matrix]
    right: list[Vector]
    stiffnesses: list[sparse.csr_matrix]

    @property
    def n_unknowns(self) -> int:
        """Unknowns of the whole mesh."""
        return self.whole.kinematics.n_unknowns

    @property
    def numbers(self) -> list[NDArray[np.int64]]:
        """Numbers of each subdomain's unknowns in the whole problem."""
        return [s.numbers for s in self.subdomains]

    def dim(self, factor: float) -> TexturedMesh:
        """Give the same with grad f ``factor`` times as large in every second subdomain.

        b_s carries grad f and the residual; both are grey levels and shrink alike.

        Parameters
        ----------
        factor : float
            Hence factor^2 in M_s and b_s.

        Returns
        -------
        TexturedMesh
            The same mesh.
        """
        scales = [factor**2 if s.index % 2 else 1.0 for s in self.subdomains]
        return replace(self, hessians=[c * m for c, m in zip(scales, self.hessians, strict=True)],
                       right=[c * b for c, b in zip(scales, self.right, strict=True)])


def read_texture(case: Case) -> TexturedMesh:
    """Assemble the texture and the first residual of a case's images on one rank.

    Parameters
    ----------
    case : Case
        With a regularization.

    Returns
    -------
    TexturedMesh
        Cut as the case says.
    """
    if case.regularization is None:
        raise ValueError("the case has no regularization")
    problem = prepare_step(ALONE, case)
    right = problem.right_hand_sides([np.zeros(s.n_unknowns) for s in problem.subdomains])
    hessians = project_hessians(problem.reference.views, problem.hessians)
    stiffnesses = [weighted_stiffness(s, case.regularization, _weights(s)) for s in problem.subdomains]
    return TexturedMesh(require_held(problem.whole), problem.subdomains, hessians, right, stiffnesses)


def assemble_at(problem: TexturedMesh, section: RegularizationSection) -> Assembly:
    """Set up the local systems with eta of a section's cut-off wavelength.

    Parameters
    ----------
    problem : TexturedMesh
        The texture.
    section : RegularizationSection
        With a cut-off wavelength.

    Returns
    -------
    Assembly
        On one rank.
    """
    if section.cut_off_wavelength is None:
        raise ValueError("the section gives no cut-off wavelength")
    wavelength = section.cut_off_wavelength
    texture = sum((measure_texture_energies(s.mesh.nodes, m, s.interior, wavelength)
                   for s, m in zip(problem.subdomains, problem.hessians, strict=True)), start=np.zeros(1))
    whole = problem.whole
    material = build_material(section, whole.mesh.dim)
    eta = find_cut_off_weight(texture, measure_gap_energies(whole.mesh, material, whole.interior, wavelength))
    systems = [LocalSystem(s, m, k, interface_weights(s.multiplicity, "consistent"), eta) for s, m, k
               in zip(problem.subdomains, problem.hessians, problem.stiffnesses, strict=True)]
    trace = sum(float(m.diagonal().sum()) for m in problem.hessians)
    return Assembly(systems, eta, trace / problem.n_unknowns)


def assemble_one_domain(problem: TexturedMesh, section: RegularizationSection,
                        eta: float) -> tuple[sparse.csr_matrix, Vector]:
    """Assemble the one-domain problem, M and b the sums of the parts.

    Parameters
    ----------
    problem : TexturedMesh
        The texture.
    section : RegularizationSection
        Says the material.
    eta : float
        Weight of the equilibrium gap.

    Returns
    -------
    matrix : (n_unknowns, n_unknowns) csr_matrix
        A = M + eta Kbar^T Kbar.
    right : (n_unknowns,) array
        b.
    """
    n = problem.n_unknowns
    right = np.zeros(n)
    rows, columns, values = [], [], []
    for numbers, hessian, b in zip(problem.numbers, problem.hessians, problem.right, strict=True):
        entries = hessian.tocoo()
        rows.append(numbers[entries.row])
        columns.append(numbers[entries.col])
        values.append(entries.data)
        right[numbers] += b
    places = (np.concatenate(rows), np.concatenate(columns))
    hessian = sparse.coo_matrix((np.concatenate(values), places), shape=(n, n)).tocsr()
    whole = problem.whole
    kinematics = whole.kinematics.restrict(whole.mesh, np.arange(whole.mesh.n_nodes), np.arange(n))
    kbar = controlled_stiffness(kinematics, build_material(section, whole.mesh.dim), whole.controlled.astype(float))
    return (hessian + eta * (kbar.T @ kbar)).tocsr(), right


def measure_difference(problem: TexturedMesh, dq: Sequence[Vector], reference: Vector) -> float:
    """Measure the distance of the subdomains' dq from the one-domain dq, every unknown counted once.

    Parameters
    ----------
    problem : TexturedMesh
        The subdomains.
    dq : sequence of (n_unknowns,) arrays
        Their corrections, pixels.
    reference : (n_unknowns,) array
        Of one domain, pixels.

    Returns
    -------
    float
        Relative to the latter's norm.
    """
    squares = sum(float(((d - reference[numbers]) ** 2 / s.multiplicity).sum())
                  for s, d, numbers in zip(problem.subdomains, dq, problem.numbers, strict=True))
    return float(np.sqrt(squares) / np.linalg.norm(reference))


def _weights(subdomain: Subdomain) -> Vector:
    return interface_weights(subdomain.multiplicity, "consistent") * subdomain.controlled
