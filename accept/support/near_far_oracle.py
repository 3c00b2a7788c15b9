"""The saddle point of Eq. 21 of [BP17] with the gap of the whole region, for one linear step of a near and far case.

Solved directly; it equals Eq. 23 with the paper's weighting alone.

Unknowns are what each camera sees, v_f and v_n = u + alpha, the multipliers of the jumps between them and alpha, which
has no stiffness but its columns in the jumps. Nothing here knows subdomains, or kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from ddic.case.schema import Case
from ddic.functionals.correlation import read_correlations
from ddic.functionals.regularization import assemble_stiffness
from ddic.images.sub_image import DeformedSubImage
from ddic.inputs.cameras import Camera, Frame
from ddic.mesh.mesh import Mesh
from ddic.problem.region_mesh import RegionMesh, build_material

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """Where a linear step begins.

    Attributes
    ----------
    u : (n_dofs,) array
        A continuous displacement, far px.
    alpha : (2,) array
        Translation of the near set-up, far px.
    """

    u: Array
    alpha: Array


@dataclass(frozen=True)
class OneCamera:
    """What one camera brings, in far px.

    Attributes
    ----------
    dofs : (n,) array of int64
        Numbers of its displacements in the whole mesh.
    hessian : (n, n) csr_matrix
        M, weighted.
    force : (n,) array
        b, weighted.
    gap : (n_dofs, n) csr_matrix
        Its cells' forces on the whole mesh; zero without regularization.
    seen : (n,) array
        Its displacement at the beginning of the step.
    """

    dofs: NDArray[np.int64]
    hessian: sparse.csr_matrix
    force: Array
    gap: sparse.csr_matrix
    seen: Array


def solve_saddle_point(whole: RegionMesh, frame: Frame, eta: float, at: State) -> tuple[Array, Array]:
    """Solve the linear step of a far and a near camera, whose mapping is a similarity without rotation.

    Parameters
    ----------
    whole : RegionMesh
        The whole mesh, and which camera measures which cell.
    frame : Frame
        Deformed images.
    eta : float
        Weight of the equilibrium gap; 0 without.
    at : State
        Where the step begins.

    Returns
    -------
    du : (n_dofs,) array
        Correction of the displacement, far px.
    dalpha : (2,) array
        Correction of the near set-up's translation, far px.
    """
    far, near = (_look(whole, frame, number, at) for number in range(2))
    operator, right = _operator(whole, eta, (far, near))
    jumps, of_alpha = _jump_rows(far, near)
    n, n_jumps, size = len(right), jumps.shape[0], float(operator.diagonal().mean())
    # Divided by its mean diagonal, the operator is of the size of the jumps.
    saddle = sparse.bmat([[operator / size, None, jumps.T],
                          [None, None, of_alpha.T],
                          [jumps, of_alpha, None]]).tocsc()
    solution = splu(saddle).solve(np.concatenate([right / size, np.zeros(2 + n_jumps)]))
    n_far = len(far.dofs)
    alpha = solution[n:n + 2]
    du = np.zeros(whole.mesh.n_dofs)
    du[near.dofs] = solution[n_far:n] - np.tile(alpha, len(near.dofs) // 2)
    du[far.dofs] = solution[:n_far]
    return du, alpha


def _look(whole: RegionMesh, frame: Frame, number: int, at: State) -> OneCamera:
    """What a camera brings."""
    case, mesh = whole.inputs.case, whole.mesh
    far, camera = whole.inputs.cameras[0], whole.inputs.cameras[number]
    part, ids = mesh.create_submesh(np.flatnonzero(whole.cameras == number))
    dofs = (2 * ids[:, None] + np.arange(2)).ravel()
    seen = at.u[dofs] + (np.tile(at.alpha, len(ids)) if number else 0.0)
    ratio = float(camera.setup.mapping.homography[0, 0])
    hessian, force = _texture(case, camera, DeformedSubImage(frame[number], case.correlation.spline_degree), part,
                              ratio * seen)
    weight = 1.0
    if far.noise is not None and camera.noise is not None:
        weight = (far.noise / camera.noise) ** 2
    gap = sparse.csr_matrix((mesh.n_dofs, len(dofs)))
    if case.regularization is not None:
        rows = sparse.csr_matrix((np.ones(len(dofs)), (dofs, np.arange(len(dofs)))), shape=(mesh.n_dofs, len(dofs)))
        gap = rows @ assemble_stiffness(part, build_material(case.regularization))
    return OneCamera(dofs, weight * ratio**2 * hessian, weight * ratio * force, gap, seen)


def _texture(case: Case, camera: Camera, deformed: DeformedSubImage, part: Mesh,
             displacement: Array) -> tuple[sparse.csr_matrix, Array]:
    """M of all pixels and b of those that the camera still sees, in displacements of its own pixels."""
    seen = Mesh(camera.setup.mapping.to_image(part.nodes), part.connectivity, part.offsets, part.types)
    (correlation,), = read_correlations([seen], camera.reference, case.correlation.spline_degree)
    residual = correlation.compute_residual(deformed, displacement)
    return correlation.assemble_hessian(), correlation.assemble_right_hand_side(residual)


def _operator(whole: RegionMesh, eta: float, cameras: tuple[OneCamera, OneCamera]) -> tuple[sparse.csr_matrix, Array]:
    """M + eta Kbar^T Kbar and b - eta Kbar^T Kbar v of both cameras' displacements."""
    control = sparse.diags(np.where(whole.controlled, 1.0, _edge_weight(whole.inputs.case)))
    gap = control @ sparse.hstack([camera.gap for camera in cameras])
    gap_now = gap @ np.concatenate([camera.seen for camera in cameras])
    operator = sparse.block_diag([camera.hessian for camera in cameras]) + eta * gap.T @ gap
    right = np.concatenate([camera.force for camera in cameras]) - eta * gap.T @ gap_now
    return operator, right


def _edge_weight(case: Case) -> float:
    """Weight of rows that are not controlled: eta grows as the wavelength's fourth power, and rows enter squared."""
    section = case.regularization
    if section is None or section.cut_off_wavelength is None:
        return 0.0
    return min(1.0, (section.edge_wavelength / section.cut_off_wavelength) ** 2)


def _jump_rows(far: OneCamera, near: OneCamera) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Rows v_n - v_f of the displacements that both cameras see, and their columns -1 of alpha."""
    _, in_far, in_near = np.intersect1d(far.dofs, near.dofs, return_indices=True)
    n_far, n_jumps = len(far.dofs), len(in_far)
    row = np.arange(n_jumps)
    places = (np.tile(row, 2), np.concatenate([n_far + in_near, in_far]))
    signs = np.repeat([1.0, -1.0], n_jumps)
    jumps = sparse.csr_matrix((signs, places), shape=(n_jumps, n_far + len(near.dofs)))
    component = near.dofs[in_near] % 2
    of_alpha = sparse.csr_matrix((np.full(n_jumps, -1.0), (row, component)), shape=(n_jumps, 2))
    return jumps, of_alpha
