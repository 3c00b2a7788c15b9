"""The MPI part of the dual check of bench/accept_near_far.py: prints one JSON line a case from rank 0.

Usage: near_far_job.py TRUTH CASE ...; the linear step begins near the exact solution, not at it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from accept.support.near_far_oracle import State, saddle_point
from ddic.case.loader import load_case
from ddic.case.schema import Case
from ddic.mesh.mesh import Mesh
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import assemble, seen_parts
from ddic.problem.cameras import Camera, measured_by, open_shared_cameras
from ddic.problem.inputs import hand_out
from ddic.problem.linear_solver import linear_solver
from ddic.problem.mesh_source import build_mesh
from ddic.problem.near_far_parts import cut_by_camera, in_unknowns, moving, own_views
from ddic.synth.near_far_truth import load_near_far_truth

OFF = 1e-2
"""Distance of the beginning from the exact solution, far px: that of a start."""

Found = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]


def main(truth_file: Path, cases: list[Path]) -> None:
    team = Team(MPI.COMM_WORLD)
    truth = load_near_far_truth(truth_file)
    rng = np.random.default_rng(0)
    for path in cases:
        case = load_case(path).case
        cameras = open_shared_cameras(team, case)
        image = cameras[0].pair.reference.image
        mesh = build_mesh(case, image.width, image.height)
        u = truth.displacement(mesh.nodes).ravel() + OFF * rng.normal(size=mesh.n_dofs)
        at = State(u, np.array(truth.motion.alpha) + OFF)
        record, found = _dual(team, case, cameras, mesh, at)
        if team.is_root:
            labels = measured_by(case, cameras, mesh)
            du, dalpha = saddle_point(case, mesh, cameras, labels, _weights(cameras), record["eta"], at)
            print(json.dumps({"case": path.stem, "ranks": team.size, **record, **_differences(found, du, dalpha)}),
                  flush=True)


def _weights(cameras: tuple[Camera, ...]) -> list[float]:
    assert cameras[0].noise is not None
    return [(cameras[0].noise / c.noise) ** 2 for c in cameras if c.noise is not None]


def _dual(team: Team, case: Case, cameras: tuple[Camera, ...], mesh: Mesh,
          at: State) -> tuple[dict[str, float], list[Found]]:
    """The step by the dual method; on rank 0 also dofs, correction and dalpha of every subdomain."""
    cut = cut_by_camera(case, mesh, cameras, team.size)
    subdomains, region = hand_out(team, cut.whole if team.is_root else None)
    still = [at.u[s.dofs] + (np.tile(at.alpha, s.mesh.n_nodes) if s.camera else 0.0) for s in subdomains]
    parts = seen_parts(own_views(case, cameras, subdomains), still)
    matrices = [[view.correlation.assemble_hessian() for view in part.views] for part in parts]
    parts = [moving(part, cameras, _weights(cameras)) for part in parts]
    q = [np.concatenate([at.u[s.dofs], at.alpha]) if s.camera else at.u[s.dofs] for s in subdomains]
    hessians = [in_unknowns(p, m) for p, m in zip(parts, matrices, strict=True)]
    assembly = assemble(team, parts, hessians, region, case.solver, case.regularization)
    b = [sum(v.right_hand_side(v.residual(q_s)) for v in p.views) for p, q_s in zip(parts, q, strict=True)]
    with linear_solver(team, case, assembly, PhaseClock()) as (step, n_interface):
        result = step.solve(q, b)
    found = team.gather_lists([(s.dofs, x[:s.mesh.n_dofs], x[s.mesh.n_dofs:])
                               for s, x in zip(subdomains, result.dq, strict=True)])
    return {"eta": assembly.eta, "iterations": result.krylov_iterations, "interface": n_interface,
            "subdomains": region.n_subdomains}, found


def _differences(found: list[Found], du: NDArray[np.float64], dalpha: NDArray[np.float64]) -> dict[str, float]:
    """Largest difference of the displacements, and of alpha, relative to the largest of the oracle's."""
    displacement = max(float(np.abs(x - du[dofs]).max()) for dofs, x, _ in found)
    motion = max(float(np.abs(a - dalpha).max()) for *_, a in found if len(a))
    return {"relative_difference": displacement / float(np.abs(du).max()),
            "alpha_difference": motion / float(np.abs(dalpha).max())}


main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
