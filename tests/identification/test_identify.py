"""Parameters from fields and from images: exact ones, their scatter beside what is predicted, any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import linalg

from ddic.errors import ConvergenceError, InputError
from ddic.identification.identify import FieldEvidence, Identified, identify
from ddic.identification.joint_step import ElasticModel, FrameTerms, FunctionModel, MeasuredForce
from ddic.identification.laws import ElasticBody, ElasticLaw, LawOnCells
from ddic.mesh.structured import build_structured_mesh
from ddic.parallel.team import Team

MESH = build_structured_mesh((0.0, 0.0, 200.0, 160.0), 10.0, circles=[((100.0, 80.0), 30.0)])
OUTER = np.unique(np.concatenate([MESH.node_sets[side] for side in ("left", "right", "top", "bottom")]))
INNER = np.setdiff1d(np.arange(MESH.n_nodes), OUTER)
LAW = ElasticLaw("orthotropic")
TRUE = np.array([5.0, 1.0, 0.28, 0.6, 30.0])
BLOCK = np.array([[9e4, 1e3], [1e3, 8e4]])
HESSIAN = sparse.kron(sparse.identity(MESH.n_nodes), BLOCK).tocsr()
SIGMA = 2.0


def _model(values: np.ndarray, is_sought: list[bool], forces: tuple[MeasuredForce, ...] = ()) -> ElasticModel:
    laws = [LawOnCells(LAW, np.ones(MESH.n_cells, dtype=bool), values, np.array(is_sought))]
    return ElasticModel(ElasticBody(MESH, laws), np.isin(np.arange(MESH.n_nodes), INNER), forces)


def _solve(parameters: np.ndarray = TRUE) -> np.ndarray:
    """The displacement of the true body with displaced edges, (n_dofs,)."""
    body = _model(parameters, [True] * 5).body
    stiffness = body.assemble_stiffness(parameters)
    x, y = (MESH.nodes - [100.0, 80.0]).T
    u = np.stack([-0.002 * x, 0.01 * y + 1e-5 * x * y], axis=1)
    inner = (2 * INNER[:, None] + [0, 1]).ravel()
    u[INNER] = 0.0
    u = u.ravel()
    u[inner] = linalg.spsolve(stiffness[inner][:, inner].tocsc(), -(stiffness @ u)[inner])
    return u


def _identify(model: ElasticModel | FunctionModel, *fields: np.ndarray) -> Identified:
    return identify(Team.alone(), model, [FieldEvidence(HESSIAN, u) for u in fields], SIGMA)


RATIOS = [True, False, True, True, True]
START = TRUE * [1.2, 1.0, 0.8, 1.2, 0.8]


def test_ratios_follow_from_a_field_within_six_iterations() -> None:
    found = _identify(_model(START, RATIOS), _solve())
    assert found.names == ["young_1", "poisson_ratio", "shear", "angle_degrees"]
    # Rounding of two sparse factors.
    assert found.values == pytest.approx(TRUE[RATIOS], rel=1e-9)
    assert found.n_iterations <= 6


def test_forces_tell_moduli_and_their_deviation() -> None:
    u, top = _solve(), MESH.node_sets["top"]
    direction = np.array([0.0, 1.0])
    exact = MeasuredForce(top, direction, np.zeros(1), 1.0, 0.1)
    force = float(exact.differentiate(_model(TRUE, [True] * 5).body.assemble_stiffness(TRUE)) @ u)
    measured = MeasuredForce(top, direction, np.array([force]), 0.01 * abs(force), 0.1)
    found = _identify(_model(START * [1, 0.8, 1, 1, 1], [True] * 5, (measured,)), u)
    # The last correction is below a hundredth of a deviation, what is left after it its square.
    assert found.values == pytest.approx(TRUE, rel=1e-6)
    # E2 is known by the force to 1 %, and by the field to little more.
    assert found.deviations[1] == pytest.approx(0.01, rel=2.0)
    assert found.deviations[1] > 0.01


def test_the_scatter_is_what_is_predicted() -> None:
    """60 fields with the noise of an unregularized measurement, cov(u) = 2 sigma^2 M^-1."""
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(2.0 * SIGMA**2 * np.linalg.inv(BLOCK))
    u, model = _solve(), _model(START, RATIOS)
    found = [_identify(model, u + (rng.standard_normal((MESH.n_nodes, 2)) @ root.T).ravel()) for _ in range(60)]
    values, predicted = np.array([one.values for one in found]), found[0].deviations
    # The standard deviation of 60 is known to 9 %, their mean to 0.13 of one.
    assert values.std(axis=0, ddof=1) / predicted == pytest.approx(1.0, abs=0.3)
    assert (np.abs(values.mean(axis=0) - TRUE[RATIOS]) < 0.5 * predicted).all()


def test_two_frames_tell_as_much_as_their_information_adds_up_to() -> None:
    u = _solve()
    one, two = _identify(_model(TRUE, RATIOS), u), _identify(_model(TRUE, RATIOS), u, 2.0 * u)
    # Twice the strain has four times the information.
    assert two.covariance == pytest.approx(one.covariance / 5.0, rel=1e-6)


def test_the_step_is_that_of_the_sensitivities() -> None:
    """What the saddle point eliminates, formed: T = [G, S], H = T^T M' T, S by differences of whole solutions."""
    u, model = _solve(), _model(TRUE, RATIOS)
    weight = 1.0 / (2.0 * SIGMA**2)
    inner, outer = ((2 * nodes[:, None] + [0, 1]).ravel() for nodes in (INNER, OUTER))
    stiffness = model.body.assemble_stiffness(TRUE[RATIOS])
    g = np.zeros((MESH.n_dofs, len(outer)))
    g[outer] = np.eye(len(outer))
    g[inner] = -linalg.spsolve(stiffness[inner][:, inner].tocsc(), stiffness[inner][:, outer].tocsc()).toarray()
    s = []
    for k in np.flatnonzero(RATIOS):
        step = 1e-4 * TRUE[k] * np.eye(5)[k]
        s.append((_solve(TRUE + step) - _solve(TRUE - step)) / (2.0 * step[k]))
    t = np.column_stack([g, *s])
    information = t.T @ (weight * HESSIAN @ t)
    b = np.random.default_rng(1).standard_normal(MESH.n_dofs)
    expected = np.linalg.solve(information, t.T @ b)
    found = model.solve_step(TRUE[RATIOS], [FrameTerms(u, weight * HESSIAN, b)])
    # Differences of second order: 1e-8 of the sensitivities.
    assert found.dp == pytest.approx(expected[len(outer):], rel=1e-6)
    assert found.du[0] == pytest.approx(t @ expected, rel=1e-6, abs=1e-6 * np.abs(t @ expected).max())
    covariance = np.linalg.inv(information)[len(outer):, len(outer):]
    assert np.linalg.inv(found.information) == pytest.approx(covariance, rel=1e-6, abs=1e-6 * np.abs(covariance).max())


@pytest.mark.parametrize("has_slopes", [True, False])
def test_a_function_of_ones_own(has_slopes: bool) -> None:
    """Amplitudes of two fields, linear and not."""
    x, y = MESH.nodes.T / 100.0
    one, two = np.stack([x * y, y], axis=1), np.stack([y**2, x], axis=1)

    def simulate(p: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        slopes = np.stack([one, 2.0 * p[1] * two])[:, None]
        return (p[0] * one + p[1] ** 2 * two)[None], slopes if has_slopes else None

    model = FunctionModel(["a", "b"], np.array([1.0, 1.0]), simulate, np.array([1e-4, 1e-4]))
    found = _identify(model, simulate(np.array([0.7, 1.3]))[0].ravel())
    assert found.values == pytest.approx([0.7, 1.3], rel=1e-6)


def test_parameters_that_nothing_tells_apart_are_named() -> None:
    def simulate(p: np.ndarray) -> tuple[np.ndarray, None]:
        return np.full((1, MESH.n_nodes, 2), p[0] + 2.0 * p[1]), None

    model = FunctionModel(["a", "b"], np.zeros(2), simulate, np.array([1e-3, 1e-3]))
    with pytest.raises(InputError, match=r"do not tell (a and b|b and a)"):
        _identify(model, np.ones(MESH.n_dofs))


def test_a_field_of_no_material_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises((ConvergenceError, InputError), match="identification"):
        _identify(_model(START, RATIOS), rng.standard_normal(MESH.n_dofs))
