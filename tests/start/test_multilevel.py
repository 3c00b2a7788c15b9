"""The start: rigid correlation and the coarse-graining pyramid."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ddic.case.schema import StartSection
from ddic.images.rigid import build_uniform_field
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.structured import build_grid_lines, build_structured_mesh
from ddic.parallel.team import require_held
from ddic.start.binned_pair import CELLS, LARGEST_COARSE_IMAGE, BinnedPair, choose_block_sizes
from ddic.start.multilevel import SURE, MultilevelStart, Pyramid, correlate_level, find_multilevel_start
from ddic.synth.fields import Affine, DisplacementField, Translation
from support.pictures import pair_of, rms_error, source, square_mesh

SIDE = 384
MESH = square_mesh(80.0, 304.0)
CENTRE = (191.5, 191.5)


def _pair(reference: np.ndarray, deformed: np.ndarray) -> BinnedPair:
    return BinnedPair(source(reference), source(deformed), 1)


def _start(field: DisplacementField, *, rigid: bool = True, features: bool = False,
           pyramid: bool = True) -> MultilevelStart:
    pair = pair_of(field, SIDE, 8)
    return find_multilevel_start(Pyramid(_pair(pair.reference, pair.deformed), MESH, "none"),
                                 StartSection(rigid=rigid, features=features, pyramid=pyramid))


def _turned(degrees: float, centre: tuple[float, float]) -> Affine:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return Affine(((c - 1, -s), (s, c - 1)), (10.0, 5.0), centre)


def _error(start: MultilevelStart, field: DisplacementField) -> float:
    return rms_error(start.field.at(MESH.nodes).ravel(), MESH.nodes, field)


@pytest.mark.parametrize("shift", [(60.0, 0.0), (-60.0, 60.0), (-17.3, 41.8), (0.0, 0.0), (3.5, -59.5)])
def test_rigid_shifts_are_found_by_correlation_alone(shift: tuple[float, float]) -> None:
    start = _start(Translation(shift), pyramid=False)
    # A parabola through the peak of the correlation finds the fraction of a pixel to a tenth.
    np.testing.assert_allclose(start.rigid[0].shift, shift, atol=0.1)
    assert start.rigid[0].coefficient > 0.85
    assert start.levels == ()
    assert _error(start, Translation(shift)) <= 0.1


@pytest.mark.parametrize("field", [
    Affine(((0.05, 0.0), (0.0, -0.015)), (4.0, -3.0), CENTRE),
    Affine(((-0.05, 0.01), (0.01, 0.05)), (0.0, 0.0), CENTRE),
], ids=["strain of 5 %", "strains of 5 % with shear"])
def test_the_pyramid_follows_strain(field: DisplacementField) -> None:
    start = _start(field)
    assert start.levels == tuple(sorted(start.levels, reverse=True))
    assert not any("left out" in line for line in start.warnings)
    # Close enough for the last level of Gauss-Newton, whose speckles of 5 px are followed from 1 px away.
    assert _error(start, field) <= 0.2
    # The rigid stage alone leaves up to 5 px at the corners.
    assert _error(_start(field, pyramid=False), field) > 1.0


def test_the_pyramid_follows_a_rotation_of_3_degrees() -> None:
    # 10 px at the ends of a region of 384 px, within reach of a level with blocks of 16 px.
    side, mesh = 576, square_mesh(96.0, 480.0)
    field = _turned(3.0, ((side - 1) / 2, (side - 1) / 2))
    pair = pair_of(field, side, 8)
    start = find_multilevel_start(Pyramid(_pair(pair.reference, pair.deformed), mesh, "none"),
                                  StartSection(features=False))
    assert start.levels == (16, 8, 4, 2)
    assert rms_error(start.field.at(mesh.nodes).ravel(), mesh.nodes, field) <= 0.2


def test_a_translation_that_explains_the_whole_region_on_coarser_blocks_is_refined_without_features() -> None:
    # 3 px of strain at the edges: too much for speckles of 5 px, so that the translation is not sure, and half of a
    # block of 8 px.
    side, mesh = 800, square_mesh(40.0, 760.0)
    field = Affine(((0.008, 0.0), (0.0, -0.003)), (9.3, -6.2), (399.5, 399.5))
    pair = pair_of(field, side, 8)
    start = find_multilevel_start(Pyramid(_pair(pair.reference, pair.deformed), mesh, "none"), StartSection())
    assert start.rigid[0].coefficient < SURE
    assert start.levels == (8, 4, 2)
    assert start.n_matches == 0
    # Blocks of 2 px see half of the speckle: 0.01 px.
    assert rms_error(start.field.at(mesh.nodes).ravel(), mesh.nodes, field) <= 0.05
    # A twentieth of the region that moves by itself, by three blocks of 8 px, is no matter of refinement.
    deformed = pair.deformed.copy()
    deformed[60:220, 60:220] = np.roll(pair.deformed, 25, axis=0)[60:220, 60:220]
    assert find_multilevel_start(Pyramid(_pair(pair.reference, deformed), mesh, "none"), StartSection()).n_matches > 0


@pytest.mark.parametrize("off", [0.0, 9.0])
def test_a_corner_that_features_put_beside_its_place_is_found_on_larger_blocks(off: float) -> None:
    side, mesh = 576, square_mesh(96.0, 480.0)
    field = _turned(12.0, ((side - 1) / 2, (side - 1) / 2))
    pair = pair_of(field, side, 8)
    pyramid = Pyramid(_pair(pair.reference, pair.deformed), mesh, "none")
    matched = require_held(pyramid.matched)
    # More than the 2 blocks of 2 px that the finest level follows: they are left of a speckle.
    moved = matched.matches.displacement.copy()
    moved[(matched.matches.points < 176.0).all(axis=1)] += [off, -off]
    pyramid.__dict__["matched"] = replace(matched, matches=replace(matched.matches, displacement=moved))
    start = find_multilevel_start(pyramid, StartSection())
    assert start.n_matches > 0
    assert start.levels == ((2,) if off == 0.0 else (4, 2))
    assert rms_error(start.field.at(mesh.nodes).ravel(), mesh.nodes, field) <= 0.1


def test_each_stage_can_be_switched_off() -> None:
    field = Translation((2.0, -1.5))
    nothing = _start(field, rigid=False, pyramid=False)
    assert nothing.rigid == ()
    assert nothing.levels == ()
    assert (nothing.field.at(MESH.nodes) == 0).all()
    only_pyramid = _start(field, rigid=False)
    assert only_pyramid.rigid == ()
    assert only_pyramid.levels
    # Gauss-Newton on blocks of 2 px, whose bias is a fraction of a tenth of a block.
    assert _error(only_pyramid, field) <= 0.05


def test_a_gain_between_the_images_does_not_disturb_the_rigid_stage() -> None:
    field = Translation((12.0, -7.0))
    pair = pair_of(field, SIDE, 8)
    dimmed = 0.5 * pair.deformed.astype(np.float32) + 60
    start = find_multilevel_start(Pyramid(_pair(pair.reference, dimmed), MESH, "global"), StartSection())
    assert _error(start, field) <= 0.1
    assert start.warnings == ()


def test_images_without_texture_give_a_still_start_and_say_so() -> None:
    flat = np.full((SIDE, SIDE), 100.0, dtype=np.float32)
    start = find_multilevel_start(Pyramid(_pair(flat, flat), MESH, "none"), StartSection())
    assert start.rigid == ()
    assert start.levels == ()
    assert "no rigid translation stands out" in start.warnings[0]
    assert len(start.warnings) == 1 + len(choose_block_sizes((SIDE, SIDE), MESH))
    assert all("was left out" in line for line in start.warnings[1:])
    assert (start.field.at(MESH.nodes) == 0).all()


@pytest.mark.parametrize("width", [100, 1000, 5400, 32000])
@pytest.mark.parametrize("side", [10.0, 100.0, 1000.0, 10000.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_block_sizes_double_and_fit_the_region(width: int, side: float, dim: int) -> None:
    mesh = build_grid_lines((0.0,) * dim + (side,) * dim, side / 4).build_mesh()
    sizes = choose_block_sizes((width,) * dim, mesh)
    assert all(coarse == 2 * fine for coarse, fine in pairwise(sizes))
    assert all(side / size >= CELLS[dim] for size in sizes)
    assert all((width / size)**dim <= LARGEST_COARSE_IMAGE[dim] for size in sizes)


@pytest.mark.parametrize("circles", [
    [((322.0, 266.0), 57.0), ((172.0, 292.0), 43.0), ((247.0, 268.0), 68.0), ((145.0, 270.0), 48.0)],
    [((108.0, 314.0), 68.0), ((187.0, 275.0), 61.0), ((233.0, 301.0), 42.0), ((280.0, 161.0), 51.0)],
])
def test_slivers_at_the_edge_of_a_ragged_region_do_not_stop_a_level(
        circles: list[tuple[tuple[float, float], float]]) -> None:
    # Cells of the pyramid with a few blocks were singular here: one level lost, 8 px of error; two lost, 0.8 px.
    field = Affine(((0.02, 0.0), (0.0, -0.02)), (3.0, -4.0), CENTRE)
    mesh, pair = build_structured_mesh((60.0, 60.0, 324.0, 324.0), 12.0, "Q4", circles=circles), pair_of(field, SIDE, 8)
    start = find_multilevel_start(Pyramid(_pair(pair.reference, pair.deformed), mesh, "none"),
                                  StartSection(features=False))
    assert not any("left out" in line for line in start.warnings), start.warnings
    # Blocks of 2 px see half of the speckle; 0.012 to 0.021 px on twenty such regions.
    assert rms_error(start.field.at(mesh.nodes).ravel(), mesh.nodes, field) <= 0.05


def test_a_level_starts_from_the_field_that_fits_best() -> None:
    field = Translation((5.0, -3.0))
    pair = pair_of(field, SIDE, 8)
    astray, right = build_uniform_field((40.0, 35.0)), build_uniform_field((5.2, -3.1))
    found = correlate_level(_pair(pair.reference, pair.deformed), MESH, [astray, right], "none", Discontinuities())
    # Cubic splines of speckles of 5 px: 1.4e-3 px of bias; from 50 px away there is nothing to follow.
    assert rms_error(found.at(MESH.nodes).ravel(), MESH.nodes, field) <= 5e-3


@pytest.mark.parametrize("size", [(381, 382), (383, 370), (379, 384)])
def test_a_region_as_large_as_the_image_is_measured(size: tuple[int, int]) -> None:
    # Blocks of 2, 4 and 8 px leave some columns and rows over, in which the outermost nodes lie.
    width, height = size
    field = Affine(((0.01, 0.0), (0.0, -0.01)), (2.0, -1.0), CENTRE)
    pair = pair_of(field, SIDE, 8)
    mesh = build_structured_mesh((0.0, 0.0, width - 1.0, height - 1.0), 16.0, "Q4")
    cropped = _pair(pair.reference[:height, :width], pair.deformed[:height, :width])
    start = find_multilevel_start(Pyramid(cropped, mesh, "none"), StartSection())
    assert start.levels[-1] == 2
    assert not any("left out" in line for line in start.warnings), start.warnings
    # Beyond the last block the field goes on as it ends there: 8 px of 1 % of strain.
    assert rms_error(start.field.at(mesh.nodes).ravel(), mesh.nodes, field) <= 0.05


def test_each_level_tells_its_iterations() -> None:
    told: list[tuple[int, int]] = []
    pair = pair_of(Translation((3.5, -9.5)), SIDE, 8)
    pyramid = Pyramid(_pair(pair.reference, pair.deformed), MESH, "none",
                      report=lambda size, record: told.append((size, record.number)))
    start = find_multilevel_start(pyramid, StartSection(rigid=False))
    assert list(dict.fromkeys(size for size, _ in told)) == list(start.levels)
    for size in start.levels:
        numbers = [number for of_size, number in told if of_size == size]
        assert numbers == list(range(1, len(numbers) + 1))
