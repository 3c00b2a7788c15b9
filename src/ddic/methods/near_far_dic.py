"""Near-field and far-field images in one measurement: section 4 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.functionals.correlation import GreyCorrection, Residual
from ddic.io.result_reader import read_result
from ddic.kinematics.pose import Pose
from ddic.mesh.mesh import Mesh
from ddic.methods.dd_dic import Measurement, refuse_inverted_cells, setting_of, tolerances_of
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import SINGULAR, assemble, seen_parts
from ddic.problem.cameras import Camera, open_shared_cameras
from ddic.problem.inputs import hand_out
from ddic.problem.linear_solver import linear_solver
from ddic.problem.mesh_source import build_meshes
from ddic.problem.near_far_parts import (
    NearFarMesh,
    as_only_camera,
    cut_by_camera,
    in_unknowns,
    moving,
    own_camera_only,
    own_views,
)
from ddic.problem.setup_motion import covariance, setup_motions, start_of_motion
from ddic.problem.thread_note import thread_note
from ddic.results.listener import Listener
from ddic.solvers.dual.continuity import ContinuousField, average_copies
from ddic.solvers.gauss_newton import GreyState, OwnedPart, evaluate, gain_and_offset, gauss_newton
from ddic.solvers.local_system import LocalSystem
from ddic.start.coarse_field import coarse_field, coarse_task
from ddic.start.independent import independent_start

OWN, OTHERS = slice(0, 1), slice(1, None)
"""A subdomain's views by its own camera and by others."""

SMALLEST_NOISE = 0.29
"""Grey levels, the rounding of a camera that gives whole ones: no estimate is below it."""


def near_far_dic(team: Team, case: Case, listener: Listener, clock: PhaseClock) -> Measurement:
    """Measure one displacement field, and how the near set-ups moved, from the images of several cameras.

    Raises InputError, SingularSubdomainError, ConvergenceError on all ranks.
    """
    correction = case.correlation.grey_correction
    with clock.phase(Phase.MESH):
        cameras = open_shared_cameras(team, case)
        cut = _cut(team, case, cameras)
    with clock.phase(Phase.START):
        subdomains, region = hand_out(team, None if cut is None else cut.whole)
        shared: NDArray[np.int64] = team.on_root(lambda: _known(cut).shared)
    with clock.phase(Phase.READ):
        parts = team.together(lambda: own_views(case, cameras, subdomains))
        n_pixels = sum(team.gather_lists([v.correlation.n_usable_pixels for p in parts for v in p.views]))
    with clock.phase(Phase.START):
        u, notes = _coarse_start(team, case, cameras, None if cut is None else cut.meshes, parts)
        parts = team.together(lambda: seen_parts(parts, u, OWN))
    with clock.phase(Phase.ASSEMBLE):
        own = team.together(lambda: [[v.correlation.hessian() for v in p.views[OWN]] for p in parts])
    with clock.phase(Phase.INDEPENDENT_START):
        u, kept = _independently(team, case, parts, own, u)
        motion = start_of_motion(team, cameras, parts, u, shared)
        noise = _noise(team, cameras, parts, u, case)
    with clock.phase(Phase.ASSEMBLE):
        weights = [(noise[0] / sigma) ** 2 for sigma in noise]
        parts = [moving(p, cameras, weights) for p in parts]
        q = [_with_motion(p, u_s, motion[p.subdomain.camera]) for p, u_s in zip(parts, u, strict=True)]
        # What the far camera sees under a near field depends on how the near set-up moved.
        parts = team.together(lambda: seen_parts(parts, q, OTHERS))
        hessians = team.together(lambda: [in_unknowns(p, [*m, *(v.correlation.hessian() for v in p.views[OTHERS])])
                                          for p, m in zip(parts, own, strict=True)])
        assembly = assemble(team, parts, hessians, region, case.solver, case.regularization)
    notes = (*notes, *kept, *_noise_notes(cameras, noise), *thread_note(team, case.solver.threads))
    for line in notes:
        listener.note(line)
    with linear_solver(team, case, assembly, clock) as (step, n_interface):
        setting = setting_of(team, region, parts, n_pixels, n_interface, assembly.eta)
        listener.setting(setting)
        solution = gauss_newton(team, parts, q, step, correction, tolerances_of(case), listener.iteration, clock,
                                len(cameras))
        with clock.phase(Phase.FINISH):
            spread = covariance(team, parts, assembly.systems, step, noise[0])
    with clock.phase(Phase.FINISH):
        field = average_copies(team.comm, [part.subdomain for part in parts], solution.q)
        residuals, grey = evaluate(team, parts, field.q, correction, len(cameras))
        motions = setup_motions(cameras, _motions(team, cameras, parts, field.q), spread)
        displacements = ContinuousField([p.subdomain.on_mesh(v[:p.n_dofs])
                                         for v, p in zip(field.q, parts, strict=True)], field.largest_jump)
        refuse_inverted_cells(team, parts, displacements)
    return Measurement(region, tuple(c.pair for c in cameras), list(parts), displacements, field.q, residuals, grey,
                       setting, solution.records, notes, motions, tuple(noise))


def _known(cut: NearFarMesh | None) -> NearFarMesh:
    assert cut is not None
    return cut


def _cut(team: Team, case: Case, cameras: Sequence[Camera]) -> NearFarMesh | None:
    """The whole mesh, cut, on rank 0, nothing elsewhere; an error there is raised on all ranks."""
    held: list[NearFarMesh] = []

    def make() -> None:
        image = cameras[0].pair.reference.image
        mesh, tying = build_meshes(case, image.width, image.height)
        held.append(cut_by_camera(case, mesh, cameras, team.size, tying))

    team.on_root(make)
    return held[0] if held else None


def _coarse_start(team: Team, case: Case, cameras: Sequence[Camera], meshes: Sequence[Mesh] | None,
                  parts: Sequence[OwnedPart]) -> tuple[list[NDArray[np.float64]], tuple[str, ...]]:
    """Displacement of each subdomain as if no set-up had moved, from its own camera alone (n_dofs,), and notes."""
    u = [np.zeros(part.n_dofs) for part in parts]
    notes: list[str] = []
    for number, camera in enumerate(cameras):
        own = [k for k, part in enumerate(parts) if part.subdomain.camera == number]
        if case.start.from_result is not None:
            nodes = [parts[k].subdomain.nodes for k in own]
            start = coarse_field(team, case, None, nodes)
            moved = team.on_root(partial(_stored_motion, case, number))
            for k, q in zip(own, start.q, strict=True):
                rig, x = camera.rig, parts[k].subdomain.nodes
                shift = (moved * [1.0, 1.0, rig.length])[:rig.n_shifts]
                u[k] = (rig.moved(x + q.reshape(-1, 2), shift) - x).ravel()
        else:
            task = coarse_task(team, case, camera.pair, None if meshes is None else meshes[number])
            found = team.together(task)
            start = coarse_field(team, case, found, [_placed(parts[k]).image_nodes for k in own])
            for k, v in zip(own, start.q, strict=True):
                u[k] = _placed(parts[k]).unknowns(v, np.zeros(0))
        notes += [f"{'far field' if number == 0 else f'near field {number}'}, {line}" for line in start.notes]
    return u, tuple(notes)


def _placed(part: OwnedPart) -> Pose:
    assert part.view.pose is not None
    return part.view.pose


def _stored_motion(case: Case, number: int) -> NDArray[np.float64]:
    """Motion alpha and theta of a set-up in an earlier result, (3,), px and radians; zeros for the far camera."""
    assert case.start.from_result is not None
    if number == 0:
        return np.zeros(3)
    stored = read_result(case.start.from_result).attributes.get(f"near_{number}", {})
    if "alpha_px" not in stored:
        raise InputError(f"start.from_result: {case.start.from_result} holds no motion of near field {number}; give a "
                         "result of the same near-field images")
    return np.array([*stored["alpha_px"], float(stored["theta_rad"])])


def _independently(team: Team, case: Case, parts: Sequence[OwnedPart],
                   matrices: Sequence[Sequence[sparse.csr_matrix]], u: Sequence[NDArray[np.float64]],
                   ) -> tuple[list[NDArray[np.float64]], tuple[str, ...]]:
    """FE-DIC on every subdomain by its own camera, set-ups still; and a note."""
    if not case.start.independent:
        return list(u), ()
    alone = [as_only_camera(part) for part in parts]
    hessians = [part.view.in_unknowns(m[0]) for part, m in zip(alone, matrices, strict=True)]
    systems = [LocalSystem(p.subdomain, h, None, np.zeros(0), 0.0) for p, h in zip(alone, hessians, strict=True)]
    sums = team.gather_lists([(p.subdomain.camera, float(h.diagonal().mean()))
                              for p, h in zip(alone, hessians, strict=True)])
    mean = {camera: np.mean([m for c, m in sums if c == camera]) for camera, _ in sums}
    refined, kept = [], []
    for part, system, u_s in zip(alone, systems, u, strict=True):
        found = independent_start([part], [system], [u_s], SINGULAR * float(mean[part.subdomain.camera]),
                                  case.correlation.grey_correction)
        refined += found.q
        kept += found.kept
    n_kept = len(team.gather_lists(kept))
    note = "start: independent FE-DIC on every subdomain"
    return refined, (note + (f"; {n_kept} kept the coarse field" if n_kept else ""),)


def _noise(team: Team, cameras: Sequence[Camera], parts: Sequence[OwnedPart], u: Sequence[NDArray[np.float64]],
           case: Case) -> list[float]:
    """Standard deviation of each camera's noise, grey levels: given, or that of its residual over sqrt(2).

    Of a camera's subdomains the one in the middle counts: some may not have been measured well by themselves.
    """
    correction = case.correlation.grey_correction
    alone = [own_camera_only(part) for part in parts]
    residuals, grey = evaluate(team, alone, u, correction, len(cameras))
    found = team.gather_lists([
        (p.subdomain.camera, _deviation(r[0], grey[p.subdomain.camera], correction))
        for p, r in zip(alone, residuals, strict=True)])
    return [max(float(np.median([std for number, std in found if number == k])) / np.sqrt(2), SMALLEST_NOISE)
            if camera.noise is None else camera.noise for k, camera in enumerate(cameras)]


def _deviation(residual: Residual, state: GreyState, correction: GreyCorrection) -> float:
    """Standard deviation of a subdomain's residual, grey levels."""
    first, second = residual.cell_sums.residual(*gain_and_offset(residual, state, correction))
    n = max(float(residual.sums.n_pixels), 1.0)
    return float(np.sqrt(max(second.sum() / n - (first.sum() / n) ** 2, 0.0)))


def _noise_notes(cameras: Sequence[Camera], noise: Sequence[float]) -> list[str]:
    return [f"{'far field' if k == 0 else f'near field {k}'}: noise of {sigma:.2f} grey levels "
            f"({'estimated from the residual' if camera.noise is None else 'given'})"
            for k, (camera, sigma) in enumerate(zip(cameras, noise, strict=True))]


def _with_motion(part: OwnedPart, u: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unknowns of a part from what its own camera saw as if its set-up were still, and the motion of that."""
    if part.subdomain.shifts is None:
        return u
    placed = _placed(part)
    return np.concatenate([placed.unknowns(placed.displacement(np.concatenate([u, np.zeros_like(motion)])), motion),
                           motion])


def _motions(team: Team, cameras: Sequence[Camera], parts: Sequence[OwnedPart],
             q: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Unknowns of each camera's motion, (n_shifts,), on all ranks; collective."""
    mine = [(p.subdomain.camera, v[p.n_dofs:]) for p, v in zip(parts, q, strict=True)]
    found = dict(team.gather_lists(mine))
    return [found.get(number, np.zeros(camera.rig.n_shifts)) for number, camera in enumerate(cameras)]
