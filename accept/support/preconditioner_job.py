"""The solver part of ``accept.preconditioners``: error and residual after every GMRES iteration, as JSON.

Usage: preconditioner_job CASE, a JSON object with the sections of a case; prints a line for each preconditioner.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from bench.support.step_problem import (
    ALONE,
    Vector,
    correct_monolithically,
    distribute_problem,
    whole_problem,
)
from petsc4py import PETSc

from ddic.case.schema import Case, SolverSection
from ddic.problem.linear_solver import linear_step
from ddic.solvers.dual.dual_step import DualStep

KINDS = ("none", "paper", "scaled")
TOLERANCE, MOST_ITERATIONS = 1e-8, 3000
"""Of GMRES."""

Curve = list[tuple[int, float, float]]
"""Iteration, residual norm and displacement error relative to the one-domain correction."""


def error_curve(kind: str, base: dict[str, Any], b: Vector, reference: Vector) -> tuple[Curve, int]:
    """Solve the first linear step of a case and look at every iterate.

    Parameters
    ----------
    kind : str
        solver.preconditioner.
    base : dict
        Sections of the case.
    b : (n_dofs,) array
        Right-hand side of the whole mesh.
    reference : (n_dofs,) array
        Correction of one domain, pixels.

    Returns
    -------
    curve : list
        Of all iterations.
    n_interface : int
        Number of interface unknowns.
    """
    case = Case.model_validate(base)
    pair, whole = whole_problem(case)
    problem = distribute_problem(ALONE, case, pair, whole.mesh)
    shared = problem.count_subdomains(whole.mesh)
    solver = SolverSection(subdomains=case.solver.subdomains, preconditioner=kind, tolerance=TOLERANCE,
                           max_iterations=MOST_ITERATIONS)
    step, n_interface = linear_step(ALONE, solver, problem.assembly, problem.operators)
    if not isinstance(step, DualStep):
        raise TypeError("the case does not ask for the dual method")
    right = [b[d] / shared[d] for d in problem.dofs]
    free = [operator.solve(r) for operator, r in zip(problem.operators, right, strict=True)]
    curve: Curve = []

    def watch(ksp: PETSc.KSP, iteration: int, norm: float) -> None:
        dq = step.correction(free, ksp.buildSolution())
        squares = sum(((d - reference[n]) ** 2 / shared[n]).sum() for d, n in zip(dq, problem.dofs, strict=True))
        curve.append((iteration, norm, float(np.sqrt(squares) / np.linalg.norm(reference))))

    step.ksp.setMonitor(watch)
    step.solve([np.zeros(len(r)) for r in right], right)
    step.destroy()
    problem.destroy()
    return curve, n_interface


def main(case_json: str) -> None:
    """Print a curve for each preconditioner.

    Parameters
    ----------
    case_json : str
        Of the command line.
    """
    base = json.loads(case_json)
    case = Case.model_validate(base)
    _, whole = whole_problem(case)
    q = np.zeros(whole.mesh.n_dofs)
    b = whole.right_hand_side(q)
    reference = correct_monolithically(whole, case.regularization, q, b)
    for kind in KINDS:
        curve, n_interface = error_curve(kind, base, b, reference)
        print(json.dumps({"preconditioner": kind, "n_dofs": whole.mesh.n_dofs, "n_interface": n_interface,
                          "subdomains": case.solver.subdomains, "curve": curve}), flush=True)


main(sys.argv[1])
