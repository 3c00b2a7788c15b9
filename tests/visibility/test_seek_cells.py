"""Cells that a frame shows beside where they are put are found there; what hides them is not taken for them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.functionals.view import FrameView
from ddic.images.sub_image import MaskedSource
from ddic.mesh.mesh import pad_cells
from ddic.parallel.team import Team
from ddic.problem.held_cells import REACH, find_cells_beside
from ddic.synth.fields import Affine, DisplacementField, Translation
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh
from support.split_model import split_model

Array = NDArray[np.float64]
Image = NDArray[np.float32]
SIDE = 192
MESH = square_mesh(48.0, 144.0)
"""6 x 6 cells of 16 px."""

EVERY = np.arange(MESH.n_cells, dtype=np.int64)
INNER = np.flatnonzero((np.abs(MESH.centroids - 96.0) < 32.0).all(axis=1))
NOISE = 2.0
"""Of either image, grey levels."""


def add_noise(image: Image, seed: int, noise: float = NOISE) -> Image:
    noisy = image + noise * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.float32)


def show(deformed: Image | MaskedSource, reference: Image | None = None) -> FrameView:
    f = add_noise(pair_of(Translation((0.0, 0.0)), SIDE).reference, 1) if reference is None else reference
    g = deformed if isinstance(deformed, MaskedSource) else source(deformed)
    return model_of(source(f), g, MESH).views[0][0]


def move(field: DisplacementField) -> Image:
    return add_noise(pair_of(field, SIDE).deformed, 2)


def seek(view: FrameView, put: DisplacementField, cells: NDArray[np.int64] = EVERY) -> dict[int, Array]:
    return find_cells_beside(view, put.displacement(MESH.nodes).ravel(), cells, 2.0 * NOISE**2)


def off_corners(away: Array, cell: int, truth: DisplacementField, put: DisplacementField) -> float:
    """By how much the corners are elsewhere than it says, the worst of them, pixels."""
    corners = MESH.nodes[pad_cells(MESH)[cell]]
    return float(np.linalg.norm(away - truth.displacement(corners) + put.displacement(corners), axis=1).max())


@pytest.mark.parametrize("vector", [(0.3, 0.0), (2.4, -1.3), (5.5, 4.5), (-7.6, 7.4)])
@pytest.mark.parametrize("put", [(0.0, 0.0), (-3.2, 1.7)])
def test_a_translation_within_reach_is_found(vector: tuple[float, float], put: tuple[float, float]) -> None:
    at, truth = Translation(put), Translation((vector[0] + put[0], vector[1] + put[1]))
    found = seek(show(move(truth)), at)
    assert sorted(found) == EVERY.tolist()
    # Noise of 2 grey levels in both images on 31 x 31 px leaves 0.01 px, and a corner's tilt four times as much. At the
    # end of the reach a row of pixels is missing, and one cell's affine motion goes to and fro between 0.10 and 0.12 px
    # without end: at which of them it is stopped depends on the processor's rounding.
    off = np.sort([off_corners(of_cell, cell, truth, at) for cell, of_cell in found.items()])
    assert off[-2] <= 0.06
    assert off[-1] <= 0.13


def test_what_is_seen_where_it_is_put_is_not_seen_beside() -> None:
    at = Translation((-3.2, 1.7))
    assert seek(show(move(at)), at) == {}


@pytest.mark.parametrize("gradient", [((0.03, 0.0), (0.0, -0.02)), ((0.0, 0.05), (-0.05, 0.0)),
                                      ((0.04, 0.03), (-0.02, 0.05))])
def test_an_affine_motion_is_found(gradient: tuple[tuple[float, float], tuple[float, float]]) -> None:
    at, truth = Translation((0.0, 0.0)), Affine(gradient, (3.3, -2.6), (SIDE / 2, SIDE / 2))
    found = seek(show(move(truth)), at, INNER)
    assert sorted(found) == INNER.tolist()
    assert max(off_corners(of_cell, cell, truth, at) for cell, of_cell in found.items()) <= 0.1


@pytest.mark.parametrize("vector", [(REACH + 4.0, 0.0), (-12.0, -13.0)])
def test_what_is_out_of_reach_is_not_found(vector: tuple[float, float]) -> None:
    assert seek(show(move(Translation(vector))), Translation((0.0, 0.0))) == {}


@pytest.mark.parametrize("kind", ["shifted", "grey", "noise"])
def test_what_shows_something_else_is_not_found(kind: str) -> None:
    # The same specimen far off is other speckle.
    others = {"shifted": add_noise(pair_of(Translation((60.0, 45.0)), 320).deformed[:SIDE, :SIDE], 4),
              "grey": np.full((SIDE, SIDE), 127, dtype=np.float32),
              "noise": add_noise(np.full((SIDE, SIDE), 127, dtype=np.float32), 5)}
    assert seek(show(others[kind]), Translation((0.0, 0.0))) == {}


@pytest.mark.parametrize("radius", [4, 8, 12])
def test_dirt_on_the_lens_is_not_taken_for_the_specimen_that_bears_its_picture(radius: int) -> None:
    # In the reference image it lies over the cell; the specimen has moved from under it by 9 px.
    truth = Translation((9.0, 0.0))
    cell = int(np.abs(MESH.centroids - 88.0).sum(axis=1).argmin())
    y, x = np.mgrid[:SIDE, :SIDE]
    is_dirt = np.hypot(x - MESH.centroids[cell, 0], y - MESH.centroids[cell, 1]) <= radius
    f, g = (np.where(is_dirt, np.float32(10), image) for image in (
        add_noise(pair_of(truth, SIDE).reference, 1), move(truth)))
    found = seek(show(g, f), truth)
    # All are where they are put, and none is at the dirt.
    assert found == {}


def test_a_cell_that_holds_little_of_the_specimen_is_not_found_where_its_neighbours_are() -> None:
    # A plain cell, lit otherwise in the deformed image: by twice the noise, which single pixels may have, and all of
    # them together have not.
    truth, cell, noise = Translation((3.0, 2.0)), int(np.abs(MESH.centroids - 88.0).sum(axis=1).argmin()), 10.0
    f, g = np.array(pair_of(truth, SIDE).reference), np.array(pair_of(truth, SIDE).deformed)
    f[80:96, 80:96], g[82:98, 83:99] = 120, 120 + 2 * noise
    view = show(add_noise(g, 2, noise), add_noise(f, 1, noise))
    found = find_cells_beside(view, np.zeros(MESH.n_dofs), EVERY, 2.0 * noise**2)
    # Squares of 31 px about the cells beside it hold some of its pixels.
    is_apart = np.abs(MESH.centroids - MESH.centroids[cell]).max(axis=1) > 16.0
    assert cell not in found
    assert set(np.flatnonzero(is_apart)) <= set(found)


def test_a_cell_that_is_out_of_the_image_is_not_found() -> None:
    view = show(move(Translation((0.0, 0.0))))
    assert seek(view, Translation((200.0, 0.0))) == {}
    # Some are put at the image's edge, others half out of it, none within reach of where it is seen.
    assert seek(view, Translation((-52.0, 0.0))) == {}


def test_a_cell_under_a_mask_is_not_found_and_those_beside_it_are() -> None:
    truth = Translation((3.0, 2.0))
    mask = np.ones((SIDE, SIDE), dtype=bool)
    mask[:, :96] = False
    found = seek(show(source(move(truth), mask)), Translation((0.0, 0.0)))
    # Squares of 31 px and 8 px about them.
    hidden, clear = MESH.centroids[:, 0] < 96 - 20 - REACH, MESH.centroids[:, 0] > 96 + 20 + REACH
    assert not set(found) & set(np.flatnonzero(hidden))
    assert set(np.flatnonzero(clear)) <= set(found)
    # Those of which most is seen are where they are: what is hidden of their squares says nothing.
    of_most = [cell for cell in found if MESH.centroids[cell, 0] > 100]
    assert len(of_most) == 3 * 6
    assert max(off_corners(found[cell], cell, truth, Translation((0.0, 0.0))) for cell in of_most) <= 0.1


def test_a_reference_without_texture_is_sought_nowhere() -> None:
    plain = np.full((SIDE, SIDE), 100, dtype=np.float32)
    assert seek(show(move(Translation((0.0, 0.0))), plain), Translation((0.0, 0.0))) == {}


def test_where_a_cell_is_found_does_not_depend_on_how_the_mesh_is_cut() -> None:
    truth = Translation((4.4, -2.7))
    f, g = source(add_noise(pair_of(truth, SIDE).reference, 1)), source(move(truth))
    found: list[dict[int, Array]] = []
    for blocks in ((1, 1), (3, 3)):
        away = {}
        model = split_model(Team.alone(), f, g, MESH, blocks)
        for subdomain, (view,) in zip(model.subdomains, model.views, strict=True):
            own = np.arange(subdomain.mesh.n_cells)
            nearby = find_cells_beside(view, np.zeros(subdomain.n_unknowns), own, 2.0 * NOISE**2)
            away |= {int(subdomain.cell_ids[cell]): of_cell for cell, of_cell in nearby.items()}
        found.append(away)
    assert sorted(found[0]) == sorted(found[1]) == EVERY.tolist()
    # Corners may be listed from another one on.
    for cell in EVERY.tolist():
        np.testing.assert_allclose(found[1][cell].mean(axis=0), found[0][cell].mean(axis=0), atol=1e-9)


def test_what_lies_under_a_mask_of_the_reference_changes_nothing() -> None:
    truth = Translation((3.0, 2.0))
    image = add_noise(pair_of(truth, SIDE).reference, 1)
    mask = np.ones((SIDE, SIDE), dtype=bool)
    mask[80:112, 80:112] = False
    found = []
    for rubbish in (0.0, 255.0):
        f = source(np.where(mask, image, np.float32(rubbish)), mask)
        view = model_of(f, source(move(truth)), MESH).views[0][0]
        found.append(seek(view, Translation((0.0, 0.0))))
    assert sorted(found[0]) == sorted(found[1])
    for cell, of_cell in found[0].items():
        np.testing.assert_array_equal(of_cell, found[1][cell])
    # Squares that hold such pixels are not sought: those of 31 px about cells of 16 px beside the mask.
    is_near = np.abs(MESH.centroids - 96.0).max(axis=1) <= 24
    assert not set(np.flatnonzero(is_near)) & set(found[0])
    assert set(np.flatnonzero(np.abs(MESH.centroids - 96.0).max(axis=1) > 40)) <= set(found[0])
