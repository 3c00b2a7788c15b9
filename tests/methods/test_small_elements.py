"""Elements smaller than the speckle: equilibrium holds the nodes of the edge that the images do not determine."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from support.cases import WAVES
from support.pictures import pair_of

REGION = (60.0, 60.0, 120.0, 120.0)
NOISE = 2.0
"""Grey levels."""


def _measure(element: float, **regularization: Any) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Errors of nodes, and whether each is on the edge."""
    pair = pair_of(WAVES, 192, 8)
    rng = np.random.default_rng(0)
    noisy = [image + rng.normal(0.0, NOISE, image.shape) for image in (pair.reference, pair.deformed)]
    mesh = ddic.structured_mesh(REGION, element)
    settings = {"regularization": {"cut_off_wavelength": 32.0, **regularization}}
    result = ddic.measure((noisy[0], noisy[1]), mesh, **settings)
    low, high = REGION[0], REGION[2]
    on_edge = ((mesh.nodes == low) | (mesh.nodes == high)).any(axis=1)
    return result.at(mesh.nodes) - WAVES.displacement(mesh.nodes), on_edge


@pytest.mark.parametrize("element", [2.0, 3.0])
def test_edges_are_measured_as_well_as_three_times_what_is_inside(element: float) -> None:
    error, on_edge = _measure(element)
    rms = {name: float(np.sqrt((error[chosen]**2).mean())) for name, chosen in
           (("edge", on_edge), ("inside", ~on_edge))}
    # 32 px of texture inside, 16 px at the edge, of which half is there: the noise is some 2 to 4 times as large.
    assert rms["edge"] <= 4.0 * rms["inside"]
    # A speckle is 5 px wide: far from losing it.
    assert np.abs(error).max() <= 0.2


def test_without_it_the_images_alone_hold_the_edge() -> None:
    errors = {}
    for wavelength in (0.0, 16.0):
        error, on_edge = _measure(3.0, edge_wavelength=wavelength)
        errors[wavelength] = float(np.sqrt((error[on_edge]**2).mean()))
    # Three pixels hold a node of an edge of 3-px elements, one and a half that of a corner.
    assert errors[0.0] > 3.0 * errors[16.0]


def test_large_elements_do_not_know_it() -> None:
    plain, held = (_measure(20.0, edge_wavelength=wavelength, cut_off_wavelength=64.0)[0] for wavelength in (0.0, 16.0))
    # Of the shortest wave, of two elements, equilibrium takes (16 / 40)^4 = 0.026; of others less.
    assert np.sqrt(((held - plain)**2).mean()) <= 0.05 * np.sqrt((plain**2).mean())
