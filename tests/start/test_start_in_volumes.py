"""The start in volumes: what turns by 20 degrees, stretches by 15 %, parts or moves far is found by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial.transform import Rotation

import ddic
from ddic.case.schema import StartSection
from ddic.mesh.mesh import Mesh, join_meshes
from ddic.parallel.team import Team, require_held
from ddic.parallel.workers import Workers
from ddic.start import binned_pair, level, multilevel
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_displacement import CutField
from ddic.start.feature_matches import find_pieces, match_features
from ddic.start.given_start import extrapolate, interpolate_pairs
from ddic.start.helpers import Helpers, hold_rows, split_rows
from ddic.start.matched_blocks import BETWEEN_ROTATIONS, LARGEST_ANGLE, list_rotations
from ddic.start.multilevel import SURE, MultilevelStart, Pyramid, find_multilevel_start, find_start_from_given
from ddic.start.predicted_error import predict_error
from ddic.synth.fields import Affine, Translation
from support.pictures import source
from support.speckled_volumes import box_mesh, find_errors, pair_of, snow_of, turn_and_stretch
from support.volumes import displace, make_pair

SIDE = 80
MESH = box_mesh((20.0,) * 3, (60.0,) * 3, (4, 4, 4))
REST = Translation((0.0, 0.0, 0.0))
T = TypeVar("T")


def _start(pair: BinnedPair, mesh: Mesh = MESH, stages: StartSection | None = None) -> MultilevelStart:
    return find_multilevel_start(Pyramid(pair, mesh, "none"), stages or StartSection())


@pytest.mark.parametrize(("axis", "degrees", "strains", "shift"), [
    ((1.0, 0.0, 0.0), 20.0, (0.15, -0.05, -0.05), (2.3, -4.2, 3.8)),
    ((0.0, 1.0, 0.0), -20.0, (-0.15, 0.05, 0.1), (-2.3, 1.2, 0.4)),
    ((0.0, 0.0, 1.0), 20.0, (0.15, 0.15, 0.15), (0.0, 0.0, 0.0)),
    ((1.0, -2.0, 1.5), 12.0, (0.0, 0.0, -0.1), (14.6, -12.3, 9.4)),
], ids=["about x", "about y", "about z", "far"])
def test_a_turned_and_strained_cube_is_found(axis: tuple[float, ...], degrees: float, strains: tuple[float, ...],
                                             shift: tuple[float, ...]) -> None:
    field = turn_and_stretch(SIDE, axis, degrees, strains, shift)
    start = _start(pair_of(field, SIDE))
    assert start.n_matches > 0.9 * start.n_found
    # Blocks of 2 px see half of the speckle: 0.01 to 0.05 px, 0.3 px at corners.
    errors = find_errors(start.require_field(), MESH, field)
    assert np.sqrt((errors**2).mean()) <= 0.15
    assert errors.max() <= 0.5


@pytest.mark.real_data
@pytest.mark.parametrize("strain", [0.15, -0.15])
def test_turned_and_strained_snow_is_found(real_data: Path, strain: float) -> None:
    field = turn_and_stretch(100, (1.0, -2.0, 1.5), 20.0, (strain, -strain / 3, -strain / 3), (3.0, -2.0, 4.0))
    mesh = box_mesh((28.0,) * 3, (72.0,) * 3, (4, 4, 4))
    start = _start(snow_of(field, real_data / "snow" / "snow.tif"), mesh)
    assert start.n_matches > 0.9 * start.n_found
    # Pores of 10 px show nothing: 0.04 px, 0.3 px at corners.
    assert find_errors(start.require_field(), mesh, field).max() <= 1.0


def test_what_moves_by_half_a_block_is_found_by_correlation_alone() -> None:
    # Of blocks of 2 px, and of 4 px: speckles of 5 px are hardly larger.
    field = Translation((5.0, -3.0, 9.0))
    start = _start(pair_of(field, SIDE), stages=StartSection(pyramid=False, features=False))
    assert start.rigid[0].coefficient >= SURE
    np.testing.assert_allclose(start.rigid[0].shift, field.vector, atol=0.3)


@pytest.mark.parametrize("field", [
    turn_and_stretch(SIDE, (1.0, 2.0, -1.0), 2.0, (0.02, -0.01, 0.01), (2.6, -1.4, 3.3)), Translation((0.0, 0.0, 0.0))],
    ids=["moved", "same"])
def test_the_pyramid_follows_small_motions(field: Affine) -> None:
    start = _start(pair_of(field, SIDE), stages=StartSection(features=False))
    assert start.levels == (2,)
    assert start.warnings == ()
    # Blocks of 2 px see half of the speckle.
    assert find_errors(start.require_field(), MESH, field).max() <= 0.15


@pytest.mark.parametrize("low", [(20.0, 20.0, 36.0), (20.0, 36.0, 36.0)], ids=["plate", "rod"])
def test_thin_bodies_are_found_by_what_of_a_ball_they_hold(low: tuple[float, ...]) -> None:
    field = turn_and_stretch(SIDE, (0.0, 0.0, 1.0), 15.0, (0.05, 0.0, 0.0), (3.0, -5.0, 2.0))
    high = tuple(79.0 - place if place == 20.0 else 46.0 for place in low)
    mesh = box_mesh(low, high, tuple(int((b - a) / 5.0) for a, b in zip(low, high, strict=True)))
    start = _start(pair_of(field, SIDE), mesh)
    # They are too thin for a level; balls are matched to a tenth of a block or two.
    assert (start.levels, start.n_matches > 100) == ((), True)
    assert find_errors(start.require_field(), mesh, field).max() <= 0.6


class _Parting:
    """Below a plane z one motion, above it another."""

    def __init__(self, z: float, below: Affine, above: Affine) -> None:
        self.z, self.below, self.above = z, below, above

    def displacement(self, points: np.ndarray) -> np.ndarray:
        is_above = points[:, 2:] > self.z
        return np.where(is_above, self.above.displacement(points), self.below.displacement(points))


@pytest.mark.parametrize("depth", [9, 12, 17])
def test_a_volume_thinner_than_a_ball_is_started(depth: int) -> None:
    f, g = (values[:depth] for values in make_pair(48))
    # Nothing is known of it beforehand: balls are sought.
    result = ddic.measure((f, g), ddic.structured_mesh((6, 6, 1, 42, 42, depth - 2), 6))
    error = result.displacement - displace(result.mesh.nodes, 48)
    # Elements of 6 voxels, of waves of 6 to 14, many of whose nodes lie beside a face of the volume: 0.018 to 0.029.
    assert np.sqrt((error**2).mean()) < 0.03


def test_bodies_that_part_keep_their_own_motion() -> None:
    side, middle = 96, 47.5
    below = turn_and_stretch(side, (0.0, 0.0, 1.0), 8.0, shift=(0.0, 0.0, -6.0))
    above = turn_and_stretch(side, (0.0, 0.0, 1.0), -12.0, shift=(4.0, -3.0, 8.0))
    parting = _Parting(middle, below, above)
    one, other = pair_of(below, side), pair_of(above, side)
    g = one.deformed.read_whole()
    # What was at the plane lies now 8 px above it; between the two is nothing.
    g[42:] = 128.0
    g[56:] = other.deformed.read_whole()[56:]
    mesh = join_meshes([box_mesh((24.0, 24.0, 20.0), (72.0, 72.0, 47.0), (4, 4, 2)),
                        box_mesh((24.0, 24.0, 48.0), (72.0, 72.0, 76.0), (4, 4, 2))])
    start = _start(BinnedPair(one.reference, source(g), 1), mesh)
    # A level's cells would hold both: their pixels at the plane move by 14 px.
    assert start.levels == ()
    errors = find_errors(start.require_field(), mesh, parting)  # type: ignore[arg-type]
    assert np.median(errors) <= 0.15
    assert errors.max() <= 1.0


@pytest.mark.parametrize("deformed", ["unrelated", "blank"])
def test_nothing_is_found_where_there_is_nothing(deformed: str) -> None:
    f = pair_of(REST, SIDE).reference
    g = pair_of(REST, SIDE, 9).deformed if deformed == "unrelated" else source(np.full((SIDE,) * 3, 128.0))
    matches = match_features(BinnedPair(f, g, 1), MESH, find_pieces(MESH))
    assert not matches.agree
    blank = source(np.full((SIDE,) * 3, 128.0))
    assert match_features(BinnedPair(blank, g, 1), MESH, find_pieces(MESH)).n_found == 0


def test_masked_voxels_do_not_count() -> None:
    field = turn_and_stretch(SIDE, (1.0, 1.0, 0.0), 15.0, (0.05, 0.05, -0.05))
    pair = pair_of(field, SIDE)
    f, g = pair.reference.read_whole(), pair.deformed.read_whole()
    random = np.random.default_rng(0)
    hidden = np.zeros(f.shape, dtype=bool)
    hidden[20:60, 20:60, 45:60] = True
    f[hidden] = random.uniform(0.0, 255.0, int(hidden.sum()))
    start = _start(BinnedPair(source(f, ~hidden), source(g, np.ones_like(hidden)), 1))
    errors = find_errors(start.require_field(), MESH, field)
    assert errors[MESH.nodes[:, 0] <= 40.0].max() <= 0.5


def test_every_rotation_is_near_one_that_is_tried() -> None:
    random = np.random.default_rng(1)
    axes = random.normal(size=(500, 3))
    angles = LARGEST_ANGLE * random.uniform(size=(500, 1)) ** (1 / 3)
    wanted = Rotation.from_rotvec(angles * axes / np.linalg.norm(axes, axis=1, keepdims=True), degrees=True)
    tried = Rotation.from_matrix(list_rotations())
    nearest = [np.degrees((tried * one.inv()).magnitude().min()) for one in wanted]
    # From the middle of an edge between a cube's corners to the nearest of them and of the cubes' middles, and as far
    # again where the ball ends between two.
    assert max(nearest) <= 0.6 * BETWEEN_ROTATIONS + 2.0
    assert np.percentile(nearest, 90) <= 0.56 * BETWEEN_ROTATIONS


def test_the_error_of_a_displacement_is_predicted() -> None:
    field = Translation((3.0, -2.0, 1.0))
    pair = pair_of(field, SIDE).bin_at_sizes([2])[2]
    off = np.array([0.5, 0.4, -0.3])
    predicted = predict_error(pair, MESH, lambda points: field.displacement(points) + off)
    # 2 x 2 x 2 cubes of 10 blocks; one step of optical flow, whose slopes are differences of blocks, interpolated
    # between these: too small by a third, so that errors are rather thought larger.
    assert predicted.error.shape == (8,)
    assert (predicted.error >= 0.9 * np.linalg.norm(off)).all()
    assert (predicted.error <= 1.8 * np.linalg.norm(off)).all()
    assert predicted.coefficient > 0.9
    far = predict_error(pair, MESH, lambda points: field.displacement(points) + 15.0)
    assert far.measure_share_beyond(np.inf) == 1.0


def _search(pair: BinnedPair, mesh: Mesh, lead: Callable[[Helpers], T], team: Team) -> T:
    """What the last rank finds, with all ranks of a team; each holds its planes of the volumes."""
    held = [hold_rows(pair.reference, pair.deformed, 1, split_rows(SIDE, team.size)[team.rank])]
    workers = Workers(team, team.size - 1, held)
    _, found = workers.run(lambda: lead(Helpers(workers, 0)), lambda: None)
    return require_held(team.broadcast(found, root=workers.leader))


@pytest.mark.parallel([1, 2, 3])
def test_levels_in_tiles_are_the_same_on_any_number_of_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    # 6 cells of 10 blocks of 1 px: 2 x 2 x 2 tiles.
    monkeypatch.setitem(level.TILE, 3, 3)
    field = turn_and_stretch(SIDE, (1.0, 2.0, -1.0), 1.0, (0.01, 0.0, 0.0), (0.6, -1.4, 0.3))
    pair, mesh = pair_of(field, SIDE), box_mesh((10.0,) * 3, (70.0,) * 3, (4, 4, 4))
    starts = [CutField(mesh, Translation((0.6, -1.4, 0.3)).displacement(mesh.nodes))]

    def lead(helpers: Helpers) -> level.TiledLevel:
        return level.correlate_in_tiles(helpers, 1, mesh, starts, "none")

    by_all, alone = (_search(pair, mesh, lead, team) for team in (Team(MPI.COMM_WORLD), Team.alone()))
    assert (by_all.n_tiles, by_all.errors) == (8, [])
    np.testing.assert_array_equal(by_all.field.values, alone.field.values)
    assert find_errors(by_all.field, mesh, field).max() <= 0.1


@pytest.mark.parallel([1, 2])
def test_the_whole_start_is_the_same_on_any_number_of_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multilevel, "LARGEST_WHOLE", 1000)
    field = turn_and_stretch(SIDE, (1.0, 2.0, -1.0), 15.0, (0.05, 0.0, 0.0), (0.6, -1.4, 0.3))

    def lead(helpers: Helpers) -> MultilevelStart:
        return find_multilevel_start(Pyramid(helpers.get_pair(1), MESH, "none", helpers=helpers), StartSection())

    by_all, alone = (_search(pair_of(field, SIDE), MESH, lead, team) for team in (Team(MPI.COMM_WORLD), Team.alone()))
    assert by_all.describe() == alone.describe()
    np.testing.assert_array_equal(by_all.require_field().at(MESH.nodes), alone.require_field().at(MESH.nodes))


def test_a_small_region_of_a_large_volume_is_seen_in_smaller_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(binned_pair.LARGEST_COARSE_IMAGE, 3, 50_000)
    monkeypatch.setattr(binned_pair, "LARGEST_FFT_IMAGE", 40_000)
    field = turn_and_stretch(SIDE, (0.0, 1.0, 1.0), 12.0, shift=(4.0, -6.0, 3.0))
    mesh = box_mesh((32.0,) * 3, (52.0,) * 3, (2, 2, 2))
    pixels = pair_of(field, SIDE)
    pair = replace(pixels.bin_at_sizes([4])[4], pixels=pixels)
    start = _start(pair, mesh)
    assert start.notes[0].endswith("in blocks of 2 px")
    assert find_errors(start.require_field(), mesh, field).max() <= 0.5


@pytest.mark.parametrize(("off", "note"), [((0.3, -0.2, 0.4), None), ((1.5, 0.0, -1.0), "goes on from it"),
                                           ((12.0, -9.0, 7.0), "moved on by (-1")])
def test_a_given_displacement_is_kept_or_gone_on_from(off: tuple[float, ...], note: str | None) -> None:
    field = turn_and_stretch(SIDE, (1.0, 0.0, 2.0), 10.0, (0.0, 0.05, 0.0), (2.0, 1.0, -3.0))
    given = CutField(MESH, field.displacement(MESH.nodes) + off)
    found = find_start_from_given(given, Pyramid(pair_of(field, SIDE), MESH, "none"), StartSection())
    assert (found.field is given) == (note is None)
    assert note is None or note in found.notes[1]
    if note is not None:
        assert find_errors(found.require_field(), MESH, field).max() <= 0.3


@pytest.mark.parametrize("points", [[[20.0, 30.0, 40.0]], [[20.0, 30.0, 40.0], [50.0, 20.0, 25.0]],
                                    [[20.0, 20.0, 20.0], [50.0, 20.0, 20.0], [20.0, 60.0, 20.0], [40.0, 40.0, 20.0]],
                                    [[20.0, 20.0, 20.0], [50.0, 20.0, 20.0], [20.0, 60.0, 20.0], [30.0, 30.0, 55.0]]],
                         ids=["one", "two", "in a plane", "in space"])
def test_points_say_what_they_tell(points: list[list[float]]) -> None:
    # A rotation about an axis across the two points, with a scale, but for four points in space: these tell an affine
    # map.
    places = np.array(points)
    axis = (0.0, 0.0, 1.0) if len(points) != 2 else tuple(np.cross(places[1] - places[0], (1.0, 2.0, 3.0)).tolist())
    strains = (0.1, 0.1, 0.1) if places[-1, 2] < 55.0 else (0.1, -0.05, 0.02)
    field = turn_and_stretch(SIDE, axis, 25.0 if len(points) > 1 else 0.0, strains if len(points) > 1 else (0.0,) * 3,
                             (3.0, -4.0, 5.0))
    found = interpolate_pairs(places, field.displacement(places), MESH)
    # The least rotation is told by one part in a million where two points tell none about their line.
    np.testing.assert_allclose(found.displacement, field.displacement(MESH.nodes), atol=1e-3)


def test_a_known_part_is_extended_by_equilibrium() -> None:
    field = turn_and_stretch(SIDE, (1.0, 1.0, 0.0), 15.0, (0.02, 0.01, -0.01), (3.0, -4.0, 5.0))
    known = MESH.nodes[:, 2] <= 40.0
    displacement = np.where(known[:, None], field.displacement(MESH.nodes), np.nan)
    found = extrapolate(MESH, displacement, known)
    np.testing.assert_allclose(found.displacement, field.displacement(MESH.nodes), atol=1e-6)


def test_what_is_the_same_along_an_axis_ends_in_order() -> None:
    # Fibres along z, moved across them: nothing tells the motion along them.
    plane = pair_of(REST, SIDE).reference.read_whole()[SIDE // 2]
    f, g = (source(np.repeat(values[None], SIDE, axis=0)) for values in (plane, np.roll(plane, 2, axis=1)))
    matches = match_features(BinnedPair(f, g, 1), MESH, find_pieces(MESH))
    assert np.isfinite(matches.displacement).all()
