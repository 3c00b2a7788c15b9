"""The preconditioner of the interface problem that is asked for, Eq. 37-40 of [BP17] and what goes beyond."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from ddic.parallel.phases import PhaseClock
from ddic.partition.subdomain import copies_of, scaled_incidence
from ddic.solvers.dual.coarse_space import (
    CoarseColumns,
    CoarsePart,
    CoarseSpace,
    build_coarse_columns,
    find_low_energy_modes,
)
from ddic.solvers.dual.dual_problem import DualProblem, MotionPreconditioner, Preconditioning
from ddic.solvers.dual.preconditioner import (
    DualPreconditioner,
    LocalInverseKind,
    LocalPreconditioner,
    SchurPair,
    TwoLevelPreconditioner,
    build_schur_pair,
)
from ddic.solvers.exchange import Exchange
from ddic.solvers.petsc import PetscStack

Preconditioner = Literal["none", "paper", "scaled", "two_level"]


OF_COLUMNS = 0.3
"""Share of the set-up that the coarse vectors take, a guess for what shows progress."""


@dataclass(frozen=True)
class BuiltPreconditioner:
    """A preconditioner and the coarse space that it works with.

    Attributes
    ----------
    context : Preconditioning or None
        Of PETSc's shell preconditioner; None: without.
    coarse : CoarseSpace or None
        None for one level.
    """

    context: Preconditioning | None
    coarse: CoarseSpace | None


def build_preconditioner(stack: PetscStack, problem: DualProblem, kind: Preconditioner,
                         local_inverse: LocalInverseKind, clock: PhaseClock | None = None) -> BuiltPreconditioner:
    """Build a preconditioner of the interface problem, rows of cameras' motions eliminated; collective.

    ``stack`` keeps what must be destroyed. Raises SingularSubdomainError on all ranks.
    """
    if kind == "none":
        return BuiltPreconditioner(None, None)
    clock = clock or PhaseClock()
    is_paper = kind == "paper"
    assemblies = [local.incidence for local in problem.local_duals] if is_paper else _scale_assemblies(problem)
    # Before the inverses: what finds the modes is large, and gone when these are made.
    columns = _find_columns(problem, clock) if kind == "two_level" else []
    pairs = _build_pairs(stack, problem, local_inverse, clock)
    terms = [LocalPreconditioner(assembly, pair.inverse) for assembly, pair in zip(assemblies, pairs, strict=True)]
    one_level = DualPreconditioner(problem.exchange, terms)
    context: Preconditioning = one_level
    coarse = None
    if kind == "two_level":
        parts = [CoarsePart(local, assembly, pair.multiply, columns_s) for local, assembly, pair, columns_s
                 in zip(problem.local_duals, assemblies, pairs, columns, strict=True)]
        coarse = stack.keep(CoarseSpace(problem.team, problem.exchange, parts))
        context = TwoLevelPreconditioner(problem.operator, one_level, coarse)
    if problem.n_motion:
        context = stack.keep(MotionPreconditioner(problem.operator, context, problem.n_motion))
    return BuiltPreconditioner(context, coarse)


def _find_columns(problem: DualProblem, clock: PhaseClock) -> list[CoarseColumns]:
    """Coarse vectors of each owned subdomain."""
    both = list(zip(problem.systems, problem.local_duals, strict=True))

    def find() -> list[CoarseColumns]:
        return [build_coarse_columns(find_low_energy_modes(system, local.operator), local)
                for system, local in clock.note_each(both, end=OF_COLUMNS)]

    return problem.team.together(find)


def _build_pairs(stack: PetscStack, problem: DualProblem, local_inverse: LocalInverseKind,
                 clock: PhaseClock) -> list[SchurPair]:
    """S_s and its inverse of each owned subdomain."""
    both = list(zip(problem.systems, problem.local_duals, strict=True))

    def build() -> list[SchurPair]:
        pairs = []
        for system, local in clock.note_each(both):
            pair = build_schur_pair(system, local, local_inverse)
            # One by one: where a later one is singular, those before are freed. The inverse alone, for S_s may go.
            stack.keep(pair.inverse)
            pairs.append(pair)
        return pairs

    return problem.team.together(build)


def _scale_assemblies(problem: DualProblem) -> list[sparse.csc_matrix]:
    """(B D^-1 B^T)^-1 B D^-1 per subdomain, D the copies' stiffness diag A_s (1 for reactions)."""
    chains = []
    for system in problem.systems:
        jumps, reactions = system.subdomain.jumps, system.subdomain.reactions
        stiffness = system.diagonal[jumps.unknowns]
        chains.append([(jumps, stiffness), (reactions, np.ones(len(reactions.unknowns)))])
    with PetscStack() as stack:
        n_owned = sum(subdomain.n_owned_copies for subdomain in problem.subdomains)
        needed = [copies_of(interface) for pair in chains for interface, _ in pair]
        exchange = stack.keep(Exchange(problem.team, n_owned, needed))
        copies = exchange.ghosts
        mine = np.zeros(len(copies))
        for pair in chains:
            for interface, values in pair:
                mine[np.searchsorted(copies, interface.first_copy + interface.position)] = values
        weights = exchange.sum_over_ranks(mine)
    rows = problem.exchange.ghosts
    return [sparse.hstack([scaled_incidence(interface, weights, copies, rows) for interface, _ in pair], format="csc")
            for pair in chains]
