"""The solver part of bench/iterations.py: one cell of the grid, a JSON line per preconditioner."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.case.schema import Case, SolverSection
from ddic.methods.dd_dic import linear_step
from ddic.solvers.local_operator import LocalOperator

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.step_problem import (
    ALONE,
    Whole,
    distributed_problem,
    dof_multiplicity,
    whole_problem,
)

KINDS = ("two_level", "scaled", "paper", "none")
LARGEST_FOR_PLAIN = 64
"""Subdomains up to which the one-level and plain solvers are run too: beyond they only take time."""


def solutions(whole: Whole, right: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The one-domain solution by two factorisations with different orderings."""
    found = []
    for package in ("cholmod", "mumps"):
        options = PETSc.Options()
        options.setValue("local_pc_factor_mat_solver_type", package)
        operator = LocalOperator(whole.assembly.systems[0].operator, smallest_eigenvalue=0.0, where="whole mesh")
        found.append(operator.solve(right))
        operator.destroy()
        options.delValue("local_pc_factor_mat_solver_type")
    return found


def main(case_json: str) -> None:
    base = json.loads(case_json)
    case = Case.model_validate(base)
    pair, whole = whole_problem(case)
    residual = whole.part.correlation.residual(whole.part.deformed, np.zeros(whole.mesh.n_dofs))
    b = whole.part.correlation.right_hand_side(residual)
    reference, other = solutions(whole, b)
    floor = float(np.linalg.norm(other - reference) / np.linalg.norm(reference))
    problem = distributed_problem(ALONE, case, pair, whole.mesh)
    shared = dof_multiplicity(whole.mesh, problem)
    right = [b[d] / shared[d] for d in problem.dofs]
    zero = [np.zeros(len(d)) for d in problem.dofs]
    for kind in KINDS:
        if kind in ("paper", "none") and len(problem.parts) > LARGEST_FOR_PLAIN:
            continue
        found = {}
        for tolerance in (1e-6, 1e-10):
            solver = SolverSection(subdomains=len(problem.parts), preconditioner=kind, tolerance=tolerance,
                                   max_iterations=5000)
            step, n_interface = linear_step(ALONE, solver, problem.assembly, problem.operators)
            found[tolerance] = step.solve(zero, right)
            step.destroy()
            if kind != "two_level":
                break
        finest = found[min(found)]
        difference = np.sqrt(sum(((d - reference[n]) ** 2 / shared[n]).sum()
                                 for d, n in zip(finest.dq, problem.dofs, strict=True)))
        print(json.dumps({"preconditioner": kind, "iterations": found[1e-6].krylov_iterations,
                          "relative_difference": float(difference / np.linalg.norm(reference)),
                          "difference_at_tolerance": min(found), "rounding_floor": floor,
                          "n_dofs": whole.mesh.n_dofs, "n_interface": n_interface}), flush=True)


main(sys.argv[1])
