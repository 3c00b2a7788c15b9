"""The MPI part of the dual check of ``accept.near_far``: prints a JSON line for each case from rank 0.

Usage: near_far_job TRUTH CASE ...; the linear step begins near the exact solution, not at it.

Its oracle is the saddle point of Eq. 21 of [BP17] with the gap of the whole region, for one linear step, solved
directly; it equals Eq. 23 with the paper's weighting alone. Unknowns are what each camera sees, v_f and v_n = u +
alpha, the multipliers of the jumps between them and alpha, which has no stiffness but its columns in the jumps. The
oracle knows no subdomains and no kinematics.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from ddic.case.loader import load_case
from ddic.case.schema import Case
from ddic.functionals.correlation import read_correlations
from ddic.functionals.regularization import assemble_stiffness
from ddic.images.sub_image import DeformedSubImage
from ddic.inputs.cameras import Camera, Frame
from ddic.inputs.inputs import open_inputs
from ddic.mesh.mesh import Mesh
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.reference_problem import prepare_reference
from ddic.problem.region_mesh import RegionMesh, build_material, build_region_mesh
from ddic.problem.weighted_problem import WeightedProblem
from ddic.synth.truth import load_near_far_truth

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
        gap = rows @ assemble_stiffness(part, build_material(case.regularization, 2))
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


OFF = 1e-2
"""Distance of the beginning from the exact solution, far px: that of a start."""

Correction = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]
"""Of a subdomain: numbers of its field's unknowns, their correction, and that of its camera's motion."""


def solve_dual(team: Team, whole: RegionMesh, frame: Frame, at: State) -> tuple[dict[str, float], list[Correction]]:
    """Solve the linear step by the dual method; collective."""
    clock, inputs = PhaseClock(), whole.inputs
    reference, _ = prepare_reference(team, inputs, whole if team.is_root else None, clock)
    problem = WeightedProblem(team, reference, clock)
    try:
        model = replace(problem.build_residual_model(problem.open_frame(frame)), correction="none")
        q = Field(team, reference.subdomains, [_unknowns(s, at) for s in reference.subdomains])
        b, _ = model.linearize(q)
        solver = problem.solver
        result = solver.step.solve(q, b)
        record = {"eta": solver.assembly.eta, "iterations": result.krylov_iterations,
                  "interface": solver.n_interface, "subdomains": reference.region.n_subdomains}
    finally:
        problem.destroy()
    return record, team.gather_lists([(s.kinematics.numbers, dq[:s.n_field], dq[s.n_field:])
                                      for s, dq in zip(reference.subdomains, result.dq, strict=True)])


def _unknowns(subdomain: Subdomain, at: State) -> NDArray[np.float64]:
    """Unknowns of the field, then those of the camera's motion."""
    field = at.u[subdomain.kinematics.numbers]
    return field if subdomain.motion is None else np.concatenate([field, at.alpha])


def _differences(found: list[Correction], du: NDArray[np.float64], dalpha: NDArray[np.float64]) -> dict[str, float]:
    """Largest difference of the displacements, and of alpha, relative to the largest of the oracle's."""
    displacement = max(float(np.abs(x - du[numbers]).max()) for numbers, x, _ in found)
    motion = max(float(np.abs(a - dalpha).max()) for *_, a in found if len(a))
    return {"relative_difference": displacement / float(np.abs(du).max()),
            "alpha_difference": motion / float(np.abs(dalpha).max())}


def main(truth_file: Path, cases: list[Path]) -> None:
    """Compare the dual step of every case with the saddle point."""
    team = Team(MPI.COMM_WORLD)
    truth = load_near_far_truth(truth_file)
    rng = np.random.default_rng(0)
    for path in cases:
        inputs, frame = open_inputs(team, load_case(path))
        whole = build_region_mesh(inputs)
        u = truth.displacement(whole.mesh.nodes).ravel() + OFF * rng.normal(size=whole.mesh.n_dofs)
        at = State(u, np.array(truth.motion.alpha) + OFF)
        record, found = solve_dual(team, whole, frame, at)
        if team.is_root:
            du, dalpha = solve_saddle_point(whole, frame, record["eta"], at)
            print(json.dumps({"case": path.stem, "ranks": team.size, **record, **_differences(found, du, dalpha)}),
                  flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
