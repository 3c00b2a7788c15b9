"""Eq. 23 of [BP17] for one linear step of a near-field and far-field case: one saddle point, solved directly.

Unknowns are what each camera sees, v_f and v_n = u + alpha, the multipliers of the jumps between them and alpha, which
has no stiffness but its columns in the jumps. Nothing here knows subdomains, or poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from ddic.case.schema import Case
from ddic.functionals.correlation import read_correlations
from ddic.functionals.equilibrium_gap import controlled_stiffness
from ddic.images.sub_image import DeformedSubImage
from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.mesh import Mesh
from ddic.problem.cameras import Camera
from ddic.problem.inputs import controlled_dofs, material

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """Where a linear step begins: a continuous u (n_dofs,) and alpha (2,), far px."""

    u: Array
    alpha: Array


def saddle_point(case: Case, mesh: Mesh, cameras: Sequence[Camera], labels: NDArray[np.int64], weights: Sequence[float],
                 eta: float, at: State) -> tuple[Array, Array]:
    """Corrections (du (n_dofs,), dalpha (2,)); labels: camera of each cell, 0 far and 1 near; weights: of the cameras.

    The near camera's mapping must be a similarity without rotation.
    """
    matrices, forces, gaps, dofs = [], [], [], []
    gap_now = np.zeros(mesh.n_dofs)
    for number, camera in enumerate(cameras):
        part, ids = mesh.submesh(np.flatnonzero(labels == number))
        own = (2 * ids[:, None] + np.arange(2)).ravel()
        seen = at.u[own] + (np.tile(at.alpha, len(ids)) if number else 0.0)
        ratio = float(camera.rig.mapping.homography[0, 0])
        hessian, force = _texture(case, camera, part, ratio * seen)
        matrices.append(weights[number] * ratio**2 * hessian)
        forces.append(weights[number] * ratio * force)
        rows = sparse.csr_matrix((np.ones(len(own)), (own, np.arange(len(own)))), shape=(mesh.n_dofs, len(own)))
        gaps.append(rows @ _stiffness(case, part) if eta else sparse.csr_matrix((mesh.n_dofs, len(own))))
        gap_now += gaps[-1] @ seen
        dofs.append(own)
    control = sparse.diags(controlled_dofs(case.regularization, mesh).astype(float)) if eta else sparse.eye(mesh.n_dofs)
    gap = control @ sparse.hstack(gaps)
    operator = sparse.block_diag(matrices) + eta * gap.T @ gap
    right = np.concatenate(forces) - eta * gap.T @ (control @ gap_now)
    _, in_far, in_near = np.intersect1d(*dofs, return_indices=True)
    n, n_far, size = len(right), len(dofs[0]), float(operator.diagonal().mean())
    number = np.arange(len(in_far))
    jumps = sparse.csr_matrix((np.repeat([1.0, -1.0], len(number)),
                               (np.tile(number, 2), np.concatenate([n_far + in_near, in_far]))), shape=(len(number), n))
    columns = sparse.csr_matrix((np.full(len(number), -1.0), (number, dofs[1][in_near] % 2)), shape=(len(number), 2))
    whole = sparse.bmat([[operator / size, None, jumps.T], [None, None, columns.T], [jumps, columns, None]]).tocsc()
    solution = splu(whole).solve(np.concatenate([right / size, np.zeros(2 + len(number))]))
    alpha = solution[n:n + 2]
    du = np.zeros(mesh.n_dofs)
    du[dofs[1]] = solution[n_far:n] - np.tile(alpha, len(dofs[1]) // 2)
    du[dofs[0]] = solution[:n_far]
    return du, alpha


def _texture(case: Case, camera: Camera, part: Mesh, displacement: Array) -> tuple[sparse.csr_matrix, Array]:
    """M and b of one camera in displacements of its own pixels, over the pixels that it still sees."""
    mapping, degree = camera.rig.mapping, case.correlation.spline_degree
    seen = Mesh(mapping.to_image(part.nodes), part.connectivity, part.offsets, part.types)
    deformed = DeformedSubImage(camera.pair.deformed, degree)
    (whole,), = read_correlations([seen], camera.pair.reference, degree)
    visible = whole.without_hidden(deformed, displacement)
    residual = visible.compute_residual(deformed, displacement)
    return visible.assemble_hessian(), visible.assemble_right_hand_side(residual)


def _stiffness(case: Case, part: Mesh) -> sparse.csr_matrix:
    assert case.regularization is not None
    return controlled_stiffness(part, interpolate_cells(part), material(case.regularization),
                                np.ones(part.n_dofs))
