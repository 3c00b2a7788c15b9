"""Bands in which strain stands out."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.arrays import Array
from ddic.detection.strain_band import (
    MOST_ANGLES,
    MOST_DISTANCES,
    RadonTransform,
    StandingOut,
    StrainBand,
    compute_tresca_strain,
)
from ddic.mesh.structured import build_structured_mesh

SIZE = 10.0
CENTRES = build_structured_mesh((0.0, 0.0, 400.0, 300.0), SIZE).centroids


def find_band(strain: Array, *, is_seen: Array | None = None) -> StrainBand:
    """The band that stands out most among all cells, or those that are seen."""
    standing_out = StandingOut.compare(CENTRES, strain, SIZE)
    cells = np.ones(len(CENTRES), dtype=bool) if is_seen is None else is_seen
    return standing_out.find_band(standing_out.compute_transform(cells))


def test_tresca_strain_is_half_the_difference_of_principal_strains() -> None:
    strain = np.random.default_rng(0).normal(size=(50, 3))
    tensors = np.stack([strain[:, [0, 2]], strain[:, [2, 1]]], axis=1)
    principal = np.linalg.eigvalsh(tensors)
    np.testing.assert_allclose(compute_tresca_strain(strain), np.ptp(principal, axis=1) / 2, rtol=1e-12)


@settings(max_examples=25)
@given(angle=st.floats(0.0, np.pi), height=st.floats(-80.0, 80.0), seed=st.integers(0, 1000))
def test_band_is_found_within_half_a_cell_whatever_its_direction(angle: float, height: float, seed: int) -> None:
    normal = np.array([-np.sin(angle), np.cos(angle)])
    middle = CENTRES.mean(axis=0) + height * normal
    strain = 1e-3 * np.random.default_rng(seed).rayleigh(size=len(CENTRES))
    strain += 0.02 * np.maximum(1 - np.abs((CENTRES - middle) @ normal) / SIZE, 0.0)
    band = find_band(strain)
    found = band.line[1] - band.line[0]
    found /= np.linalg.norm(found)
    # Half a cell at the ends of lines some 30 cells long.
    assert abs(found @ normal) < 0.04
    assert abs((band.line.mean(axis=0) - middle) @ [-found[1], found[0]]) < SIZE
    assert band.score > 20


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6))
def test_noise_and_smooth_strain_do_not_stand_out(seed: int) -> None:
    random = np.random.default_rng(seed)
    smooth = 5e-3 * np.sin(CENTRES @ random.uniform(-0.02, 0.02, 2))
    assert find_band(smooth + 1e-3 * random.rayleigh(size=len(CENTRES))).score < 8.0


def test_strain_that_is_the_same_everywhere_has_no_band() -> None:
    assert find_band(np.full(len(CENTRES), 0.01)).score == 0.0


def test_cells_that_are_not_seen_leave_the_weaker_of_two_bands() -> None:
    away = np.abs(CENTRES - CENTRES.mean(axis=0)) / SIZE
    strain = 1e-3 * np.random.default_rng(0).rayleigh(size=len(CENTRES))
    strain += 0.02 * np.maximum(1 - away[:, 0], 0.0) + 0.01 * np.maximum(1 - away[:, 1], 0.0)
    across = find_band(strain)
    assert abs(across.line[1, 0] - across.line[0, 0]) < SIZE
    along = find_band(strain, is_seen=away[:, 0] > 3.0)
    assert abs(along.line[1, 1] - along.line[0, 1]) < SIZE
    assert along.score > 20


def test_no_band_is_left_where_no_cell_is_seen() -> None:
    assert find_band(CENTRES[:, 0] ** 2, is_seen=np.zeros(len(CENTRES), bool)).score == 0.0


def test_a_transform_that_is_thinned_out_keeps_its_peaks() -> None:
    random = np.random.default_rng(0)
    scores = random.normal(size=(3 * MOST_ANGLES + 5, 2 * MOST_DISTANCES))
    scores[1000, 1003] = 50.0
    whole = RadonTransform(np.linspace(0, np.pi, len(scores)), np.arange(scores.shape[1]) - 700.0, scores)
    thin = whole.keep_peaks()
    assert thin.scores.shape[0] <= MOST_ANGLES
    assert thin.scores.shape[1] <= MOST_DISTANCES
    k, j = np.unravel_index(thin.scores.argmax(), thin.scores.shape)
    assert thin.scores[k, j] == 50.0
    # Each place stands for four angles and two distances.
    assert abs(thin.angles[k] - whole.angles[1000]) < 4 * np.pi / len(scores)
    assert abs(thin.distances[j] - whole.distances[1003]) < 2
