"""Few nodes are iterated alone: the forces there are those of all pixels, and elsewhere of the linear theory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from ddic.functionals.grey_statistics import GreyCorrection, GreyState
from ddic.images.noise import NOISE_OF_SLOPE
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Correction, Progress, run_gauss_newton
from ddic.solvers.local_system import LocalOperator, LocalSystem, MonolithicStep
from ddic.synth.fields import Translation
from ddic.visibility.slow_nodes import (
    LEAST_KNOWN,
    MOST_VISITED,
    SlowNodes,
    confine_to_slow_nodes,
    estimate_node_deviations,
)
from support.fields import field_of
from support.pictures import pair_of, source, square_mesh
from support.split_model import split_model, systems_of
from support.spoilt import FIELD, blank_half, clean, hide
from support.spoilt import MESH as SPOILT_MESH

Array = NDArray[np.float64]
MESH = square_mesh(24.0, 168.0)
"""9 x 9 cells of 16 px."""

MOVED = Translation((0.3, -0.4))
TRUTH = MOVED.displacement(MESH.nodes)
SLOW = int(np.abs(MESH.nodes - 72.0).sum(axis=1).argmin())
"""Node at the corner that three by three blocks share."""

TOLERANCES = Tolerances(rms=1e-4, largest=1e-3)


def build(team: Team, correction: GreyCorrection = "none", blocks: tuple[int, int] = (3, 3)) -> ResidualModel:
    pair = pair_of(MOVED)
    return split_model(team, source(pair.reference), source(pair.deformed), MESH, blocks, correction)


def take(model: ResidualModel, field: Array) -> Field:
    """Unknowns of owned subdomains, of a field (n_nodes, 2)."""
    return field_of(model, [field[subdomain.node_ids].ravel() for subdomain in model.subdomains])


def correct(model: ResidualModel, moved: dict[int, float], deviations: Array | None = None) -> Correction:
    """As if at the truth some nodes still moved, by so much."""
    q, change = take(model, TRUTH), np.zeros((MESH.n_nodes, 2))
    for node, distance in moved.items():
        change[node, 0] = distance
    dq = take(model, change)
    return Correction(q, *linearize_and_step(model, q, dq))


def linearize_and_step(model: ResidualModel, q: Field, dq: Field) -> tuple[Any, ...]:
    """What a Correction holds beside q."""
    b, grey = model.linearize(q)
    return b, dq, grey, model.measure_correction(dq, q, TOLERANCES)


def confine(model: ResidualModel, moved: dict[int, float]) -> SlowNodes | None:
    return confine_to_slow_nodes(model, correct(model, moved), systems_of(model), TOLERANCES)


def find_around(*nodes: int) -> set[int]:
    """These nodes and those that share a cell with one of them."""
    distances = np.abs(MESH.nodes[:, None] - MESH.nodes[list(nodes)]).max(axis=2).min(axis=1)
    return set(np.flatnonzero(distances < 17.0).tolist())


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("correction", ["none", "element"])
def test_forces_are_those_of_all_pixels_at_slow_nodes_and_linear_elsewhere(correction: GreyCorrection) -> None:
    model = build(Team.world(), correction)
    slow = confine(model, {SLOW: 0.3})
    assert slow is not None
    step = take(model, 0.1 * np.random.default_rng(1).normal(size=TRUTH.shape))
    q = take(model, TRUTH) + step
    b, grey = slow.linearize(q)
    whole, _ = model.linearize(q)
    before, _ = model.linearize(take(model, TRUTH))
    for subdomain, system, *of_rows in zip(model.subdomains, systems_of(model), b, whole, before, step, slow.rows,
                                           strict=True):
        found, expected, b_0, step_s, rows = of_rows
        is_slow = np.repeat(np.isin(subdomain.node_ids, list(find_around(SLOW))), 2)
        np.testing.assert_array_equal(rows, is_slow)
        # The same sums over the same pixels: the same bits.
        np.testing.assert_array_equal(found[is_slow], expected[is_slow])
        linear = b_0 - system.hessian @ step_s
        np.testing.assert_allclose(found[~is_slow], linear[~is_slow], atol=1e-12 * np.abs(b_0).max())
        # Guards the test: images are not linear.
        assert np.abs(expected - linear).max() > 1e-3 * np.abs(linear).max()
    # Sixteen cells of 16 px are visited: those about the node and its eight neighbours.
    assert grey[0].n_pixels == pytest.approx(16 * 256, rel=0.05)


@pytest.mark.parallel([1, 3])
def test_nodes_that_move_by_less_than_the_tolerance_rest_on_all_subdomains_alike() -> None:
    model = build(Team.world())
    slow = confine(model, {SLOW: 0.3, SLOW + 3: 0.5 * TOLERANCES.largest, SLOW - 3: 2.0 * TOLERANCES.largest})
    assert slow is not None
    mine = [(subdomain.node_ids[rows[::2]].tolist(), subdomain.node_ids.tolist())
            for subdomain, rows in zip(model.subdomains, slow.rows, strict=True)]
    for found, nodes in mine:
        assert set(found) == find_around(SLOW, SLOW - 3) & set(nodes)


def test_a_node_that_one_copy_alone_finds_slow_is_slow_in_all() -> None:
    # A linear step leaves copies apart by its own error.
    model = build(Team.alone())
    correction = correct(model, {})
    copies = [(place, np.flatnonzero(subdomain.node_ids == SLOW)) for place, subdomain
              in enumerate(model.subdomains)]
    sharing = [(place, int(node[0])) for place, node in copies if len(node)]
    assert len(sharing) == 4
    place, node = sharing[2]
    correction.dq[place][2 * node] = 2.0 * TOLERANCES.largest
    slow = confine_to_slow_nodes(model, correction, systems_of(model), TOLERANCES)
    assert slow is not None
    assert all(slow.rows[place][2 * node: 2 * node + 2].all() for place, node in sharing)


def test_what_is_small_beside_its_noise_is_not_slow() -> None:
    model = build(Team.alone(), blocks=(1, 1))
    deviations = np.zeros(MESH.n_nodes)
    deviations[SLOW] = np.inf
    correction = correct(model, {SLOW: 0.3, SLOW - 3: 0.3})
    weighed = confine_to_slow_nodes(replace(model, deviations=[deviations]), correction, systems_of(model),
                                    TOLERANCES)
    assert weighed is not None
    assert set(np.flatnonzero(weighed.rows[0][::2])) == find_around(SLOW - 3)


@pytest.mark.parallel([1, 3])
def test_where_they_have_many_pixels_all_are_visited() -> None:
    model = build(Team.world())
    # A node at a corner of the mesh brings 4 of 81 cells, one in the middle 16.
    corners = [node for node in range(MESH.n_nodes) if np.isin(MESH.nodes[node], (24.0, 168.0)).all()]
    least = (4 * 4 + 16) / 81
    assert least > MOST_VISITED > 4 * 4 / 81
    assert confine(model, dict.fromkeys(corners, 0.3)) is not None
    assert confine(model, dict.fromkeys([*corners, SLOW], 0.3)) is None


def solve(model: ResidualModel | SlowNodes, system: LocalSystem, q: Field) -> Field:
    operator = LocalOperator(system.hessian, smallest_eigenvalue=1e-9 * float(system.hessian.diagonal().mean()),
                             where="test")
    try:
        solution = run_gauss_newton(model, q, MonolithicStep(system, operator),
                                    Tolerances(relative=1e-30, rms=1e-9, max_iterations=100),
                                    Progress(PhaseClock()))
    finally:
        operator.destroy()
    assert solution.converged
    return solution.q


def test_slow_nodes_are_found_where_all_nodes_together_find_them() -> None:
    model = build(Team.alone(), blocks=(1, 1))
    system, = systems_of(model)
    exact = solve(model, system, take(model, TRUTH))
    apart = exact[0].copy()
    apart[2 * SLOW] += 0.3
    start = field_of(model, [apart])
    correction = Correction(start, *linearize_and_step(model, start, exact - start))
    slow = confine_to_slow_nodes(model, correction, [system], TOLERANCES)
    assert slow is not None
    alone = solve(slow, system, start)
    # The others follow by the linear theory, which errs by some per cent of the 0.3 px that pull at them.
    assert np.abs(alone[0] - exact[0]).max() <= 0.03
    assert np.abs(solve(model, system, alone)[0] - exact[0]).max() <= 1e-8


@pytest.mark.parametrize(("name", "options"), [
    ("across", {}), ("blank", {"regularization": {"cut_off_wavelength": 64}})])
def test_a_measurement_that_iterates_slow_nodes_alone_finds_the_same_field(
        name: str, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    scene = hide((100, 110, 150, 160)) if name == "across" else blank_half()
    confined = ddic.measure(scene.pair, SPOILT_MESH, **options)
    monkeypatch.setattr("ddic.visibility.solved_frame.MOST_SLOW", -1.0)
    everywhere = ddic.measure(scene.pair, SPOILT_MESH, **options)
    n_visited, n_pixels = (np.array(result.gauss_newton["n_pixels"]) for result in (confined, everywhere))
    # The last pass is one over all.
    assert n_visited.min() < MOST_VISITED * n_visited[-1]
    assert n_visited[-1] == n_pixels[-1]
    assert n_pixels.min() > 0.9 * n_pixels.max()
    np.testing.assert_array_equal(confined.fields["excluded"], everywhere.fields["excluded"])
    # At the rim of what is hidden a node gains a third of a digit an iteration: what is to go where both stop is as
    # much as the last correction, which is below 1e-3 px.
    assert np.nanmax(np.abs(confined.displacement - everywhere.displacement)) <= 1e-3


def test_slow_nodes_that_run_away_alone_are_found_with_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    # In much noise one node drives the next one: beside nodes that rest, they do not come to rest.
    scene = hide((100, 110, 150, 160))
    # Else a look at the frame would tell what hides it, and what is left converges.
    options = {"correlation": {"spoilt_pixels": "keep"}, "regularization": {"cut_off_wavelength": 64}}
    everywhere = ddic.measure(scene.pair, SPOILT_MESH, **options)
    linearize = SlowNodes.linearize

    def push_away(self: SlowNodes, q: Field) -> tuple[Field, tuple[GreyState, ...]]:
        b, grey = linearize(self, q)
        return b.map(lambda _, b_s, rows: np.where(rows, -b_s, b_s), self.rows), grey

    monkeypatch.setattr(SlowNodes, "linearize", push_away)
    found = ddic.measure(scene.pair, SPOILT_MESH, **options)
    n_visited = np.array(found.gauss_newton["n_pixels"])
    assert n_visited.min() < MOST_VISITED * n_visited[-1]
    # What each still has to go is as much as the last correction, which is below 1e-3 px.
    assert np.nanmax(np.abs(found.displacement - everywhere.displacement)) <= 1e-3


def test_the_noise_of_a_spline_s_slope() -> None:
    frequencies = np.linspace(0.0, np.pi, 20001)
    squared = (3 * np.sin(frequencies) / (2 + np.cos(frequencies)))**2
    assert pytest.approx(squared.mean(), rel=3e-3) == NOISE_OF_SLOPE[3]
    # So it is of an image of white noise.
    image = source((128.0 + 10.0 * np.random.default_rng(0).standard_normal((192, 192))).astype(np.float32))
    model = split_model(Team.alone(), image, image, MESH, (1, 1))
    slopes = np.mean(model.views[0][0].measure_slopes().texture)
    assert slopes == pytest.approx(2 * NOISE_OF_SLOPE[3] * 100.0, rel=0.03)


@pytest.mark.parallel([1, 3])
def test_a_textured_node_has_the_deviation_that_its_diagonal_says() -> None:
    noise = 8.0
    alone = build(Team.alone(), blocks=(1, 1))
    (whole,), (system,) = (estimate_node_deviations(alone, systems_of(alone), noise), systems_of(alone))
    diagonal = system.hessian.diagonal().reshape(-1, 2)
    # Of a noise of 2 grey levels in both images beside slopes of 15 a pixel: 5.6 of 225 in M are noise.
    np.testing.assert_allclose(whole, np.sqrt(noise / diagonal.min(axis=1)), rtol=0.025)
    inner = ((MESH.nodes > 24) & (MESH.nodes < 168)).all(axis=1)
    # A shape function squared is 1/9 in the mean over each of four cells of 256 pixels.
    known = diagonal[inner] - NOISE_OF_SLOPE[3] * 0.5 * noise * 4 * 256 / 9
    np.testing.assert_allclose(whole[inner], (np.sqrt(noise * diagonal[inner]) / known).max(axis=1), rtol=1e-3)
    # Copies of a node know what their subdomains know together.
    model = build(Team.world())
    found = estimate_node_deviations(model, systems_of(model), noise)
    for subdomain, deviations in zip(model.subdomains, found, strict=True):
        np.testing.assert_allclose(deviations, whole[subdomain.node_ids], rtol=1e-9)


def test_a_node_of_pure_noise_is_not_known() -> None:
    random = np.random.default_rng(3)
    f, g = (source((128.0 + 10.0 * random.standard_normal((192, 192))).astype(np.float32)) for _ in range(2))
    model = split_model(Team.alone(), f, g, MESH, (1, 1))
    (deviations,), (system,) = (estimate_node_deviations(model, systems_of(model), 200.0), systems_of(model))
    by_diagonal = np.sqrt(200.0 / system.hessian.diagonal().reshape(-1, 2).min(axis=1))
    inner = ((MESH.nodes > 24) & (MESH.nodes < 168)).all(axis=1)
    # Sums of some 100 squared slopes are above or below their mean, a seventh above it at most: little is known.
    assert deviations[inner].min() >= 2.0 * by_diagonal[inner].min()
    assert np.median(deviations[inner] / by_diagonal[inner]) == pytest.approx(1.0 / LEAST_KNOWN, rel=0.1)


def test_what_neither_pixels_nor_mechanics_hold_is_known_to_be_nowhere_else() -> None:
    mask = np.ones((192, 192), dtype=bool)
    mask[:, 100:] = False
    image = pair_of(MOVED).reference
    model = split_model(Team.alone(), source(image, mask), source(image), MESH, (1, 1))
    deviations, = estimate_node_deviations(model, systems_of(model), 8.0)
    assert (deviations[MESH.nodes[:, 0] > 120] == 0).all()
    assert (deviations[MESH.nodes[:, 0] < 88] > 0).all()


def test_a_clean_pair_has_the_field_of_all_iterations_within_its_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    default = ddic.measure(clean().pair, SPOILT_MESH)
    monkeypatch.setattr("ddic.visibility.solved_frame.MOST_SLOW", -1.0)
    tight = ddic.measure(clean().pair, SPOILT_MESH, gauss_newton={"rms_tolerance": 1e-9,
                                                                              "tolerance": 1e-13})
    error = np.linalg.norm(default.displacement - tight.displacement, axis=1)
    noise = np.linalg.norm(tight.displacement - FIELD.displacement(SPOILT_MESH.nodes), axis=1)
    # A twentieth of a node's deviation, or 1e-3 px, are still to go at the last correction, and the next is smaller.
    assert error.max() <= 1e-3
    assert np.sqrt((error**2).mean()) <= 0.02 * np.sqrt((noise**2).mean())
