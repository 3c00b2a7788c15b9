"""The solver part of ``accept.preconditioners``: error and residual after every GMRES iteration, as JSON.

Usage: preconditioner_job CASE, a JSON object with the sections of a case; prints a line for each preconditioner.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from petsc4py import PETSc

from bench.support.step_problem import (
    ALONE,
    StepProblem,
    Vector,
    correct_monolithically,
    factorize,
    prepare_step,
    prepare_whole,
)
from ddic.case.schema import Case
from ddic.parallel.field import Field
from ddic.solvers.dual.dual_problem import DualProblem
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.dual.preconditioner import Preconditioner

KINDS: tuple[Preconditioner, ...] = ("none", "paper", "scaled")
TOLERANCE, MOST_ITERATIONS = 1e-8, 3000
"""Of GMRES."""

Curve = list[tuple[int, float, float]]
"""Iteration, residual norm and displacement error relative to the one-domain correction."""


def error_curve(kind: Preconditioner, problem: StepProblem, b: Vector, reference: Vector) -> tuple[Curve, int]:
    """Solve the first linear step of a case and look at every iterate.

    Parameters
    ----------
    kind : Preconditioner
        solver.preconditioner.
    problem : StepProblem
        The subdomains.
    b : (n_field,) array
        Right-hand side of the whole mesh.
    reference : (n_field,) array
        Correction of one domain, pixels.

    Returns
    -------
    curve : list
        Of all iterations.
    n_interface : int
        Number of interface unknowns.
    """
    assembly = problem.assemble()
    operators = factorize(assembly)
    scale = assembly.reaction_scale
    step = DualStep(ALONE, assembly.systems, operators, scale, DualSettings(kind, TOLERANCE, MOST_ITERATIONS))
    # The step keeps its own to itself; what multipliers correct is the same.
    interface = DualProblem(ALONE, assembly.systems, operators, scale)
    shared = problem.count_subdomains()
    at_rest = Field.zero(ALONE, [system.subdomain for system in assembly.systems])
    right = at_rest.with_parts(b[n] / shared[n] for n in problem.numbers)
    free = at_rest.with_parts(operator.solve(r) for operator, r in zip(operators, right, strict=True))
    curve: Curve = []

    def watch(ksp: PETSc.KSP, iteration: int, norm: float) -> None:
        dq = interface.correct(free, ksp.buildSolution())
        squares = sum(((d - reference[n]) ** 2 / shared[n]).sum() for d, n in zip(dq, problem.numbers, strict=True))
        curve.append((iteration, norm, float(np.sqrt(squares) / np.linalg.norm(reference))))

    step.ksp.setMonitor(watch)
    step.solve(at_rest, right)
    n_interface = step.n_interface
    step.destroy()
    interface.destroy()
    for operator in operators:
        operator.destroy()
    return curve, n_interface


def main(case_json: str) -> None:
    """Print a curve for each preconditioner.

    Parameters
    ----------
    case_json : str
        Of the command line.
    """
    case = Case.model_validate(json.loads(case_json))
    whole = prepare_whole(case)
    q = np.zeros(whole.region.n_field)
    (b,) = whole.right_hand_sides([q])
    reference = correct_monolithically(whole, q, b)
    problem = prepare_step(ALONE, case)
    for kind in KINDS:
        curve, n_interface = error_curve(kind, problem, b, reference)
        print(json.dumps({"preconditioner": kind, "n_dofs": whole.region.n_field, "n_interface": n_interface,
                          "subdomains": problem.region.n_subdomains, "curve": curve}), flush=True)


main(sys.argv[1])
