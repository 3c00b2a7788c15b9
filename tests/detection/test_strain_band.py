"""Bands in which strain stands out."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.detection.line_of_case import compute_tresca_strain, find_band
from ddic.mesh.structured import build_structured_mesh

SIZE = 10.0
CENTRES = build_structured_mesh((0.0, 0.0, 400.0, 300.0), SIZE).centroids


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
    band = find_band(CENTRES, strain, SIZE)
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
    assert find_band(CENTRES, smooth + 1e-3 * random.rayleigh(size=len(CENTRES)), SIZE).score < 8.0


def test_strain_that_is_the_same_everywhere_has_no_band() -> None:
    assert find_band(CENTRES, np.full(len(CENTRES), 0.01), SIZE).score == 0.0
