"""The MPI part of the dual check of ``accept.near_far``: prints a JSON line for each case from rank 0.

Usage: near_far_job TRUTH CASE ...; the linear step begins near the exact solution, not at it.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from accept.support.near_far_oracle import State, solve_saddle_point
from ddic.case.loader import load_case
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import open_inputs
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.reference_problem import prepare_reference
from ddic.problem.region_mesh import RegionMesh, build_region_mesh
from ddic.problem.weighted_problem import WeightedProblem
from ddic.synth.truth import load_near_far_truth

OFF = 1e-2
"""Distance of the beginning from the exact solution, far px: that of a start."""

Correction = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]
"""Of a subdomain: numbers of its field's unknowns, their correction, and that of its camera's motion."""


def solve_dual(team: Team, whole: RegionMesh, frame: Frame, at: State) -> tuple[dict[str, float], list[Correction]]:
    """Solve the linear step by the dual method; collective.

    Parameters
    ----------
    team : Team
        Ranks.
    whole : RegionMesh
        The whole mesh.
    frame : Frame
        Deformed images.
    at : State
        Where the step begins.

    Returns
    -------
    record : dict
        Sizes, and eta.
    corrections : list of Correction
        Of all subdomains, on all ranks.
    """
    clock, inputs = PhaseClock(), whole.inputs
    reference, _ = prepare_reference(team, inputs, whole if team.is_root else None, clock, lambda: None)
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
    """Compare the dual step of every case with the saddle point.

    Parameters
    ----------
    truth_file : Path
        What ``ddic synth near-far`` wrote.
    cases : list of Path
        Case files that give the cameras' noise.
    """
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


main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
