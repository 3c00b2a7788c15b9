"""The linear step that a case asks for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from ddic.case.schema import Case, SolverSection
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import SINGULAR, Assembly, factorize
from ddic.solvers.assembled import AssembledStep
from ddic.solvers.conjugate_gradient import ConjugateGradientStep
from ddic.solvers.dual.dual_step import DualSettings, DualStep, Preconditioner
from ddic.solvers.linear_step import Step
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.monolithic import MonolithicStep

LOCAL_FACTORS = ("dual", "monolithic")
"""Methods that factorise each subdomain's own operator."""

MANY_SUBDOMAINS = 8
LONG_WAVELENGTH = 4.0
"""Cut-off wavelength over the side of a subdomain from which the set-up of a coarse space is less than it saves."""


@contextmanager
def linear_solver(team: Team, case: Case, assembly: Assembly, clock: PhaseClock) -> Iterator[tuple[Step, int]]:
    """The factorised step of a case and its number of interface unknowns, freed at the end; collective."""
    operators: list[LocalOperator] = []
    steps: list[Step] = []
    try:
        if case.solver.method in LOCAL_FACTORS:
            with clock.phase(Phase.FACTORIZE):
                operators += factorize(team, assembly.systems, assembly.mean_diagonal)
        with clock.phase(Phase.INTERFACE_SET_UP if case.solver.method == "dual" else Phase.FACTORIZE):
            step, n_interface = linear_step(team, case.solver, assembly, operators, _wavelength(case))
            steps.append(step)
        yield step, n_interface
    finally:
        for held in steps:
            held.destroy()
        for operator in operators:
            operator.destroy()


def linear_step(team: Team, solver: SolverSection, assembly: Assembly, operators: Sequence[LocalOperator],
                wavelength: float = 0.0) -> tuple[Step, int]:
    """The step of Gauss-Newton that a case asks for, and its number of interface unknowns.

    operators: local factors, none for methods outside LOCAL_FACTORS; wavelength: cut-off wavelength, pixels (0 without
    regularization, infinite where eta is given), which ``preconditioner = "auto"`` looks at.
    """
    if solver.method == "monolithic":
        return MonolithicStep(assembly.systems[0], operators[0]), 0
    if solver.method == "assembled":
        return AssembledStep(team, assembly.systems, SINGULAR * assembly.mean_diagonal), 0
    if solver.method == "conjugate_gradient":
        return ConjugateGradientStep(team, assembly.systems, solver.tolerance, solver.max_iterations), 0
    preconditioner = solver.preconditioner
    if preconditioner == "auto":
        preconditioner = _preconditioner(team, assembly, wavelength)
    settings = DualSettings(preconditioner, solver.tolerance, solver.max_iterations, solver.recycle,
                            solver.local_inverse)
    step = DualStep(team, assembly.systems, operators, assembly.reaction_scale, settings)
    return step, step.n_interface


def _preconditioner(team: Team, assembly: Assembly, wavelength: float) -> Preconditioner:
    """A coarse space where one level would slow down: many subdomains, and smooth fields longer than they are."""
    sides = team.gather_lists([float(np.prod(np.ptp(s.subdomain.mesh.nodes, axis=0)) ** (1 / s.subdomain.mesh.dim))
                               for s in assembly.systems])
    slow = len(sides) >= MANY_SUBDOMAINS and wavelength >= LONG_WAVELENGTH * float(np.mean(sides))
    return "two_level" if slow else "scaled"


def _wavelength(case: Case) -> float:
    section = case.regularization
    if section is None:
        return 0.0
    return np.inf if section.cut_off_wavelength is None else section.cut_off_wavelength
