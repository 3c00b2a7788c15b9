"""A small region in a large image: its surroundings, and what is found in them."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.case.schema import StartSection
from ddic.images.binned import bin_image
from ddic.images.rigid import GridField
from ddic.images.window import Window
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.start.binned_pair import BinnedPair, move_mesh
from ddic.start.coarse_displacement import CutField, evaluate_at_nodes, move_field
from ddic.start.multilevel import MultilevelStart, Pyramid, find_multilevel_start
from ddic.synth.fields import Affine
from support.pictures import pair_of, rms_error, source

SIDE, SMALL = 2112, 384
"""Of a large image, which the start sees in blocks of 4 px, and of what is not empty in it, pixels."""

AT = np.array([900, 1100])
"""Where that begins, pixels."""

MESH = build_structured_mesh((900 + 128, 1100 + 128, 900 + 256, 1100 + 256), 16.0, "Q4")


def _turned(degrees: float) -> tuple[Affine, Affine]:
    """A rotation and a translation, in pixels of what is not empty and of the large image."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    small, large = (Affine(((c - 1, -s), (s, c - 1)), (20.0, -14.0), (float(x), float(y)))
                    for x, y in (np.full(2, 191.5), AT + 191.5))
    return small, large


def _embed(values: np.ndarray, seed: int) -> np.ndarray:
    large = np.random.default_rng(seed).normal(60.0, 2.0, (SIDE, SIDE)).astype(np.float32)
    large[AT[1]:AT[1] + SMALL, AT[0]:AT[0] + SMALL] = values
    return large


def _start(degrees: float, *, with_pixels: bool) -> MultilevelStart:
    drawn = pair_of(_turned(degrees)[0], SMALL, 8)
    pixels = BinnedPair(source(_embed(drawn.reference, 0)), source(_embed(drawn.deformed, 1)), 1)
    pair = BinnedPair(bin_image(pixels.reference, 4), bin_image(pixels.deformed, 4), 4, pixels if with_pixels else None)
    return find_multilevel_start(Pyramid(pair, MESH, "none"), StartSection())


@pytest.mark.parametrize("degrees", [5.0, 20.0, 60.0])
def test_a_small_region_in_a_large_image_starts_as_in_a_small_one(degrees: float) -> None:
    known = _turned(degrees)[1]
    start = _start(degrees, with_pixels=True)
    assert start.levels == (2,)
    assert start.notes == ("start: the region and what surrounds it, 256 x 256 px from (964, 1164) px on, in blocks of "
                           "1 px",)
    # Blocks of 2 px see half of the speckle: 0.01 to 0.02 px.
    assert rms_error(evaluate_at_nodes(start.field, MESH).ravel(), MESH.nodes, known) <= 0.05
    # In blocks of 4 px the region is one of 32 x 32 of them: off by pixels.
    alone = _start(degrees, with_pixels=False)
    assert rms_error(evaluate_at_nodes(alone.field, MESH).ravel(), MESH.nodes, known) > 2.0


def test_a_region_that_fills_the_image_is_seen_no_finer() -> None:
    blank = source(np.zeros((SIDE, SIDE), dtype=np.float32))
    pixels = BinnedPair(blank, blank, 1)
    assert pixels.can_bin_finer(MESH)
    assert not pixels.can_bin_finer(build_structured_mesh((0.0, 0.0, SIDE - 1.0, SIDE - 1.0), 64.0))


@pytest.mark.parametrize("translation", [(0.0, 0.0), (33.4, -70.6), (5000.0, -5000.0)])
def test_surroundings_are_blocks_of_the_images(translation: tuple[float, float]) -> None:
    random = np.random.default_rng(2)
    shape = (700, 1500)
    f, g = (random.uniform(0.0, 255.0, shape).astype(np.float32) for _ in range(2))
    mask = random.uniform(size=shape) > 0.02
    mesh = build_structured_mesh((300.0, 10.0, 800.0, 60.0), 10.0)
    seen = BinnedPair(source(f, mask), source(g), 1).bin_surroundings(mesh, np.array(translation))
    factor = seen.pair.factor
    for part, image, begin in ((seen.pair.reference, f, seen.origin),
                               (seen.pair.deformed, g, seen.origin + seen.translation)):
        height, width = part.image.height * factor, part.image.width * factor
        x, y = begin.astype(int)
        whole = Window.of_size(shape[1], shape[0])
        assert whole.contains(Window((x, y), (x + width, y + height)))
        blocks = image[y:y + height, x:x + width].reshape(height // factor, factor, width // factor, factor)
        # float32 of grey levels to 255.
        np.testing.assert_allclose(part.image.read(part.extent), blocks.mean(axis=(1, 3)), atol=1e-4)
    usable = seen.pair.reference.find_usable(seen.pair.reference.extent)
    x, y = seen.origin.astype(int)
    height, width = (factor * n for n in usable.shape)
    all_usable = mask[y:y + height, x:x + width].reshape(height // factor, factor, width // factor, factor).all((1, 3))
    np.testing.assert_array_equal(usable > 0, all_usable)
    # The region is seen, and half of its longer side around it where the image reaches so far.
    assert (seen.origin <= np.maximum(mesh.nodes.min(axis=0) - 250.0, 0.0) + factor).all()


def test_what_is_found_in_parts_of_the_images_is_moved_to_its_place() -> None:
    origin, translation = np.array([64.0, -20.0]), np.array([7.0, 30.0])
    points = np.random.default_rng(0).uniform(20.0, 180.0, (50, 2))
    grid = GridField((20.0, 10.0), (40.0, 50.0), np.random.default_rng(1).normal(size=(5, 5, 2)))
    moved = move_field(grid, origin, translation)
    # Sums of numbers of some hundred pixels.
    np.testing.assert_allclose(moved.at(points + origin), grid.at(points) + translation, atol=1e-12)
    whole, other = (build_structured_mesh((20.0, 20.0, 180.0, 180.0), element) for element in (40.0, 16.0))
    line = np.array([[-100.0, 83.0], [300.0, 131.0]])
    cut, finer = (cut_mesh(mesh, [line]).mesh for mesh in (whole, other))
    field = CutField(cut, np.random.default_rng(3).normal(size=(cut.n_nodes, 2)))
    found = evaluate_at_nodes(move_field(field, origin, translation), move_mesh(finer, origin))
    expected = evaluate_at_nodes(field, finer) + translation
    # But for nodes on which rounding puts a point of a side into another cell.
    same = (np.abs(found - expected) < 1e-9).all(axis=1)
    assert same.mean() > 0.99
