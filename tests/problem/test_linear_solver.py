"""The linear step of a case, and its renewal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import SingularSubdomainError, is_collective
from ddic.parallel.field import Field
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import Assembly
from ddic.problem.linear_solver import LONG_WAVELENGTH, MANY_SUBDOMAINS, LinearSolver
from ddic.problem.reference_problem import ReferenceProblem
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.local_system import LocalSystem, MonolithicStep
from ddic.solvers.petsc import PetscStack
from ddic.solvers.whole_system import AssembledStep, ConjugateGradientStep
from support.cases import write_case, write_images
from support.petsc_objects import count_live_objects
from support.prepared import assemble_alike, prepare

RANKS = [1, 3]
REGULARIZED = "[regularization]\ncut_off_wavelength = 64.0\n"
METHODS = ["dual", "assembled", "conjugate_gradient"]
Array = NDArray[np.float64]


def _prepare(team: Team, folder: Path, solver: str, more: str = REGULARIZED) -> tuple[ReferenceProblem, Assembly]:
    if team.is_root:
        if not (folder / "f.tif").exists():
            write_images(folder)
        write_case(folder, f"[solver]\n{solver}\ntolerance = 1e-12\n{more}")
    team.wait_for_all()
    problem = prepare(team, folder / "case.toml")
    return problem, assemble_alike(team, problem)


def _solver(team: Team, problem: ReferenceProblem, assembly: Assembly) -> LinearSolver:
    solver = LinearSolver(team, problem.inputs.case, assembly, PhaseClock())
    solver.set_up()
    return solver


def _solve(problem: ReferenceProblem, solver: LinearSolver) -> list[Array]:
    """dq for a right-hand side that is one function of unknowns' numbers, shared out among copies."""
    at_rest = Field.zero(Team.world(), problem.subdomains)
    b = at_rest.with_parts(np.sin(1.0 + s.numbers) * 1e4 / s.all_multiplicity for s in problem.subdomains)
    return list(solver.step.solve(at_rest, b, None).dq)


def _difference(team: Team, one: list[Array], other: list[Array]) -> float:
    """Largest, relative to the largest of all ranks."""
    size = team.maximum(max(float(np.abs(x).max()) for x in other))
    return float(team.maximum(max(float(np.abs(x - y).max()) for x, y in zip(one, other, strict=True)))) / size


def _heavier(problem: ReferenceProblem, assembly: Assembly, index: int) -> list[LocalSystem | None]:
    """M_s of one subdomain three times as large, the others as they are."""
    return [replace(system, hessian=3.0 * system.hessian) if s.index == index else None
            for s, system in zip(problem.subdomains, assembly.systems, strict=True)]


@pytest.mark.parallel([1])
@pytest.mark.parametrize(("method", "kind"), [("dual", DualStep), ("assembled", AssembledStep), (
    "conjugate_gradient", ConjugateGradientStep), ("monolithic", MonolithicStep)])
def test_the_step_is_that_of_the_case(shared_path: Path, method: str, kind: type) -> None:
    team = Team.world()
    problem, assembly = _prepare(team, shared_path, f'method = "{method}"')
    clock = PhaseClock()
    with PetscStack() as stack:
        solver = stack.keep(LinearSolver(team, problem.inputs.case, assembly, clock))
        assert not solver.is_set_up
        solver.set_up()
        assert isinstance(solver.step, kind)
        assert solver.is_set_up
        assert solver.n_factorized == 1
        assert solver.n_interface == 0  # of one subdomain
    assert not solver.is_set_up
    with pytest.raises(RuntimeError, match="freed"):
        _ = solver.step
    assert set(clock.wall) == ({Phase.FACTORIZE, Phase.INTERFACE_SET_UP} if method == "dual" else {Phase.FACTORIZE})


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("method", METHODS)
def test_a_renewed_solver_is_one_made_anew(shared_path: Path, method: str) -> None:
    team = Team.world()
    problem, assembly = _prepare(team, shared_path, f'method = "{method}"\nsubdomains = 6')
    n_own = len(problem.subdomains)
    changed = _heavier(problem, assembly, 4)
    with PetscStack() as stack:
        solver = stack.keep(_solver(team, problem, assembly))
        before = _solve(problem, solver)
        assert solver.n_factorized == n_own
        solver.renew(changed)
        found = _solve(problem, solver)
        renewed = solver.assembly
        # The others keep their factors.
        assert solver.n_factorized == n_own + sum(system is not None for system in changed)
        solver.renew(assembly.systems)
        back = _solve(problem, solver)
    with PetscStack() as stack:
        solver = stack.keep(_solver(team, problem, renewed))
        anew = _solve(problem, solver)
    # Krylov to 1e-12 of operators whose condition is below 1e4.
    assert _difference(team, found, anew) <= 1e-8
    assert _difference(team, back, before) <= 1e-8
    assert _difference(team, found, before) > 1e-3


# Conjugate gradients factorise nothing, hence find nothing singular.
@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("method", ["dual", "assembled"])
def test_a_renewal_that_fails_frees_all_and_can_be_made_good(shared_path: Path, method: str) -> None:
    team = Team.world()
    problem, assembly = _prepare(team, shared_path, f'method = "{method}"\nsubdomains = 6', more="")
    count_live_objects(team, shared_path)
    before = count_live_objects(team, shared_path)
    nothing = [replace(system, hessian=sparse.csr_matrix(system.hessian.shape)) if s.index in (1, 5) else None
               for s, system in zip(problem.subdomains, assembly.systems, strict=True)]
    with PetscStack() as stack:
        solver = stack.keep(_solver(team, problem, assembly))
        expected = _solve(problem, solver)
        with pytest.raises(SingularSubdomainError) as caught:
            solver.renew(nothing)
        assert is_collective(caught.value)
        assert not solver.is_set_up
        assert count_live_objects(team, shared_path) == before
        solver.renew([None] * len(problem.subdomains))
        assert _difference(team, _solve(problem, solver), expected) <= 1e-8
    assert count_live_objects(team, shared_path) == before


@pytest.mark.parallel(RANKS)
def test_a_solver_that_cannot_be_made_leaves_nothing(shared_path: Path) -> None:
    team = Team.world()
    problem, assembly = _prepare(team, shared_path, 'method = "dual"\nsubdomains = 6', more="")
    count_live_objects(team, shared_path)
    before = count_live_objects(team, shared_path)
    for system in assembly.systems:
        if system.subdomain.index == 3:
            system.hessian.data[:] = 0.0
    with pytest.raises(SingularSubdomainError, match=r"^subdomain 3 "):
        _solver(team, problem, assembly)
    assert count_live_objects(team, shared_path) == before


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("n_subdomains", "wavelength", "is_two_level"), [
    # 8 subdomains of 144 x 144 px have sides of 51 px or more.
    (MANY_SUBDOMAINS, 400.0, True), (MANY_SUBDOMAINS, 100.0, False), (MANY_SUBDOMAINS - 1, 2000.0, False),
    (MANY_SUBDOMAINS, None, False)])
def test_a_coarse_space_where_waves_are_longer_than_many_subdomains(
        shared_path: Path, n_subdomains: int, wavelength: float | None, is_two_level: bool) -> None:
    team = Team.world()
    section = "" if wavelength is None else f"[regularization]\ncut_off_wavelength = {wavelength}\n"
    problem, assembly = _prepare(team, shared_path, f'method = "dual"\nsubdomains = {n_subdomains}', more=section)
    sides = team.gather_lists([float(np.prod(np.ptp(s.mesh.nodes, axis=0)) ** 0.5) for s in problem.subdomains])
    assert (wavelength is not None and n_subdomains >= MANY_SUBDOMAINS
            and wavelength >= LONG_WAVELENGTH * np.mean(sides)) == is_two_level
    chosen = []
    make: Callable[..., DualStep] = DualStep.__init__

    class Spy(DualStep):
        def __init__(self, *args: object) -> None:
            chosen.extend(settings.preconditioner for settings in args if isinstance(settings, DualSettings))
            make(self, *args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ddic.problem.linear_solver.DualStep", Spy)
        _solver(team, problem, assembly).destroy()
    assert chosen == ["two_level" if is_two_level else "scaled"]
