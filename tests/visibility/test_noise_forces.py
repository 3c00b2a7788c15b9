"""How strongly a residual acts on displacements: of white noise as its variance says, of other noise as its sums do."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.synth.fields import Translation
from ddic.visibility.noise_forces import ForceNoise, measure_force_noise
from support.pictures import pair_of, source, square_mesh
from support.split_model import split_model

Array = NDArray[np.float64]
MESH = square_mesh(24.0, 168.0)
"""9 x 9 cells of 16 px: 648 components of forces, whose mean square is known to sqrt(2 / 648), 6 %."""

CHANCE = 0.17
"""Three standard deviations of it."""


def build(team: Team, of_f: Array, of_g: Array, blocks: tuple[int, int] = (1, 1)) -> ResidualModel:
    """A specimen at rest, with noise of its own in both pictures."""
    texture = pair_of(Translation((0.0, 0.0))).reference.astype(np.float64)
    f, g = ((texture + noise).astype(np.float32) for noise in (of_f, of_g))
    return split_model(team, source(f), source(g), MESH, blocks)


def measure(model: ResidualModel, n_determined: float = 0.0) -> ForceNoise:
    """At rest, where the field has been given nothing of the residual unless it is said."""
    q = Field.zero(model.team, model.subdomains)
    return measure_force_noise(model, model.evaluate(q), q, n_determined, is_regularized=False)


def draw(seed: int, sigma: float = 2.0) -> Array:
    return np.asarray(sigma * np.random.default_rng(seed).standard_normal((192, 192)))


def correlate(values: Array) -> Array:
    """How values go together at distances up to 8 px, 1 at none, (17, 17)."""
    together = np.fft.fftshift(np.fft.ifft2(np.abs(np.fft.fft2(values))**2).real)
    row, column = np.array(together.shape) // 2
    return np.asarray(together[row - 8:row + 9, column - 8:column + 9] / together[row, column])


def test_white_noise_acts_as_its_variance_says() -> None:
    found = measure(build(Team.alone(), draw(0), draw(1)))
    assert found.excess == pytest.approx(1.0, abs=CHANCE)
    # 20,736 pixels: 1 %.
    assert found.variance == pytest.approx(8.0, rel=0.03)


def test_what_the_field_has_taken_is_no_part_of_it() -> None:
    model = build(Team.alone(), draw(0), draw(1))
    whole, taken = measure(model), measure(model, n_determined=200.0)
    # 200 of 648 components, and of 20,736 pixels; what is known beforehand is worth 20 more.
    assert taken.excess / whole.excess == pytest.approx(648 / 448, rel=0.02)
    assert taken.variance / whole.variance == pytest.approx(20736 / 20536, rel=1e-3)


def test_noise_that_goes_together_acts_as_its_sums_against_slopes_do() -> None:
    # Forces of cells know nothing of pixels in different ones: of two pixels at a distance d, in halves of a cell, a
    # translation sees the share 1 - d/2, a strain that of the first Legendre polynomial with itself.
    d = np.abs(np.arange(-8, 9)) / 8.0
    strained = 1.5 * ((1 - d)**3 / 3 + d * (1 - d)**2 / 2 + 1 / 3 - d / 2)
    along = 0.5 * (1.0 - d / 2 + strained)
    found, expected = [], []
    for seed in range(8):
        smooth = 8.0 * gaussian_filter(draw(seed), 1.0)
        model = build(Team.alone(), np.zeros((192, 192)), smooth)
        reference = model.views[0][0].correlation.reference
        found.append(measure(model).excess)
        expected.append(np.mean([(correlate(smooth) * correlate(slopes) * np.outer(along, along)).sum()
                                 for slopes in (reference.by_x, reference.by_y)]))
    # Guards the test.
    assert np.mean(expected) > 4.0
    # Cells of larger residuals weigh less.
    assert np.mean(found) == pytest.approx(np.mean(expected), rel=0.12)


@pytest.mark.parallel([1, 3])
def test_it_is_the_same_whatever_the_partition() -> None:
    alone = measure(build(Team.alone(), draw(0), draw(1)))
    for blocks in ((3, 1), (3, 3)):
        found = measure(build(Team(MPI.COMM_WORLD), draw(0), draw(1), blocks))
        # Sums in another order.
        np.testing.assert_allclose([found.excess, found.variance, found.texture],
                                   [alone.excess, alone.variance, alone.texture], rtol=1e-5)


def test_what_noise_gives_to_slopes_is_no_texture() -> None:
    texture = pair_of(Translation((0.0, 0.0))).reference
    clean = split_model(Team.alone(), source(texture), source(texture), MESH, (1, 1))
    noisy = build(Team.alone(), draw(0, 12.0), draw(1, 12.0))
    slopes = [np.mean(model.views[0][0].measure_slopes().texture) for model in (clean, noisy)]
    found = measure(noisy)
    # Guards the test: two fifths of M are noise.
    assert slopes[0] / slopes[1] < 0.8
    # Slopes of texture and of noise are alike by chance: 1 % of either.
    assert found.texture == pytest.approx(slopes[0] / slopes[1], abs=0.02)
    assert found.amplification == pytest.approx(1.0 / found.texture)
