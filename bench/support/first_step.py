"""The first linear step of a case, cut into subdomains and on one domain: what each iterate of GMRES leaves of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from ddic.problem.assembly import Assembly
from ddic.solvers.dual.dual_problem import DualProblem
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.local_system import LocalOperator
from ddic.synth.fields import DisplacementField

Curve = list[tuple[int, float, float]]
"""Iteration, residual relative to that without multipliers, and displacement error to the one-domain correction."""


@dataclass(frozen=True)
class FirstStep:
    """A linear step on this rank alone.

    Attributes
    ----------
    problem : StepProblem
        The subdomains.
    assembly : Assembly
        Their systems.
    operators : list of LocalOperator
        Their A_s factorised, to be destroyed.
    q, b : Field
        Where Gauss-Newton stands, pixels, and shares of the subdomains in the right-hand side.
    reference : (n_field,) array
        Correction of one domain, pixels.
    """

    problem: StepProblem
    assembly: Assembly
    operators: list[LocalOperator]
    q: Field
    b: Field
    reference: Vector

    def create_step(self, settings: DualSettings) -> DualStep:
        """Create the solver of the interface problem, to be destroyed."""
        return DualStep(ALONE, self.assembly.systems, self.operators, self.assembly.reaction_scale, settings)

    def create_interface(self) -> DualProblem:
        """Create the interface problem alone, to be destroyed; factors stay this object's."""
        return DualProblem(ALONE, self.assembly.systems, self.operators, self.assembly.reaction_scale)

    def measure_error(self, dq: Field) -> float:
        """Measure the distance of corrections from that of one domain, each unknown once, relative to its norm."""
        shared = self.problem.count_subdomains()
        squares = sum(float(((dq_s - self.reference[n]) ** 2 / shared[n]).sum())
                      for dq_s, n in zip(dq, self.problem.numbers, strict=True))
        return float(np.sqrt(squares) / np.linalg.norm(self.reference))

    def solve_alone(self) -> Field:
        """Solve A_s dq_s = b_s - eta Kbar_s^T Kbar_s q_s of each subdomain by itself, without multipliers."""
        return self.b.with_parts(
            operator.solve(system.right_hand_side(b_s, q_s)) for system, operator, q_s, b_s
            in zip(self.assembly.systems, self.operators, self.q, self.b, strict=True))

    def destroy(self) -> None:
        """Free the factors."""
        for operator in self.operators:
            operator.destroy()


NEARLY = 0.99
"""Share of the exact displacement from which a step starts; a larger value leaves it less to correct."""


def prepare_first_step(case: Case, exact: DisplacementField | None = None) -> FirstStep:
    """Prepare the linear step of a case from nearly the exact displacement or, without that, from rest."""
    whole = prepare_whole(case)
    (subdomain,) = whole.subdomains
    q = np.zeros(whole.region.n_field)
    if exact is not None:
        q = NEARLY * exact.displacement(subdomain.mesh.nodes).ravel()
    (b,) = whole.right_hand_sides([q])
    reference = correct_monolithically(whole, q, b)
    problem = prepare_step(ALONE, case)
    assembly = problem.assemble()
    shared = problem.count_subdomains()
    parts = Field(ALONE, [system.subdomain for system in assembly.systems], [q[n] for n in problem.numbers])
    shares = parts.with_parts(b[n] / shared[n] for n in problem.numbers)
    return FirstStep(problem, assembly, factorize(assembly), parts, shares, reference)


def find_error_curve(first: FirstStep, settings: DualSettings, every: int = 1) -> tuple[Curve, int]:
    """Solve a linear step and look at every so manieth iterate; the number of interface unknowns comes as well.

    Not with a coarse space, whose part of the multipliers is found before the first iteration.
    """
    step = first.create_step(settings)
    # The step keeps its own to itself; what multipliers correct is the same.
    interface = first.create_interface()
    free = first.solve_alone()
    curve: Curve = []

    def watch(ksp: PETSc.KSP, iteration: int, norm: float) -> None:
        if iteration % every == 0:
            curve.append((iteration, norm, first.measure_error(interface.correct(free, ksp.buildSolution()))))

    step.ksp.setMonitor(watch)
    try:
        step.solve(first.q, first.b)
        return [(iteration, norm / curve[0][1], error) for iteration, norm, error in curve], step.n_interface
    finally:
        step.destroy()
        interface.destroy()


def find_error_points(first: FirstStep, settings: DualSettings, tolerances: Sequence[float]) -> Curve:
    """Solve a linear step to each of some tolerances anew: where each solution ended."""
    curve: Curve = []
    for tolerance in tolerances:
        step = first.create_step(replace(settings, tolerance=tolerance))
        try:
            result = step.solve(first.q, first.b)
        finally:
            step.destroy()
        curve.append((result.krylov_iterations, float(result.krylov_history[-1]), first.measure_error(result.dq)))
    return curve


def count_iterations(curve: Curve, target: float) -> int:
    """Count the iterations from which on the error stays within a target; raises RuntimeError where it never does."""
    above = max((iteration for iteration, _, error in curve if error > target), default=-1)
    reached = [iteration for iteration, _, _ in curve if iteration > above]
    if not reached:
        raise RuntimeError(f"after {above} iterations the displacement error is still above {target:g}")
    return reached[0]
