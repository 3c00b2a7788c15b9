"""All linear steps on hexahedra and tetrahedra against the monolithic one, on any number of ranks."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from ddic.errors import SingularSubdomainError
from ddic.parallel.team import Team
from ddic.partition.subdomain import Weighting
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.dual.preconditioner import Preconditioner
from ddic.solvers.linear_step import LinearStep
from ddic.solvers.matching import MatchingPreconditioner
from ddic.solvers.whole_system import AssembledStep, ConjugateGradientStep
from support.linear import Decomposed, Kind, linear_step, one_domain_solution, split
from support.textureless import without_texture

RANKS = [1, 2, 3, 4]
N_CELLS, WAVELENGTH = 6, 32.0
# Residuals and errors are asked for to 1e-12; condition numbers are below 1e3 at this cut-off wavelength.
TIGHT, SAME = 1e-12, 1e-8
PRECONDITIONERS: list[Preconditioner] = ["none", "paper", "scaled", "two_level"]


def _make_steps(cut: Decomposed) -> Iterator[tuple[str, Callable[[], LinearStep]]]:
    for preconditioner in PRECONDITIONERS:
        settings = DualSettings(preconditioner, TIGHT, 3000)
        yield preconditioner, lambda settings=settings: cut.step(settings)
    yield "assembled", lambda: AssembledStep(cut.team, cut.systems, 0.0)
    yield "conjugate_gradient", lambda: ConjugateGradientStep(cut.team, cut.systems, TIGHT, 3000)
    if cut.systems[0].stiffness is not None:
        yield "matching", lambda: ConjugateGradientStep(cut.team, cut.systems, TIGHT, 3000, MatchingPreconditioner)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [None, WAVELENGTH])
@pytest.mark.parametrize(("kind", "way", "n_subdomains", "weighting"), [
    ("Hex8", "blocks", 8, "consistent"), ("Hex8", "metis", 7, "consistent"), ("Hex8", "metis", 7, "paper"),
    ("Tet4", "metis", 8, "consistent")])
def test_all_steps_equal_monolithic(kind: Kind, way: str, n_subdomains: int, weighting: Weighting,
                                    wavelength: float | None) -> None:
    problem = linear_step(N_CELLS, wavelength, kind)
    parts = split(problem.mesh, way, n_subdomains)
    reference = one_domain_solution(problem, parts, weighting)
    errors = {}
    with Decomposed(Team.world(), problem, parts, weighting) as cut:
        for name, make in _make_steps(cut):
            step = make()
            errors[name] = cut.relative_error(cut.solve(step).dq, reference)
            if name not in PRECONDITIONERS:
                step.destroy()
    assert max(errors.values()) <= SAME, errors


@pytest.mark.parallel([1, 2])
def test_a_region_that_nothing_holds_is_named_by_its_planes() -> None:
    problem = linear_step(N_CELLS, WAVELENGTH, "Hex8")
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 8), "consistent") as cut:
        # All nodes within two cells of the farthest corner.
        systems = without_texture(cut, lambda system: np.repeat(
            (system.subdomain.mesh.nodes > 12 + 8 * (N_CELLS - 2)).all(axis=1), 3))
        with pytest.raises(SingularSubdomainError, match=r"column [456]\d, row [456]\d, plane [456]\d: "):
            AssembledStep(cut.team, systems, 1e-9 * problem.mean_diagonal)
