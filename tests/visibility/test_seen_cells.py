"""What a frame shows of cells, against sums over their pixels, and what most cells are like."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import View
from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.synth.fields import Translation
from ddic.visibility.seen_cells import FEWEST_PIXELS, SeenCells, choose_sample, find_typical_cell, measure_seen_cells
from support.fields import field_of
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh
from support.seen import make_seen

Array = NDArray[np.float64]
SHIFT = (0.3, -0.2)
PAIR = pair_of(Translation(SHIFT), 128, 8)
DIM = 0.8 * PAIR.deformed.astype(float) + 12.0 + np.random.default_rng(0).normal(0.0, 2.0, PAIR.deformed.shape)


def measure(model: ResidualModel, q: Array) -> SeenCells:
    evaluation = model.evaluate(field_of(model, [q]))
    ((seen,),) = measure_seen_cells(model, evaluation, model.views.map(View.measure_slopes))
    return seen


@pytest.mark.parametrize("correction", ["none", "global", "element"])
@pytest.mark.parametrize("element", [4.0, 16.0])
def test_it_is_that_of_the_pixels(correction: GreyCorrection, element: float) -> None:
    mesh = square_mesh(24.0, 88.0, element)
    model = model_of(source(PAIR.reference), source(DIM), mesh, correction)
    q = np.tile(SHIFT, mesh.n_nodes)
    seen = measure(model, q)
    view = model.views[0][0]
    reference = view.correlation.reference
    place = reference.window
    f = reference.values.astype(float)
    g = f - view.compute_residual_image(q)
    grey = model.evaluate(field_of(model, [q])).grey[0]
    corners = mesh.nodes[mesh.connectivity.reshape(-1, 4)]
    low, high = (corners.min(axis=1) - (place.x0, place.y0)).astype(int), (
        corners.max(axis=1) - (place.x0, place.y0)).astype(int)
    for cell, (a, b) in enumerate(zip(low, high, strict=True)):
        box = np.s_[a[1]:b[1], a[0]:b[0]]
        fc, gc = f[box].ravel(), g[box].ravel()
        assert seen.n_pixels[cell] == len(fc) == element**2
        if len(fc) >= FEWEST_PIXELS or correction == "element":
            slope, intercept = np.polyfit(gc, fc, 1)
        else:
            slope, intercept = grey.gain, grey.offset
        # float32 of 255 grey levels, in sums of squares: 1e-6 of 1e4.
        assert seen.variance[cell] == pytest.approx(((fc - slope * gc - intercept)**2).mean(), abs=0.05)
        found = [getattr(seen, name)[cell] for name in ("mean_f", "mean_g", "spread_f", "spread_g")]
        np.testing.assert_allclose(found, [fc.mean(), gc.mean(), fc.std(), gc.std()], atol=0.01)
        assert seen.coefficient[cell] == pytest.approx(np.corrcoef(fc, gc)[0, 1], abs=1e-3)


def test_nothing_correlates_where_grey_levels_do_not_vary() -> None:
    mesh = square_mesh(24.0, 88.0)
    wiped = [image.astype(float) for image in (PAIR.reference, PAIR.deformed)]
    for image in wiped:
        # Not a whole number: its sums round.
        image[:, :72] = 127.3
    seen = measure(model_of(source(wiped[0]), source(wiped[1]), mesh), np.tile(SHIFT, mesh.n_nodes))
    # What a spline carries out of the texture is no rounding up to 20 px from it.
    is_flat = mesh.centroids[:, 0] < 48
    assert is_flat.sum() == 4
    assert (seen.coefficient[is_flat] == 0).all()
    assert (seen.coefficient[mesh.centroids[:, 0] > 72] > 0.99).all()
    # Flat in one image only.
    seen = measure(model_of(source(wiped[0]), source(PAIR.deformed), mesh), np.tile(SHIFT, mesh.n_nodes))
    assert (seen.coefficient[is_flat] == 0).all()


def test_medians_are_by_pixels_and_texture_that_of_the_best_tenth() -> None:
    n = np.array([10.0, 10.0, 100.0, 10.0])
    cells = make_seen(4, n_pixels=n, variance=[1.0, 2.0, 3.0, 4.0], spread_f=[10.0, 20.0, 30.0, 40.0],
                      spread_g=[5.0, 10.0, 10.0, 20.0], mean_f=[1.0, 2.0, 3.0, 4.0], mean_g=0.0,
                      texture=[1.0, 2.0, 3.0, 400.0])
    typical = find_typical_cell(Team.alone(), cells)
    # More than half of the pixels lie in the third.
    assert (typical.noise, typical.contrast, typical.gain, typical.offset) == (3.0, 900.0, 3.0, 3.0)
    # The last has 7.7 % of them only.
    assert typical.texture == 3.0
    blank = make_seen(100, texture=np.where(np.arange(100) < 85, 2.0, 200.0))
    assert find_typical_cell(Team.alone(), blank).texture == 200.0


def test_nothing_is_typical_of_no_cells() -> None:
    typical = find_typical_cell(Team.alone(), make_seen(0))
    assert (typical.noise, typical.contrast, typical.texture, typical.gain, typical.offset) == (0.0, 0.0, 0.0, 1.0, 0.0)
    flat = find_typical_cell(Team.alone(), make_seen(5, spread_g=0.0, spread_f=0.0, coefficient=0.0))
    assert (flat.gain, flat.contrast) == (1.0, 0.0)


def test_cells_without_pixels_are_not_sampled() -> None:
    mesh = square_mesh(24.0, 88.0)
    mask = np.ones(PAIR.deformed.shape, dtype=bool)
    mask[:, 70:] = False
    model = model_of(source(PAIR.reference), source(PAIR.deformed, mask), mesh)
    seen = measure(model, np.tile(SHIFT, mesh.n_nodes))
    (sampled,) = choose_sample(model, ByView([[seen]])).values()
    assert 0 < len(sampled.n_pixels) < mesh.n_cells
    assert (sampled.n_pixels > 0).all()
    assert sampled.n_pixels.sum() == seen.n_pixels.sum()
    assert len(seen.choose(seen.n_pixels > 0).variance) == len(sampled.n_pixels)
    # Nothing is nan where there is no pixel.
    assert all(np.isfinite(getattr(seen, name)).all() for name in ("variance", "mean_f", "spread_g", "coefficient"))
