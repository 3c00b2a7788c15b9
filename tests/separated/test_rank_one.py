"""The best rank-one correction: gradient, optimum, what it gains, nodes without pixels."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.separated import rank_one
from ddic.separated.field import SeparatedField, scale_modes
from ddic.separated.pixel_bands import FramePixels
from ddic.separated.rank_one import build_directions, find_rank_one, renew_functions
from ddic.separated.separated_regularization import SeparatedOperator, build_no_operator
from ddic.synth.fields import Translation
from support.cases import WAVES
from support.separated import build_zero_field, frame_of, lines, random_field, weighted_gap

REGION = (20.0, 24.0, 164.0, 152.0)
SIZE = 16.0
ALONG_X, ALONG_Y = lines(REGION, SIZE)
WEIGHT = 1e4
"""Of the equilibrium gap: about what a cut-off of 60 px asks for."""
NONE = build_no_operator(ALONG_X, ALONG_Y)


def _objective(frame: FramePixels, operator: SeparatedOperator, u: SeparatedField) -> float:
    """Half the sum of squared residuals, with its regularisation."""
    squares = float(frame.evaluate(u).values[3])
    return 0.5 * (squares + operator.measure_energy(u.scaled_x, u.y))


def _model(frame: FramePixels, operator: SeparatedOperator, u: SeparatedField, du: SeparatedField) -> float:
    """The same with the residual linearised about u, where the frame was evaluated."""
    x = np.arange(ALONG_X.pixels.start, ALONG_X.pixels.stop, dtype=float)
    y = np.arange(ALONG_Y.pixels.start, ALONG_Y.pixels.stop, dtype=float)
    values = du.evaluate_on_grid(x, y)
    first, total = ALONG_Y.pixels.start, 0.0
    for band in frame.bands:
        rows = band.reference.rows
        of_band = values[rows.start - first:rows.stop - first]
        left = band.residual.astype(float) - band.by_x * of_band[..., 0] - band.by_y * of_band[..., 1]
        total += float((left**2).sum())
    v = u.add(du)
    return 0.5 * (total + operator.measure_energy(v.scaled_x, v.y))


@pytest.mark.parametrize("regularized", [False, True])
def test_right_hand_side_is_the_gradient_of_the_objective(regularized: bool) -> None:
    # After a whole pixel both splines are the same: grad g(x + u) is grad f at the displacement of the images.
    u = scale_modes(ALONG_X, ALONG_Y, np.ones((1, 2, ALONG_X.n_nodes)), np.ones((1, 2, ALONG_Y.n_nodes)))
    frame = frame_of(Translation((1.0, 1.0)), REGION, SIZE)
    operator = weighted_gap(ALONG_X, ALONG_Y, WEIGHT) if regularized else NONE
    bent = u.add(random_field(ALONG_X, ALONG_Y, 1, size=1e-3))
    frame.evaluate(bent)
    along_x, _ = build_directions(frame, operator, bent)
    y = np.random.default_rng(5).normal(size=(2, ALONG_Y.n_nodes))
    sums = along_x.integrate(ALONG_Y.evaluate_at_pixels(y))
    right = np.stack([ALONG_X.sum_at_nodes(row) for row in sums[3:]]) - along_x._regularize(y)
    for c, node in ((0, 3), (1, 5)):
        slopes = []
        for sign in (1, -1):
            x = np.zeros((1, 2, ALONG_X.n_nodes))
            x[0, c, node] = sign * 1e-3
            slopes.append(_objective(frame, operator, bent.add(scale_modes(ALONG_X, ALONG_Y, x, y[None]))))
        found = -(slopes[0] - slopes[1]) / 2e-3
        # 1e-3 px from there grad g differs from grad f by a few thousandths.
        assert found == pytest.approx(right[c, node], rel=0.01, abs=0.005 * np.abs(right).max())


@pytest.mark.parametrize("regularized", [False, True])
def test_gain_is_the_decrease_of_the_model_and_no_neighbour_is_better(regularized: bool) -> None:
    frame = frame_of(WAVES, REGION, SIZE)
    operator = weighted_gap(ALONG_X, ALONG_Y, WEIGHT) if regularized else NONE
    u = random_field(ALONG_X, ALONG_Y, 2, size=0.01)
    frame.evaluate(u)
    mode = find_rank_one(frame, build_directions(frame, operator, u), 60, 1e-9)
    before = _model(frame, operator, u, build_zero_field(ALONG_X, ALONG_Y))
    after = _model(frame, operator, u, mode.field)
    # The residual is stored as float32; the solution is held by 1e-9 of the diagonal.
    assert before - after == pytest.approx(mode.gain, rel=1e-5)
    random = np.random.default_rng(0)
    for _ in range(5):
        x = mode.field.scaled_x + 1e-3 * random.normal(size=mode.field.x.shape)
        y = mode.field.y + 1e-3 * random.normal(size=mode.field.y.shape)
        assert _model(frame, operator, u, scale_modes(ALONG_X, ALONG_Y, x, y)) > after


@pytest.mark.parametrize("along_y", [False, True])
def test_update_is_the_best_of_all_functions_of_a_direction(along_y: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # However small they are.
    monkeypatch.setattr(rank_one, "NEGLECTED", 1e-9)
    frame = frame_of(WAVES, REGION, SIZE)
    operator = weighted_gap(ALONG_X, ALONG_Y, WEIGHT)
    u = random_field(ALONG_X, ALONG_Y, 2, size=0.5)
    frame.evaluate(u)
    mode = find_rank_one(frame, build_directions(frame, operator, u), 6, 0.05).field
    updated = renew_functions(frame, operator, u, mode, along_y=along_y, loss=1e-10)

    def change(field: SeparatedField) -> SeparatedField:
        negative = SeparatedField(ALONG_X, ALONG_Y, -u.amplitudes, u.x, u.y)
        return field.add(negative)

    best = _model(frame, operator, u, change(updated))
    assert best < _model(frame, operator, u, mode)
    random = np.random.default_rng(0)
    for k in range(updated.n_modes):
        for size in (1e-3, -1e-3):
            x, y = updated.x[k:k + 1], updated.y[k:k + 1]
            moved = size * random.normal(size=(y if along_y else x).shape)
            extra = scale_modes(ALONG_X, ALONG_Y, x, moved) if along_y else scale_modes(ALONG_X, ALONG_Y, moved, y)
            assert _model(frame, operator, u, change(updated.add(extra))) > best


def test_nodes_without_a_pixel_follow_their_neighbours() -> None:
    mask = np.ones((192, 192), bool)
    # All rows of five columns of elements.
    mask[:, 60:140] = False
    frame = frame_of(WAVES, REGION, SIZE, mask=mask)
    u = build_zero_field(ALONG_X, ALONG_Y)
    frame.evaluate(u)
    mode = find_rank_one(frame, build_directions(frame, NONE, u), 6, 0.05).field
    hidden = np.flatnonzero((ALONG_X.nodes > 76) & (ALONG_X.nodes < 124))
    assert len(hidden) == 3
    beside = [hidden[0] - 2, hidden[-1] + 2]
    for c in range(2):
        line = np.interp(ALONG_X.nodes[hidden], ALONG_X.nodes[beside], mode.x[0, c, beside])
        between = mode.x[0, c, [beside[0] + 1, *hidden, beside[1] - 1]]
        # A straight line between what pixels determine.
        assert np.abs(np.diff(between, 2)).max() <= 1e-6 * np.abs(mode.x[0, c]).max()
        assert np.isfinite(line).all()


def test_function_of_a_component_that_no_pixel_shows_is_zero() -> None:
    frame = frame_of(WAVES, REGION, SIZE)
    frame.evaluate(build_zero_field(ALONG_X, ALONG_Y))
    for band in frame.bands:
        band.by_y = np.zeros_like(band.by_y)
    mode = find_rank_one(frame, build_directions(frame, NONE, build_zero_field(ALONG_X, ALONG_Y)), 6, 0.05)
    assert mode.field.amplitudes[0, 1] <= 1e-12
    assert mode.field.amplitudes[0, 0] > 0.1
