"""The solver part of bench/iterations.py: one partitioned mesh, several cut-off wavelengths and preconditioners.

Argument: JSON with "case", "wavelengths" (px), "kinds" and "dim" (factor of grad f in every second
subdomain). Prints a JSON line per wavelength and preconditioner.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from bench.support.cut_off_problem import (
    TexturedMesh,
    assemble_at,
    assemble_one_domain,
    measure_difference,
    read_texture,
)
from bench.support.step_problem import ALONE, factorize
from ddic.case.schema import Case, RegularizationSection
from ddic.errors import ConvergenceError
from ddic.parallel.field import Field
from ddic.problem.assembly import Assembly
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.dual.preconditioner import Preconditioner
from ddic.solvers.linear_step import StepResult
from ddic.solvers.local_system import LocalOperator

COARSE, FINE = 1e-6, 1e-10
MOST = {"two_level": 300, "scaled": 300, "paper": 500, "none": 1000}
"""Iterations after which a preconditioner is given up: null is recorded, and this number as "more_than"."""

LARGEST_FOR_BOTH = 64
"""Subdomains up to which the two-level solver is set up for COARSE too: beyond, its count is read from the solve to
FINE and the displacement error at COARSE is not known."""


def solutions(matrix: sparse.csr_matrix, right: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The one-domain solution by two factorisations with different orderings."""
    found = []
    for package in ("cholmod", "mumps"):
        options = PETSc.Options()
        options.setValue("local_pc_factor_mat_solver_type", package)
        operator = LocalOperator(matrix, smallest_eigenvalue=0.0, where="whole mesh")
        found.append(operator.solve(right))
        operator.destroy()
        options.delValue("local_pc_factor_mat_solver_type")
    return found


def solve(kind: Preconditioner, tolerance: float, problem: TexturedMesh, assembly: Assembly,
          operators: list[LocalOperator]) -> tuple[StepResult | None, int]:
    """One linear step from zero multipliers and the number of interface unknowns; None where MOST[kind] is exceeded."""
    # Recycling would change what is counted; each solve has a step of its own, for a second would be warm-started.
    settings = DualSettings(kind, tolerance, MOST[kind], recycle=False)
    step = DualStep(ALONE, assembly.systems, operators, assembly.reaction_scale, settings)
    try:
        at_rest = Field.zero(ALONE, problem.subdomains)
        return step.solve(at_rest, at_rest.with_parts(problem.right)), step.n_interface
    except ConvergenceError:
        return None, step.n_interface
    finally:
        step.destroy()


def run(kind: Preconditioner, problem: TexturedMesh, assembly: Assembly, operators: list[LocalOperator],
        reference: NDArray[np.float64]) -> dict[str, Any]:
    """Iterations to COARSE, and differences to the one-domain solution at COARSE and FINE."""
    if kind == "two_level" and len(problem.subdomains) > LARGEST_FOR_BOTH:
        fine, n_interface = solve(kind, FINE, problem, assembly, operators)
        coarse, iterations = None, None if fine is None else _reached(fine)
    else:
        coarse, n_interface = solve(kind, COARSE, problem, assembly, operators)
        iterations = None if coarse is None else coarse.krylov_iterations
        # Plain GMRES is there for comparison of counts; at FINE it would take most of the time of the whole grid.
        skipped = coarse is None or kind == "none"
        fine = None if skipped else solve(kind, FINE, problem, assembly, operators)[0]
    at_coarse, at_fine = (None if found is None else measure_difference(problem, found.dq, reference)
                          for found in (coarse, fine))
    return {"preconditioner": kind, "iterations": iterations, "more_than": MOST[kind] if iterations is None else None,
            "difference_at_1e-6": at_coarse, "relative_difference": at_fine, "n_interface": n_interface}


def _reached(result: StepResult) -> int:
    """Iterations to COARSE: GMRES makes the same iterates whatever tolerance ends them."""
    return int(np.flatnonzero(result.krylov_history <= COARSE)[0])


def main(argument: str) -> None:
    task = json.loads(argument)
    case = Case.model_validate(task["case"])
    problem = read_texture(case).dim(task["dim"])
    for wavelength in task["wavelengths"]:
        section = RegularizationSection(cut_off_wavelength=wavelength)
        assembly = assemble_at(problem, section)
        reference, other = solutions(*assemble_one_domain(problem, section, assembly.eta))
        floor = float(np.linalg.norm(other - reference) / np.linalg.norm(reference))
        operators = factorize(assembly)
        for kind in task["kinds"]:
            record = {"cut_off_wavelength": wavelength, "rounding_floor": floor, "n_dofs": problem.n_unknowns,
                      "n_cells": sum(s.mesh.n_cells for s in problem.subdomains),
                      **run(kind, problem, assembly, operators, reference)}
            print(json.dumps(record), flush=True)
        for operator in operators:
            operator.destroy()


main(sys.argv[1])
