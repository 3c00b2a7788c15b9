"""The dual step with near and far cameras against the saddle point of Eq. 21 of [BP17] and one gap, solved directly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.kinematics.camera import MotionKind
from ddic.parallel.team import Team
from ddic.solvers.dual.dual_step import DualStep
from ddic.solvers.dual.preconditioner import MotionPreconditioner
from support.near_far_linear import NearFarCut, NearFarStep, near_far_step, saddle_point_solution

RANKS = [1, 2, 3, 4]
# The Krylov residual is 1e-12 of the right-hand side and the interface operators' condition numbers stay below 1e3:
# 1e-9 leaves no room for anything but rounding.
TIGHT, SAME = 1e-12, 1e-9
# Motion, partition, and the number of subdomains or of blocks that the near field then cuts.
CUTS = [("translation", "metis", 4), ("rigid", "metis", 9), ("rigid", "blocks", 3)]
PRECONDITIONERS = ["scaled", "two_level", "paper"]


def _errors(problem: NearFarStep, *preconditioners: str, **solver: object) -> list[tuple[float, float]]:
    """Of all unknowns and of the motions, relative, with each preconditioner."""
    reference = saddle_point_solution(problem, paper_weighting=solver.get("weighting") == "paper")
    errors = []
    for preconditioner in preconditioners or ("scaled",):
        cut = NearFarCut(Team.world(), problem, tolerance=TIGHT, max_iterations=3000, preconditioner=preconditioner,
                         **solver)
        with cut.step() as step:
            result = cut.solve(step)
        assert result.krylov_history[-1] <= TIGHT
        errors.append((cut.relative_error(result.dq, reference), cut.motion_error(result.dq, reference)))
    return errors


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize(("motion", "kind", "n"), CUTS)
def test_equals_the_saddle_point(motion: MotionKind, kind: str, n: int, regularized: bool) -> None:
    problem = near_far_step("island", kind, n, motion, regularized=regularized)
    assert np.max(_errors(problem, *PRECONDITIONERS)) <= SAME


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize("motion", ["translation", "rigid"])
def test_one_subdomain_for_each_camera(motion: MotionKind, regularized: bool) -> None:
    problem = near_far_step("island", "blocks", 1, motion, regularized=regularized)
    assert len(problem.subdomains) == 2
    assert np.max(_errors(problem, *PRECONDITIONERS)) <= SAME


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
def test_a_near_field_at_the_edge_of_the_region(regularized: bool) -> None:
    assert np.max(_errors(near_far_step("edge", "metis", 5, "translation", regularized=regularized))) <= SAME


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
def test_two_near_cameras_that_share_an_edge(regularized: bool) -> None:
    problem = near_far_step("two", "metis", 5, "rigid", regularized=regularized)
    assert {s.camera for s in problem.subdomains} == {0, 1, 2}
    assert np.max(_errors(problem, *PRECONDITIONERS)) <= SAME


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize(("layout", "motion", "kind", "n"), [
    ("island", "translation", "metis", 9), ("two", "rigid", "metis", 5)])
def test_the_far_image_under_the_near_field_as_well(layout: str, motion: MotionKind, kind: str, n: int,
                                                    regularized: bool) -> None:
    problem = near_far_step(layout, kind, n, motion, regularized=regularized, use_far=True)
    assert np.max(_errors(problem)) <= SAME


@pytest.mark.parallel(RANKS)
def test_the_papers_weighting() -> None:
    problem = near_far_step("island", "metis", 9, "rigid", regularized=True)
    assert np.max(_errors(problem, weighting="paper")) <= SAME
    # Guards the test: the two weightings differ.
    consistent, paper = (saddle_point_solution(problem, paper_weighting=w) for w in (False, True))
    assert max(np.abs(a - b).max() for a, b in zip(consistent, paper, strict=True)) > 1e-4


@pytest.mark.parallel([1, 2])
def test_no_preconditioner() -> None:
    # Tens of pixels with unscaled rows: the residual's norm says less of the displacement, by two digits.
    problem = near_far_step("island", "blocks", 1, "rigid", regularized=False)
    assert np.max(_errors(problem, "none")) <= 100 * SAME


@pytest.mark.parallel(RANKS)
def test_a_second_solve_with_the_same_data_takes_no_iteration() -> None:
    problem = near_far_step("two", "metis", 9, "rigid", regularized=True)
    cut = NearFarCut(Team.world(), problem, tolerance=1e-8)
    with cut.step() as step:
        first, second = cut.solve(step), cut.solve(step)
    assert first.krylov_iterations > 0
    assert second.krylov_iterations == 0
    largest = max(float(np.abs(a - b).max()) for a, b in zip(first.dq, second.dq, strict=True))
    assert largest <= 1e-12 * max(float(np.abs(a).max()) for a in first.dq)


def _random(step: DualStep, seed: int) -> PETSc.Vec:
    """The same random vector of interface rows on any number of ranks."""
    vector = step._problem.exchange.create_vector()
    begin, end = vector.getOwnershipRange()
    vector.setArray(np.random.default_rng(seed).normal(size=step.n_interface)[begin:end])
    return vector


def _block_of_motions(step: DualStep, n_motion: int) -> NDArray[np.float64]:
    """S_tot's rows and columns of the motions, the last ones, on all ranks."""
    n = step.n_interface
    unit, column = step._problem.exchange.create_vector(), step._problem.exchange.create_vector()
    begin, _ = unit.getOwnershipRange()
    block = np.zeros((n_motion, n_motion))
    for k in range(n_motion):
        unit.set(0.0)
        if unit.getOwnershipRange()[1] == n:
            unit.setValue(n - n_motion + k, 1.0)
        unit.assemble()
        step._problem.operator.mult(None, unit, column)
        values = np.zeros(n)
        values[begin: begin + column.getLocalSize()] = column.getArray(readonly=1)
        block[:, k] = Team.world().sum(values)[n - n_motion:]
    unit.destroy()
    column.destroy()
    return block


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("use_far", [False, True])
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
def test_the_operator_with_motions_is_symmetric(regularized: bool, use_far: bool) -> None:
    problem = near_far_step("two", "metis", 5, "rigid", regularized=regularized, use_far=use_far)
    with NearFarCut(Team.world(), problem).step() as step:
        assert isinstance(step, DualStep)
        x, y = _random(step, 1), _random(step, 2)
        sx, sy = step._problem.exchange.create_vector(), step._problem.exchange.create_vector()
        step._problem.operator.mult(None, x, sx)
        step._problem.operator.mult(None, y, sy)
        asymmetry = abs(x.dot(sy) - y.dot(sx)) / (x.norm() * sy.norm())
        for vector in (x, y, sx, sy):
            vector.destroy()
    assert asymmetry <= 1e-12  # rounding of two products of a hundred terms


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
def test_motions_have_no_block_where_the_near_camera_alone_sees_its_cells(regularized: bool) -> None:
    blocks = {}
    for use_far in (False, True):
        problem = near_far_step("two", "metis", 5, "rigid", regularized=regularized, use_far=use_far)
        cut = NearFarCut(Team.world(), problem)
        with cut.step() as step:
            assert isinstance(step, DualStep)
            blocks[use_far] = _block_of_motions(step, 6)
            # kappa^-2 R^T M R of one subdomain: what the block would be without A_s^-1 N_s.
            motions = [local.motion for local in step._problem.local_duals if local.motion is not None]
            largest = max((float(np.abs(motion.block).max()) for motion in motions), default=0.0)
        scale = Team.world().maximum(largest)
        if use_far:
            # -R^T M_far R and more: negative definite where the far image has a say.
            assert np.linalg.eigvalsh(blocks[True]).max() < 0
        else:
            assert np.abs(blocks[False]).max() <= 1e-10 * scale  # condition of A_s times rounding


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize("motion", ["translation", "rigid"])
def test_the_columns_of_a_motion_are_rigid_displacements(motion: MotionKind, regularized: bool) -> None:
    problem = near_far_step("two", "metis", 9, motion, regularized=regularized)
    cut = NearFarCut(Team.world(), problem)
    looked_at = 0
    with cut.step() as step:
        assert isinstance(step, DualStep)
        for system, local in zip(cut.assembly.systems, step._problem.local_duals, strict=True):
            part = system.subdomain
            if part.motion is None:
                continue
            rigid = problem.cameras[part.camera].setup.motion_columns(part.mesh.nodes)
            found = np.column_stack([local.operator.solve(column) for column in system.motion_columns.T])
            # A_s's condition number of 1e4 or so times rounding.
            np.testing.assert_allclose(found, rigid, atol=1e-10)
            looked_at += 1
    assert Team.world().sum(looked_at) == sum(s.camera > 0 for s in problem.subdomains)


class _Inverse:
    """Multiplies by a matrix, on one rank."""

    def __init__(self, matrix: NDArray[np.float64]) -> None:
        self._matrix = matrix

    def apply(self, _: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.setArray(self._matrix @ x.getArray(readonly=1))


@pytest.mark.parallel(1)
@pytest.mark.parametrize("use_far", [False, True])
def test_motions_are_eliminated_exactly(use_far: bool) -> None:
    problem = near_far_step("two", "metis", 4, "rigid", regularized=True, use_far=use_far)
    n_motion = 6
    with NearFarCut(Team.world(), problem).step() as step:
        assert isinstance(step, DualStep)
        x, y, z = (step._problem.exchange.create_vector() for _ in range(3))
        whole = np.zeros((step.n_interface, step.n_interface))
        for k, unit in enumerate(np.eye(step.n_interface)):
            x.setArray(unit)
            step._problem.operator.mult(None, x, y)
            whole[:, k] = y.getArray(readonly=1)
        inverse = np.zeros_like(whole)
        inverse[:-n_motion, :-n_motion] = np.linalg.inv(whole[:-n_motion, :-n_motion])
        preconditioner = MotionPreconditioner(step._problem.operator, _Inverse(inverse), n_motion)
        expected = np.random.default_rng(0).normal(size=step.n_interface)
        y.setArray(whole @ expected)
        preconditioner.apply(None, y, z)
        found = np.array(z.getArray(readonly=1))
        for vector in (x, y, z, preconditioner):
            vector.destroy()
    # P = S^-1 for Lambda alone makes P the inverse of all: rounding times condition numbers below 1e5.
    np.testing.assert_allclose(found, expected, atol=1e-8)
