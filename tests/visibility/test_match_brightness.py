"""The slope of the light inside cells is taken off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import ddic
from ddic.functionals.view import View
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.synth.fields import Translation
from ddic.visibility.match_reference import match_brightness
from ddic.visibility.seen_cells import choose_sample, find_typical_cell, measure_seen_cells
from support.cases import write_case
from support.fields import field_of
from support.measuring import field_on_one_rank, measure, whole_field
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh

Image = NDArray[np.float64]
SIDE = 192
MESH = square_mesh(24.0, 168.0)
SHIFT = (0.3, -0.2)
NOISE = 2.0
"""Grey levels."""


def draw(light: Image) -> tuple[Image, Image]:
    pair = pair_of(Translation(SHIFT), SIDE, 8)
    rng = np.random.default_rng(0)
    noisy = [image + rng.normal(0.0, NOISE, image.shape) for image in (pair.reference, pair.deformed)]
    return noisy[0], noisy[1] + light


def shine(height: float) -> Image:
    """A reflection 40 px wide, which changes by up to a third of its height in 16 px."""
    x, y = np.meshgrid(np.arange(float(SIDE)), np.arange(float(SIDE)))
    return np.asarray(height * np.exp(-((x - 90.0)**2 + (y - 100.0)**2) / (2 * 30.0**2)))


def match(light: Image, hidden: tuple[slice, ...] = ()) -> tuple[ResidualModel, ResidualModel]:
    reference, deformed = draw(light)
    if hidden:
        deformed[hidden] = 0.0
    model = model_of(source(reference), source(deformed), MESH, "element")
    q = field_of(model, [np.tile(SHIFT, MESH.n_nodes)])
    slopes = model.views.map(View.measure_slopes)
    seen = measure_seen_cells(model, model.evaluate(q), slopes)
    typical = {camera: find_typical_cell(model.team, cells) for camera, cells in choose_sample(model, seen).items()}
    return model, match_brightness(model, seen, typical)


def values_of(model: ResidualModel) -> Image:
    return model.views[0][0].correlation.reference.values.astype(float)


def test_a_reference_is_given_the_light_of_the_frame() -> None:
    light = shine(80.0)
    model, matched = match(light)
    window = model.views[0][0].correlation.reference.window
    given = np.zeros((SIDE, SIDE))
    given[window.y0:window.y1, window.x0:window.x1] = values_of(matched) - values_of(model)

    def take_off_means(image: Image) -> Image:
        """The 6 x 6 inner cells, without what their offsets take."""
        cells = image[40:136, 40:136].reshape(6, 16, 6, 16)
        return np.asarray(cells - cells.mean(axis=(1, 3), keepdims=True))

    # Guards the test: slopes of 1.6 grey levels per pixel.
    assert np.abs(take_off_means(light)).max() > 14.0
    # The curvature of 80 / 30^2 over half a cell of 16 px, twice, and half a pixel of displacement.
    assert np.abs(take_off_means(given - light)).max() <= 6.0
    assert take_off_means(given - light).std() <= 0.25 * take_off_means(light).std()


def test_what_is_less_than_noise_changes_nothing() -> None:
    model, matched = match(np.full((SIDE, SIDE), 30.0))
    assert values_of(matched).tobytes() == values_of(model).tobytes()


def test_what_hides_the_specimen_is_no_light() -> None:
    model, matched = match(np.zeros((SIDE, SIDE)), (slice(72, 104), slice(72, 104)))
    # Cells beside it, which hold a row of it at most, lose less than the noise.
    assert np.abs(values_of(matched) - values_of(model)).max() <= NOISE


@pytest.mark.parametrize("height", [60.0, 120.0])
def test_a_reflection_costs_no_accuracy(height: float) -> None:
    errors = []
    for light in (shine(0.0), shine(height)):
        result = ddic.measure(draw(light), MESH)
        errors.append(float(np.sqrt(((result.displacement - SHIFT)**2).mean())))
    # Without the slopes 2.6 and 4.2 times.
    assert errors[1] <= 1.3 * errors[0]


@pytest.mark.parallel([1, 3])
def test_the_light_is_the_same_on_any_number_of_ranks(shared_path: Path) -> None:
    team = Team.world()
    if team.is_root:
        for name, image in zip(("f.tif", "g.tif"), draw(shine(60.0)), strict=True):
            tifffile.imwrite(shared_path / name, image.astype(np.float32))
        write_case(shared_path, "[solver]\nsubdomains = 6\ntolerance = 1e-12\n"
                                "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0.0\n")
    team.wait_for_all()
    found = whole_field(measure(team, shared_path / "case.toml"))
    # Gauss-Newton to 1e-10, Krylov to 1e-12.
    assert np.abs(found - field_on_one_rank(shared_path / "case.toml")).max() <= 1e-8
