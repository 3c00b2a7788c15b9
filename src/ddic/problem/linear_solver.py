"""The linear step that a case asks for, with its factors; renewed where M_s changes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ddic.case.schema import Case
from ddic.errors import ConvergenceError
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import Assembly
from ddic.problem.region_mesh import compute_cut_off_wavelength
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.dual.preconditioner import Preconditioner
from ddic.solvers.linear_step import GuardedStep, LinearStep
from ddic.solvers.local_system import LocalOperator, LocalSystem, MonolithicStep
from ddic.solvers.matching import MatchingPreconditioner
from ddic.solvers.petsc import LOCAL_FACTORS
from ddic.solvers.whole_system import AssembledStep, ConjugateGradientStep

MANY_SUBDOMAINS = 8
"""Subdomains below which one level of preconditioning is always enough."""

LONG_WAVELENGTH = 4.0
"""Cut-off wavelength over the side of a subdomain from which the set-up of a coarse space is less than it saves; a
larger value keeps one level for longer."""


class LinearSolver:
    """The linear step of a case, factorised by ``set_up``; ``destroy`` frees PETSc's objects.

    Parameters
    ----------
    team, case : Team, Case
        All ranks; the case says the method.
    assembly, clock : Assembly, PhaseClock
        What the reference images give; the clock of the phases "factorize" and "interface set-up".
    most_iterations : int, optional
        Conjugate gradients' iterations of a step after which A is factorised in their place, and stays so; None: never.

    Attributes
    ----------
    method : str
        How the linear steps are solved now, as a case calls it.
    preconditioner : str
        Of the interface problem; "none" where there is none.
    assembly : Assembly
        The systems that it solves.
    n_factorized : int
        Operators of this rank's subdomains factorised so far.
    """

    def __init__(self, team: Team, case: Case, assembly: Assembly, clock: PhaseClock,
                 most_iterations: int | None = None) -> None:
        if case.solver.method == "auto":
            raise ValueError("solver.method: choose_solver says which first")
        self.method = case.solver.method
        self.preconditioner: Preconditioner = "none"
        self.assembly = assembly
        self.n_factorized = 0
        self._most_iterations = most_iterations
        self._notes: list[str] = []
        self._team, self._case, self._clock = team, case, clock
        # By the place of their subdomain among this rank's.
        self._operators: dict[int, LocalOperator] = {}
        self._step: LinearStep | None = None

    @property
    def step(self) -> LinearStep:
        """The step."""
        if self._step is None:
            raise RuntimeError("the linear solver was freed")
        return self._step

    @property
    def is_set_up(self) -> bool:
        """Whether there is a step: not after a renewal that failed."""
        return self._step is not None

    @property
    def n_interface(self) -> int:
        """Number of interface unknowns."""
        return self._step.n_interface if isinstance(self._step, DualStep) else 0

    def release_notes(self) -> tuple[str, ...]:
        """Release lines on what the user should know of steps since the last call; none where all went as predicted."""
        notes, self._notes = tuple(self._notes), []
        return notes

    def set_up(self) -> None:
        """Factorise; collective. Raises SingularSubdomainError or FactorizationError on all ranks."""
        self.renew([None] * len(self.assembly.systems))

    def renew(self, systems: Sequence[LocalSystem | None]) -> None:
        """Put new systems in place of some owned subdomains' and factorise these again; collective.

        None keeps the old one. Raises SingularSubdomainError or FactorizationError on all ranks.
        """
        before = self.assembly
        self.assembly = replace(before, systems=[old if new is None else new
                                                 for old, new in zip(before.systems, systems, strict=True)])
        changed = [system is not None or not self.is_set_up for system in systems]
        # The interface operators refer to the factors: they go first.
        self._free_step()
        try:
            if self.method in LOCAL_FACTORS:
                with self._clock.phase(Phase.FACTORIZE):
                    self._factorize(changed)
            else:
                self.n_factorized += sum(changed)
            with self._clock.phase(Phase.INTERFACE_SET_UP if self.method == "dual" else Phase.FACTORIZE):
                self._step = self._make_step()
        except BaseException:
            # What was held before is held again at the next call, which then factorises all of it.
            self.destroy()
            self.assembly = before
            raise

    def destroy(self) -> None:
        """Free PETSc's objects."""
        self._free_step()
        for operator in self._operators.values():
            operator.destroy()
        self._operators.clear()

    def _free_step(self) -> None:
        if self._step is not None:
            self._step.destroy()
        self._step = None

    def _make_step(self) -> LinearStep:
        """The step of Gauss-Newton; the local factors are there where it wants them."""
        solver, systems = self._case.solver, self.assembly.systems
        if self.method == "monolithic":
            return MonolithicStep(systems[0], self._operators[0])
        if self.method == "assembled":
            return AssembledStep(self._team, systems, self.assembly.smallest_eigenvalue)
        if self.method == "dual":
            subdomains = [system.subdomain for system in systems]
            self.preconditioner = choose_preconditioner(self._team, self._case, subdomains)
            settings = DualSettings(self.preconditioner, solver.tolerance, solver.max_iterations, solver.recycle,
                                    solver.local_inverse)
            operators = [self._operators[place] for place in range(len(systems))]
            return DualStep(self._team, systems, operators, self.assembly.reaction_scale, settings, self._clock)
        most_iterations = self._most_iterations or solver.max_iterations
        step = ConjugateGradientStep(self._team, systems, solver.tolerance, most_iterations,
                                     MatchingPreconditioner if self.method == "matching" else None)
        return step if self._most_iterations is None else GuardedStep(step, self._factorize_instead)

    def _factorize_instead(self, _: ConvergenceError) -> LinearStep:
        """The step that takes conjugate gradients' place where they take longer than predicted; collective."""
        self.method = "assembled"
        self._notes.append(f"conjugate gradients did not converge in {self._most_iterations} iterations, after which a "
                           'factor costs less (weak texture somewhere, or nothing holds a part of the region): '
                           '"assembled" takes their place')
        return self._make_step()

    def _factorize(self, changed: Sequence[bool]) -> None:
        """Factorise A_s where it changed; old factors are freed before new ones need their memory."""
        for place, is_new in enumerate(changed):
            if is_new and place in self._operators:
                self._operators.pop(place).destroy()

        def factorize() -> None:
            for place, system in self._clock.note_each(list(enumerate(self.assembly.systems))):
                if place not in self._operators:
                    self.n_factorized += 1
                    self._operators[place] = LocalOperator(
                        system.without_motion.operator, smallest_eigenvalue=self.assembly.smallest_eigenvalue,
                        where=_describe(system.subdomain))

        self._team.together(factorize)


def choose_preconditioner(team: Team, case: Case, subdomains: Sequence[Subdomain]) -> Preconditioner:
    """Choose the preconditioner of the interface problem, where the case leaves it open; collective.

    It is a coarse space where one level would slow down: many subdomains, and smooth fields longer than they are.
    """
    if case.solver.preconditioner != "auto":
        return case.solver.preconditioner
    wavelength = compute_cut_off_wavelength(case)
    # Of a square or cube as large as the subdomain's box, pixels.
    total, n_subdomains = team.ordered_sum([
        np.array([np.prod(np.ptp(s.mesh.nodes, axis=0)) ** (1 / s.mesh.dim), 1.0]) for s in subdomains])
    is_slow = n_subdomains >= MANY_SUBDOMAINS and wavelength >= LONG_WAVELENGTH * total / n_subdomains
    return "two_level" if is_slow else "scaled"


def _describe(subdomain: Subdomain) -> str:
    nodes = subdomain.mesh.nodes
    places = (f"{axis} {low:.0f} to {high:.0f}" for axis, low, high
              in zip(("columns", "rows", "planes"), nodes.min(axis=0), nodes.max(axis=0), strict=False))
    return f"subdomain {subdomain.index} ({', '.join(places)})"
