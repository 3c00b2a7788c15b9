"""The solver part of bench/preconditioners.py: error and residual after every GMRES iteration, as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from petsc4py import PETSc

from ddic.case.schema import Case, SolverSection
from ddic.problem.linear_solver import linear_step
from ddic.solvers.dual.dual_step import DualStep

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.step_problem import (
    ALONE,
    distributed_problem,
    dof_multiplicity,
    monolithic_correction,
    whole_problem,
)

KINDS = ("none", "paper", "scaled")


def main(case_json: str) -> None:
    base = json.loads(case_json)
    pair, whole = whole_problem(Case.model_validate(base))
    q = np.zeros(whole.mesh.n_dofs)
    residual = whole.part.correlation.compute_residual(whole.part.deformed, q)
    b = whole.part.correlation.assemble_right_hand_side(residual)
    for kind in KINDS:
        case = Case.model_validate(base)
        solver = SolverSection(subdomains=case.solver.subdomains, preconditioner=kind, tolerance=1e-8,
                               max_iterations=3000)
        problem = distributed_problem(ALONE, case, pair, whole.mesh)
        shared = dof_multiplicity(whole.mesh, problem)
        reference = monolithic_correction(whole, case.regularization, q, b)
        step, n_interface = linear_step(ALONE, solver, problem.assembly, problem.operators)
        assert isinstance(step, DualStep)
        right = [b[d] / shared[d] for d in problem.dofs]
        free = [operator.solve(r) for operator, r in zip(problem.operators, right, strict=True)]
        curve: list[tuple[int, float, float]] = []

        def watch(ksp: PETSc.KSP, iteration: int, norm: float, step=step, free=free, problem=problem, shared=shared,
                  curve=curve, reference=reference) -> None:
            multipliers = ksp.buildSolution()
            dq = step.correction(free, multipliers)
            difference = np.sqrt(sum(((d - reference[n]) ** 2 / shared[n]).sum()
                                     for d, n in zip(dq, problem.dofs, strict=True)))
            curve.append((iteration, norm, float(difference / np.linalg.norm(reference))))

        step.ksp.setMonitor(watch)
        step.solve([q[d] for d in problem.dofs], right)
        step.destroy()
        print(json.dumps({"preconditioner": kind, "n_dofs": whole.mesh.n_dofs, "n_interface": n_interface,
                          "subdomains": case.solver.subdomains, "curve": curve}), flush=True)


main(sys.argv[1])
